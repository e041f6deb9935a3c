"""Spaces with structure: observations in rows of objects, and actions that refer to an object.

An agent that is independent of rooms and options reads from them which action refers to which row, and its network can
then treat all objects alike (see `agents/components/networks.py`). Other code can use them as a Box and a Discrete.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

SpaceT = TypeVar("SpaceT", bound=spaces.Space[Any])


class ObjectsBox(spaces.Box):
    """Vector that begins with rows of equal length, one per object; the remaining numbers are context.

    Args:
        low: smallest value of each number, (rows x words + context,).
        high: largest value of each number.
        rows: name of each row's object.
        words: name of each number in a row. `present` is 0 in the rows of absent objects, like all their numbers.
    """

    def __init__(self, low: NDArray[Any], high: NDArray[Any], rows: Sequence[str], words: Sequence[str]) -> None:
        super().__init__(low, high, dtype=low.dtype.type)
        self.rows, self.words = tuple(rows), tuple(words)

    @property
    def context(self) -> int:
        """Count of numbers after the rows."""
        return int(np.prod(self.shape)) - len(self.rows) * len(self.words)


class PointingDiscrete(spaces.Discrete):
    """`Discrete` whose actions can each refer to one object.

    Args:
        n: number of actions.
        about: name of each action's object, as in `ObjectsBox.rows`, or None.
    """

    def __init__(self, n: int, about: Sequence[str | None]) -> None:
        super().__init__(n)
        self.about = tuple(about)


def keep_space(new: SpaceT, old: spaces.Space[Any] | None) -> SpaceT:
    """Return the space of a new room with the random stream of the old space; the old space itself if they are equal.

    Args:
        new: space of the new room.
        old: space of the previous room, or None.

    Returns:
        The old space if the two are equal, otherwise the new one with the random generator of the old one.
    """
    if old is None:
        return new
    marks = ("rows", "words", "about")
    if type(new) is type(old) and new == old and all(getattr(new, m, ()) == getattr(old, m, ()) for m in marks):
        return old  # type: ignore[return-value]  # of the same type
    new._np_random = old._np_random  # pyright: ignore[reportPrivateUsage]  # spaces have no setter for it
    return new


def bound_episodes(spec: EnvSpec | None, steps: int) -> EnvSpec | None:
    """Copy an environment's specification with `max_episode_steps` limited to `steps`."""
    if spec is None:
        return None
    made, given = copy.copy(spec), spec.max_episode_steps
    made.max_episode_steps = steps if given is None or given < 1 else min(given, steps)
    return made


def make_vector_space(low: NDArray[Any], high: NDArray[Any], rows: Sequence[str], words: Sequence[str]) -> spaces.Box:
    """Return the space of a vector observation: an `ObjectsBox` if it begins with rows of objects, otherwise a Box."""
    return ObjectsBox(low, high, rows, words) if rows else spaces.Box(low, high, dtype=low.dtype.type)
