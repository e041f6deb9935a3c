from .compare import CompareResult, compare
from .comparison import run_grid
from .env_spec import EnvSpec
from .grid import Grid
from .models import GameResult, ModelResult, evaluate_model, evaluate_recordings
from .pretrained import Pretrained, list_pretrained, load_pretrained
from .recording import RecordedEpisode, record_episode
from .reporting.report import write_report
from .verdict import write_verdict

__all__ = [
    "CompareResult",
    "EnvSpec",
    "RecordedEpisode",
    "GameResult",
    "Grid",
    "ModelResult",
    "Pretrained",
    "compare",
    "evaluate_model",
    "evaluate_recordings",
    "list_pretrained",
    "load_pretrained",
    "record_episode",
    "run_grid",
    "write_report",
    "write_verdict",
]
