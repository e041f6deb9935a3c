"""Pages of studies from lines written by hand."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from studies.page import write_page
from studies.running import open_store
from studies.study import find_study


def tell(study: str, lines: Sequence[Any], folder: Path) -> str:
    """Text of a study's page of lines, written into a folder with its figures."""
    found = find_study(study)
    write_page(found, found.analysis.analyse(found, lines), folder)
    return (folder / f"{found.page}.md").read_text()


def save(study: str, lines: Iterable[Any], folder: Path) -> Path:
    """Keep lines where `python -m studies STUDY --docs FOLDER` looks for them."""
    store = open_store(find_study(study), folder)
    store.add(lines)
    return store.path


def load(study: str, folder: Path) -> list[Any]:
    """Lines that are there."""
    return open_store(find_study(study), folder).load()
