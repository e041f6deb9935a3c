from .agents.making import make_agent
from .agents.training.plots import plot_runs
from .agents.training.train import train
from .benchmark.compare import compare
from .benchmark.pretrained import load_pretrained
from .env.config import RoomConfig
from .env.escape_room import EscapeRoomEnv
from .env.instance import RoomInstance
from .env.presets import get_preset
from .env.sampling.generation import generate
from .options.options_env import OptionsEnv
from .planning.planner import RoomPlanner
from .sets.environments import make_env, make_vec
from .sets.grammar import make_room

__version__: str

__all__ = [
    "EscapeRoomEnv",
    "OptionsEnv",
    "RoomConfig",
    "RoomInstance",
    "RoomPlanner",
    "__version__",
    "compare",
    "generate",
    "get_preset",
    "load_pretrained",
    "make_agent",
    "make_env",
    "make_room",
    "make_vec",
    "plot_runs",
    "train",
]
