"""Trained agents that come with the package: for each rung the best of the published baselines, in its own room.

Each is the folder of a training run, cut down to its description and one checkpoint: what `load_agent` and
`hrl-escape watch` need. Nothing in it is pickled.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

CHECKPOINT = "checkpoint.npz"
_FOLDER = Path(str(files("hrl_escape.ladder") / "data" / "agents"))


def list_trained_agents() -> tuple[str, ...]:
    """Names of the rungs that have one."""
    return tuple(sorted(path.parent.name for path in _FOLDER.glob(f"*/{CHECKPOINT}")))


def find_trained_agent(rung: str) -> Path | None:
    """Folder of a rung's trained agent; None where there is none."""
    return _FOLDER / rung if rung in list_trained_agents() else None
