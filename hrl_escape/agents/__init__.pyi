from .agent import (
    Agent,
    AgentSettings,
    LearningSettings,
    OptionPolicy,
    SMDPTransition,
    compute_backup,
    make_transition,
)
from .decisions import Policy
from .frozen import FrozenAgent
from .hierarchy.machine import choose, do, machine
from .hierarchy.runner import StackAgent
from .hierarchy.task import BaseTask, Call, Hierarchy
from .hierarchy.task_graph import maxq
from .making import make_agent
from .registry import get_recipe, list_agents, register_agent
from .sb3 import SB3Agent
from .spec import AgentSpec
from .state import Kept, Stateful
from .training.archive import pack_run, read_summary, unpack_run
from .training.callbacks import Callback, MLflow, OptunaPruning, TensorBoard, WeightsAndBiases
from .training.evaluation import Evaluation, evaluate, play_episode
from .training.plots import RunCurve, plot_runs, read_csv_curve
from .training.results import TrainResult, load_result
from .training.train import load_agent, load_env, train

__all__ = [
    "Agent",
    "AgentSpec",
    "AgentSettings",
    "BaseTask",
    "Call",
    "Callback",
    "Evaluation",
    "FrozenAgent",
    "Hierarchy",
    "Kept",
    "LearningSettings",
    "MLflow",
    "OptionPolicy",
    "OptunaPruning",
    "Policy",
    "SMDPTransition",
    "RunCurve",
    "SB3Agent",
    "StackAgent",
    "Stateful",
    "TensorBoard",
    "TrainResult",
    "WeightsAndBiases",
    "choose",
    "compute_backup",
    "do",
    "evaluate",
    "get_recipe",
    "list_agents",
    "load_agent",
    "load_env",
    "load_result",
    "machine",
    "make_agent",
    "make_transition",
    "maxq",
    "pack_run",
    "play_episode",
    "plot_runs",
    "read_csv_curve",
    "read_summary",
    "register_agent",
    "train",
    "unpack_run",
]
