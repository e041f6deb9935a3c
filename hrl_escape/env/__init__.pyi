from .config import (
    Between,
    DynamicsConfig,
    ExitConfig,
    ObstaclesConfig,
    RewardConfig,
    RobotConfig,
    RoomConfig,
    ShapeConfig,
    StartConfig,
)
from .escape_room import EscapeRoomEnv
from .instance import PlacedProp, Rectangle, RoomInstance, SpaceLayout, Start, Target
from .kinematics import Kinematics, RoomState, Rules, Transition
from .observations import Observer, make_observer
from .presets import PRESETS, get_preset
from .primitives import Primitive
from .puzzles.base import (
    Contacts,
    Operator,
    Panels,
    Place,
    Prop,
    Puzzle,
    PuzzleConfig,
    SymbolicModel,
    list_puzzles,
    register_puzzle,
)
from .puzzles.bit_flip import BitFlipConfig, BitFlipPuzzle
from .puzzles.buttons import ButtonsConfig, ButtonsPuzzle
from .puzzles.graphs import GraphConfig
from .puzzles.push_block import PushBlockConfig, PushBlockPuzzle
from .robot import Robot, make_robot
from .sampling.generation import generate
from .torchrl_env import EscapeRoomTorchRLEnv
from .vector_env import EscapeRoomVectorEnv

__all__ = [
    "Between",
    "BitFlipConfig",
    "BitFlipPuzzle",
    "ButtonsConfig",
    "ButtonsPuzzle",
    "Contacts",
    "DynamicsConfig",
    "EscapeRoomEnv",
    "EscapeRoomTorchRLEnv",
    "EscapeRoomVectorEnv",
    "ExitConfig",
    "SpaceLayout",
    "GraphConfig",
    "Kinematics",
    "Observer",
    "ObstaclesConfig",
    "Operator",
    "PRESETS",
    "Panels",
    "Place",
    "PlacedProp",
    "Primitive",
    "Prop",
    "PushBlockConfig",
    "PushBlockPuzzle",
    "Puzzle",
    "PuzzleConfig",
    "Rectangle",
    "RewardConfig",
    "Robot",
    "RobotConfig",
    "RoomConfig",
    "RoomInstance",
    "RoomState",
    "Rules",
    "ShapeConfig",
    "Start",
    "StartConfig",
    "SymbolicModel",
    "Target",
    "Transition",
    "generate",
    "get_preset",
    "list_puzzles",
    "make_observer",
    "make_robot",
    "register_puzzle",
]
