"""Values that are computed once for each key, such as what a state of the puzzle looks like."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

_Key = TypeVar("_Key")
_Value = TypeVar("_Value")


class Memo(dict[_Key, _Value]):
    """Values, computed when a key is first asked for.

    Args:
        compute: function of a key. If it were a method of the owner, only the collector of garbage would free both.
        most: largest number of values. Beyond it all are dropped, as states of a continuous puzzle rarely repeat.
    """

    def __init__(self, compute: Callable[[_Key], _Value], most: int = 4096) -> None:
        super().__init__()
        self._compute, self._most = compute, most

    def __missing__(self, key: _Key) -> _Value:
        if len(self) > self._most:
            self.clear()
        value = self[key] = self._compute(key)
        return value
