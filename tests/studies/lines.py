"""Lines of studies, kept in a folder."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from studies.running import open_store
from studies.study import find_study


def save(study: str, lines: Iterable[Any], folder: Path) -> Path:
    """Keep lines where `python -m studies STUDY --docs FOLDER` looks for them."""
    store = open_store(find_study(study), folder)
    store.add(lines)
    return store.path


def load(study: str, folder: Path) -> list[Any]:
    """Lines that are there."""
    return open_store(find_study(study), folder).load()
