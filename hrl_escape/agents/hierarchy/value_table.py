"""A table of values under any keys: what agents share whose states differ in form from task to task."""

from __future__ import annotations

import ast
from collections.abc import Hashable, Iterator
from typing import Any

import numpy as np

from hrl_escape.agents.state import StateTree

__all__ = ["ValueTable"]


class ValueTable:
    """Values and update counts by key; keys are literals: numbers, text, bytes, None and tuples of these.

    Args:
        learning_rate: alpha at a key's first update.
        power: the n-th update has alpha / n^power.
        initial: value of a key never updated.
    """

    def __init__(self, learning_rate: float, power: float = 0.0, initial: float = 0.0) -> None:
        self._rate, self._power, self.initial = learning_rate, power, initial
        self._values: dict[Hashable, float] = {}
        self._counts: dict[Hashable, int] = {}

    def __len__(self) -> int:
        return len(self._values)

    def __contains__(self, key: Hashable) -> bool:
        return key in self._values

    def __iter__(self) -> Iterator[Any]:
        return iter(self._values)

    def get(self, key: Hashable) -> float:
        """The value of a key."""
        return self._values.get(key, self.initial)

    def update(self, key: Hashable, target: float) -> float:
        """Move a value towards a target, x <- x + alpha (target - x); returns the error before it."""
        value = self._values.get(key, self.initial)
        count = self._counts.get(key, 0) + 1
        alpha = self._rate / count**self._power if self._power else self._rate
        # With alpha = 1 the target must be reached exactly.
        self._values[key] = (1 - alpha) * value + alpha * target
        self._counts[key] = count
        return target - value

    def state_dict(self) -> StateTree:
        """Keys as literals, values and counts, in order of first update."""
        return {
            "keys": [repr(key) for key in self._values],
            "values": np.array(list(self._values.values()), np.float64),
            "counts": np.array(list(self._counts.values()), np.int64),
        }

    def load_state_dict(self, state: StateTree) -> None:
        """Restore what `state_dict` gave."""
        keys = [ast.literal_eval(key) for key in state["keys"]]
        self._values = dict(zip(keys, np.asarray(state["values"]).tolist(), strict=True))
        self._counts = dict(zip(keys, np.asarray(state["counts"]).tolist(), strict=True))
