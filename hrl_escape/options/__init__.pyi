from .batched.env import BatchedOptionsEnv
from .best_with_options import best_return_with_options, find_best_with_options
from .closed_loop import pursue
from .degraded import OptionDegradation
from .domain import OptionDomain
from .execution import TraceStep
from .learned import LearnedOption, make_learned_options
from .masked_observation import MaskedObservation
from .memory import DecisionMemory, VectorDecisionMemory
from .meta_actions import PlannedOption, make_meta_options
from .option import FunctionOption, Option, ScriptedOption, TableOption
from .option_sets import register_option_set
from .options_env import OptionsEnv
from .pushing import PushOption
from .skills import make_go_to, make_press, make_reach
from .torchrl_env import OptionsGymWrapper, OptionsTorchRLEnv, SMDPTransform

__all__ = [
    "BatchedOptionsEnv",
    "DecisionMemory",
    "FunctionOption",
    "LearnedOption",
    "MaskedObservation",
    "VectorDecisionMemory",
    "Option",
    "OptionDegradation",
    "OptionDomain",
    "OptionsEnv",
    "OptionsGymWrapper",
    "OptionsTorchRLEnv",
    "PlannedOption",
    "PushOption",
    "SMDPTransform",
    "ScriptedOption",
    "TableOption",
    "TraceStep",
    "best_return_with_options",
    "find_best_with_options",
    "make_go_to",
    "make_learned_options",
    "make_meta_options",
    "make_press",
    "make_reach",
    "pursue",
    "register_option_set",
]
