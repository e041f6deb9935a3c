from .comparison import run_grid
from .grid import Grid
from .pretrained import Pretrained, list_pretrained, load_pretrained
from .recording import RecordedEpisode, record_episode
from .reporting.report import write_report
from .verdict import write_verdict

__all__ = [
    "RecordedEpisode",
    "Grid",
    "Pretrained",
    "list_pretrained",
    "load_pretrained",
    "record_episode",
    "run_grid",
    "write_report",
    "write_verdict",
]
