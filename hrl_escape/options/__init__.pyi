from .batched.env import BatchedOptionsEnv
from .best_with_options import best_return_with_options, find_best_with_options
from .closed_loop import ClosedLoopExecution, pursue
from .degraded import DegradedOption, OptionDegradation
from .flavours import FLAVOURS
from .meta_actions import PlannedOption, make_meta_options
from .option import LearnedOption, Option, ScriptedOption
from .options_env import OptionsEnv, TraceStep
from .pushing import PushOption
from .skills import PressOption, ReachOption, make_go_to, make_press, make_reach

__all__ = [
    "BatchedOptionsEnv",
    "ClosedLoopExecution",
    "DegradedOption",
    "FLAVOURS",
    "LearnedOption",
    "Option",
    "OptionDegradation",
    "OptionsEnv",
    "PlannedOption",
    "PressOption",
    "PushOption",
    "ReachOption",
    "ScriptedOption",
    "TraceStep",
    "best_return_with_options",
    "find_best_with_options",
    "make_go_to",
    "make_meta_options",
    "make_press",
    "make_reach",
    "pursue",
]
