from .comparison import run_grid
from .grid import AgentSpec, Grid
from .option_dial import measure_option, place_on_dial
from .places import RoomSpec
from .reporting.report import write_report
from .verdict import write_verdict

__all__ = [
    "AgentSpec",
    "Grid",
    "RoomSpec",
    "measure_option",
    "place_on_dial",
    "run_grid",
    "write_report",
    "write_verdict",
]
