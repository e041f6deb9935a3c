"""`Clock`: optional time limit of one call, with cancellation from another thread.

By default calls are limited by budgets, which keeps results independent of the machine. A clock limits the whole call,
without the compilation of kernels.
"""

from __future__ import annotations

import math
import threading

from hrl_escape.errors import ConfigError, PlanningReason
from hrl_escape.kernels import read_clock


class OutOfTime(Exception):  # noqa: N818  # a signal within one call, not a defect
    """The clock of a call has run out."""


class Clock:
    """Time limit of one call, from the construction of the clock.

    Args:
        seconds: the limit; by default none.
        stop: event that another thread sets to end the call.

    Raises:
        ConfigError: the limit is negative or not a number.
    """

    def __init__(self, seconds: float | None = None, stop: threading.Event | None = None) -> None:
        is_number = isinstance(seconds, (int, float)) and not isinstance(seconds, bool)
        if seconds is not None and not (is_number and seconds >= 0.0):
            raise ConfigError("time_limit", seconds, "seconds, at least 0, or None for no limit")
        self._end = math.inf if seconds is None else read_clock() + seconds
        self._stop = stop
        self.has_stopped = False

    def is_up(self) -> bool:
        """Return whether the call must end, and record it in `has_stopped`."""
        if self.is_cancelled or (self._end < math.inf and read_clock() >= self._end):
            self.has_stopped = True
        return self.has_stopped

    @property
    def is_cancelled(self) -> bool:
        """True if another thread has cancelled the call."""
        return self._stop is not None and self._stop.is_set()

    @property
    def reason(self) -> PlanningReason:
        """Reason of a failure that this clock caused."""
        return PlanningReason.CANCELLED if self.is_cancelled else PlanningReason.TIMEOUT

    def check(self) -> None:
        """Raise `OutOfTime` once the call must end."""
        if self.is_up():
            raise OutOfTime


NO_LIMIT = Clock()
"""Clock that never runs out."""
