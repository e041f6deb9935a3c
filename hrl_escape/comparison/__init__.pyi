from .comparison import run_grid
from .grid import AgentSpec, Grid
from .places import RoomSpec
from .reporting.report import write_report
from .verdict import write_verdict

__all__ = [
    "AgentSpec",
    "Grid",
    "RoomSpec",
    "run_grid",
    "write_report",
    "write_verdict",
]
