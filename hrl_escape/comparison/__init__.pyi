from .comparison import run_grid
from .grid import AgentSpec, Grid
from .places import RoomSpec
from .recording import Episode, record_episode
from .reporting.report import write_report
from .verdict import write_verdict

__all__ = [
    "AgentSpec",
    "Episode",
    "Grid",
    "RoomSpec",
    "record_episode",
    "run_grid",
    "write_report",
    "write_verdict",
]
