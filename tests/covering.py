"""Products of two lists as parameters of a test, of which a few pairs run by default and the rest under `-m slow`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

__all__ = ["cover"]


def cover(rows: Sequence[Any], columns: Sequence[Any]) -> list[Any]:
    """All pairs; every row and every column is in one that is not slow.

    A rule that fails for a row, or for a column, is seen by default; one that fails for a single pair under `-m slow`.
    """
    quick = {(place % len(rows), place % len(columns)) for place in range(max(len(rows), len(columns)))}
    return [pytest.param(row, column, marks=() if (i, j) in quick else pytest.mark.slow)
            for i, row in enumerate(rows) for j, column in enumerate(columns)]
