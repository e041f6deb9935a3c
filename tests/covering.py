"""Lists, and products of two lists, as parameters of a test: some are fast, the rest nightly."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

__all__ = ["cover", "thin"]


def cover(rows: Sequence[Any], columns: Sequence[Any]) -> list[Any]:
    """All pairs; every row and every column is in one that is not nightly.

    The fast tests see a rule that fails for a row or for a column, the nightly ones a rule that fails for one pair.
    """
    quick = {(place % len(rows), place % len(columns)) for place in range(max(len(rows), len(columns)))}
    return [pytest.param(row, column, marks=() if (i, j) in quick else pytest.mark.nightly)
            for i, row in enumerate(rows) for j, column in enumerate(columns)]


def thin(values: Sequence[Any], step: int, first: int = 0) -> list[Any]:
    """All values, tuples being those of several parameters; every `step`th from the `first` on is not nightly.

    For a walk over a registry whose members differ in what other tests ask of each of them. Walks over the same members
    that begin at other places cover each other's gaps.
    """
    return [pytest.param(*(value if isinstance(value, tuple) else (value,)),
                         marks=() if place % step == first else pytest.mark.nightly)
            for place, value in enumerate(values)]
