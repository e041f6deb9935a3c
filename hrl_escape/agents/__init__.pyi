from .agent import Agent, SMDPTransition, compute_backup, make_transition
from .registry import get_recipe, list_agents, make_agent
from .settings import AgentSettings, LearningSettings
from .training.evaluation import Evaluation, evaluate, play_episode
from .training.results import EpisodeRecord, TrainResult, load_result
from .training.train import load_agent, load_env, train

__all__ = [
    "Agent",
    "AgentSettings",
    "EpisodeRecord",
    "Evaluation",
    "LearningSettings",
    "SMDPTransition",
    "TrainResult",
    "compute_backup",
    "evaluate",
    "get_recipe",
    "list_agents",
    "load_agent",
    "load_env",
    "load_result",
    "make_agent",
    "make_transition",
    "play_episode",
    "train",
]
