from .agent import check_agent
from .hierarchy import check_hierarchy
from .option import check_option
from .path_planner import check_path_planner
from .puzzle import check_puzzle

__all__ = [
    "check_agent",
    "check_hierarchy",
    "check_option",
    "check_path_planner",
    "check_puzzle",
]
