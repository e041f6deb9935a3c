"""Budget of work: sampling counts what it does, so that it ends after the same work on every machine."""

from __future__ import annotations

__all__ = ["OutOfWork", "Work"]


class OutOfWork(Exception):
    """The budget is spent."""


class Work:
    """Work done and allowed, in units of about a microsecond on one core.

    Args:
        limit: most units.

    Attributes:
        done: units spent.
    """

    def __init__(self, limit: float) -> None:
        self.limit, self.done = limit, 0.0

    def spend(self, units: float) -> None:
        """Count some work.

        Raises:
            OutOfWork: the budget is spent.
        """
        self.done += units
        if self.done > self.limit:
            raise OutOfWork
