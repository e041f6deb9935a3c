"""Spaces that say more than their numbers: observations in rows of objects, and actions that are about an object.

An agent that knows neither rooms nor options reads here which action points at which row, so that its network can
treat all objects alike (see `agents/components/networks.py`). To everybody else they are a Box and a Discrete.
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


def keep_space(new: SpaceT, old: spaces.Space[Any] | None) -> SpaceT:
    """Return the space of a new room so that samples go on as seeded: the old space itself, if it is an equal one.

    Args:
        new: space of the new room.
        old: space of the room before; None if there was none.

    Returns:
        The old space where the two are equal, else the new one with the random numbers of the old one.
    """
    if old is None:
        return new
    marks = ("rows", "words", "about")
    if type(new) is type(old) and new == old and all(getattr(new, m, ()) == getattr(old, m, ()) for m in marks):
        return old  # type: ignore[return-value]  # of the same type
    new._np_random = old._np_random  # pyright: ignore[reportPrivateUsage]  # a space has no setter for it
    return new


def bound_episodes(spec: EnvSpec | None, steps: int) -> EnvSpec | None:
    """Copy of an environment's specification whose `max_episode_steps` is at most the steps that its episodes have."""
    if spec is None:
        return None
    made, given = copy.copy(spec), spec.max_episode_steps
    made.max_episode_steps = steps if given is None or given < 1 else min(given, steps)
    return made


def make_vector_space(low: NDArray[Any], high: NDArray[Any], rows: Sequence[str], words: Sequence[str]) -> spaces.Box:
    """Space of a vector observation: an `ObjectsBox` where it begins with rows of objects, else a plain Box."""
    return ObjectsBox(low, high, rows, words) if rows else spaces.Box(low, high, dtype=low.dtype.type)
