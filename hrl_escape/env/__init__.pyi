from .batched.rooms import Rooms
from .config import (
    Between,
    DynamicsConfig,
    ExitConfig,
    ObstaclesConfig,
    RobotConfig,
    RoomConfig,
    ShapeConfig,
    StartConfig,
    Wall,
)
from .continuous import EscapeRoomContinuousEnv
from .continuous_vector_env import EscapeRoomContinuousVectorEnv
from .escape_room import EscapeRoomEnv
from .instance import PlacedProp, Rectangle, RoomInstance, Start, Target
from .kinematics import Kinematics, RoomState, Rules
from .observations.base import Observer, make_observer
from .presets import PRESETS, get_preset, list_presets
from .primitives import Primitive
from .puzzles.base import (
    Contacts,
    Pads,
    Panels,
    Place,
    Prop,
    Puzzle,
    PuzzleConfig,
    list_puzzles,
    register_puzzle,
)
from .puzzles.bit_flip import BitFlipConfig
from .puzzles.buttons import ButtonsConfig
from .puzzles.graphs import GraphConfig
from .puzzles.push_block import PushBlockConfig
from .puzzles.symbolic import Operator, SymbolicModel
from .rewards import RewardConfig, rewards
from .robot import Robot
from .sampling.generation import generate
from .torchrl_env import EscapeRoomTorchRLEnv
from .vector_env import EscapeRoomVectorEnv

__all__ = [
    "Between",
    "BitFlipConfig",
    "ButtonsConfig",
    "Contacts",
    "DynamicsConfig",
    "EscapeRoomContinuousEnv",
    "EscapeRoomContinuousVectorEnv",
    "EscapeRoomEnv",
    "EscapeRoomTorchRLEnv",
    "EscapeRoomVectorEnv",
    "ExitConfig",
    "GraphConfig",
    "Kinematics",
    "Observer",
    "ObstaclesConfig",
    "Operator",
    "PRESETS",
    "Pads",
    "Panels",
    "Place",
    "PlacedProp",
    "Primitive",
    "Prop",
    "PushBlockConfig",
    "Puzzle",
    "PuzzleConfig",
    "Rectangle",
    "RewardConfig",
    "Robot",
    "RobotConfig",
    "RoomConfig",
    "RoomInstance",
    "RoomState",
    "Rooms",
    "Rules",
    "ShapeConfig",
    "Start",
    "StartConfig",
    "SymbolicModel",
    "Target",
    "Wall",
    "generate",
    "get_preset",
    "list_presets",
    "list_puzzles",
    "make_observer",
    "register_puzzle",
    "rewards",
]
