"""Spaces that say more than their numbers: observations in rows of objects, and actions that are about an object.

An agent that knows neither rooms nor options reads here which action points at which row, so that its network can
treat all objects alike (see `agents/components/networks.py`). To everybody else they are a Box and a Discrete.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray


class ObjectsBox(spaces.Box):
    """Vector whose first numbers are rows of one kind, a row an object; whatever follows is context.

    Args:
        low: smallest value of each number, (rows x words + context,).
        high: largest value of each number.
        rows: name of each row's object.
        words: name of each number in a row; `present` is 0 in the rows of absent objects, which hold nothing else.
    """

    def __init__(self, low: NDArray[Any], high: NDArray[Any], rows: Sequence[str], words: Sequence[str]) -> None:
        super().__init__(low, high, dtype=low.dtype.type)
        self.rows, self.words = tuple(rows), tuple(words)

    @property
    def context(self) -> int:
        """Number of numbers after the rows."""
        return int(np.prod(self.shape)) - len(self.rows) * len(self.words)


class PointingDiscrete(spaces.Discrete):
    """`Discrete` whose actions may each be about one object.

    Args:
        n: number of actions.
        about: for each action the name of its object, as in `ObjectsBox.rows`, or None.
    """

    def __init__(self, n: int, about: Sequence[str | None]) -> None:
        super().__init__(n)
        self.about = tuple(about)


def make_vector_space(low: NDArray[Any], high: NDArray[Any], rows: Sequence[str], words: Sequence[str]) -> spaces.Box:
    """Space of a vector observation: an `ObjectsBox` where it begins with rows of objects, else a plain Box."""
    return ObjectsBox(low, high, rows, words) if rows else spaces.Box(low, high, dtype=low.dtype.type)
