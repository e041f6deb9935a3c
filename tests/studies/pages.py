"""Pages of studies from lines written by hand."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from studies.page import render, write_page
from studies.running import open_store
from studies.study import find_study


def tell(study: str, lines: Sequence[Any], folder: Path | None = None) -> str:
    """Text of a study's page of lines; with a folder it is written there, and its figures are, which takes as long."""
    found = find_study(study)
    page = found.analysis.analyse(found, lines)
    if folder is not None:
        write_page(found, page, folder)
    return render(found, page)


def save(study: str, lines: Iterable[Any], folder: Path) -> Path:
    """Keep lines where `python -m studies STUDY --docs FOLDER` looks for them."""
    store = open_store(find_study(study), folder)
    store.add(lines)
    return store.path


def load(study: str, folder: Path) -> list[Any]:
    """Lines that are there."""
    return open_store(find_study(study), folder).load()
