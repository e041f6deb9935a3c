"""`Clock`: the optional limit on the time of one call.

Budgets decide by default, so that results do not depend on the machine. A clock, where one is asked
for, holds over the whole call; the compilation of kernels does not count.
"""

from __future__ import annotations

import math

from hrl_escape.errors import ConfigError
from hrl_escape.kernels import read_clock

__all__ = ["NO_LIMIT", "Clock", "OutOfTime"]


class OutOfTime(Exception):  # noqa: N818  # a signal between parts of one call, not a defect
    """The clock of a call has run out."""


class Clock:
    """Time limit of one call, from its construction on.

    Args:
        seconds: the limit; None for none.

    Raises:
        ConfigError: the limit is no number, or negative.
    """

    def __init__(self, seconds: float | None = None) -> None:
        is_number = isinstance(seconds, (int, float)) and not isinstance(seconds, bool)
        if seconds is not None and not (is_number and seconds >= 0.0):
            raise ConfigError("time_limit", seconds, "seconds, at least 0, or None for no limit")
        self._end = math.inf if seconds is None else read_clock() + seconds
        self.has_stopped = False

    def is_up(self) -> bool:
        """Return whether the time is over, and note in `has_stopped` that the call was cut short."""
        if self._end < math.inf and read_clock() >= self._end:
            self.has_stopped = True
        return self.has_stopped

    def check(self) -> None:
        """Raise `OutOfTime` once the time is over."""
        if self.is_up():
            raise OutOfTime


NO_LIMIT = Clock()
"""Clock that never runs out."""
