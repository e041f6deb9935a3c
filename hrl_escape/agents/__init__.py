"""Learners for flat environments and for options alike, and the loop that trains them.

They know Gymnasium and the SMDP fields of `info` (see `agent.make_transition`), nothing of rooms or
options. Importing this package loads no torch; an agent that needs it does when it is made.
"""

from hrl_escape.agents.agent import Agent, SMDPTransition
from hrl_escape.agents.evaluation import Evaluation, evaluate, play_episode
from hrl_escape.agents.registry import get_recipe, list_agents, make_agent
from hrl_escape.agents.results import TrainResult, load_result
from hrl_escape.agents.training import load_agent, train

__all__ = [
    "Agent",
    "Evaluation",
    "SMDPTransition",
    "TrainResult",
    "evaluate",
    "get_recipe",
    "list_agents",
    "load_agent",
    "load_result",
    "make_agent",
    "play_episode",
    "train",
]
