"""Budget of work: sampling counts its operations, so that it ends after the same work on every machine."""

from __future__ import annotations


class OutOfWork(Exception):
    """The budget is spent."""


class Work:
    """Counter of work against a limit, in units of about a microsecond on one core.

    Args:
        limit: most units.

    Attributes:
        done: units spent.
    """

    def __init__(self, limit: float) -> None:
        self.limit, self.done = limit, 0.0

    def spend(self, units: float) -> None:
        """Charge units of work to the budget.

        Raises:
            OutOfWork: the budget is spent.
        """
        self.done += units
        if self.done > self.limit:
            raise OutOfWork
