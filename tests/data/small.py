"""Small recordings for tests, recorded once a process: some thousand primitives in one or two rooms of `pair`."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

from hrl_escape.data.catalogue import DataSpec
from hrl_escape.data.record import record
from hrl_escape.data.recording import Recording, load_recording

__all__ = ["make_recording", "save_small"]

_FOLDER = tempfile.TemporaryDirectory(prefix="recordings-")


@cache
def save_small(kind: str = "play", rung: str = "pair", primitives: int = 2_000) -> Path:
    """File of a small recording."""
    path = Path(_FOLDER.name) / f"{rung}-{kind}-{primitives}.npz"
    record(DataSpec(rung, kind), path, primitives=primitives)
    return path


def make_recording(kind: str = "play", rung: str = "pair", primitives: int = 2_000) -> Recording:
    """The recording in it."""
    return load_recording(save_small(kind, rung, primitives))
