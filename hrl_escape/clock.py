"""`Clock`: the optional limit on the time of one call, and the way to cancel it from another thread.

Budgets decide by default, so that results do not depend on the machine. A clock, where one is asked
for, holds over the whole call; the compilation of kernels does not count.
"""

from __future__ import annotations

import math
import threading

from hrl_escape.errors import ConfigError, PlanningReason
from hrl_escape.kernels import read_clock


class OutOfTime(Exception):  # noqa: N818  # a signal between parts of one call, not a defect
    """The clock of a call has run out."""


class Clock:
    """Time limit of one call, from its construction on.

    Args:
        seconds: the limit; None for none.
        stop: event that ends the call once another thread sets it.

    Raises:
        ConfigError: the limit is no number, or negative.
    """

    def __init__(self, seconds: float | None = None, stop: threading.Event | None = None) -> None:
        is_number = isinstance(seconds, (int, float)) and not isinstance(seconds, bool)
        if seconds is not None and not (is_number and seconds >= 0.0):
            raise ConfigError("time_limit", seconds, "seconds, at least 0, or None for no limit")
        self._end = math.inf if seconds is None else read_clock() + seconds
        self._stop = stop
        self.has_stopped = False

    def is_up(self) -> bool:
        """Return whether the call must end, and note in `has_stopped` that it was cut short."""
        if self.is_cancelled or (self._end < math.inf and read_clock() >= self._end):
            self.has_stopped = True
        return self.has_stopped

    @property
    def is_cancelled(self) -> bool:
        """Another thread has cancelled the call."""
        return self._stop is not None and self._stop.is_set()

    @property
    def reason(self) -> PlanningReason:
        """Reason of a failure for which this clock is to blame."""
        return PlanningReason.CANCELLED if self.is_cancelled else PlanningReason.TIMEOUT

    def check(self) -> None:
        """Raise `OutOfTime` once the call must end."""
        if self.is_up():
            raise OutOfTime


NO_LIMIT = Clock()
"""Clock that never runs out."""
