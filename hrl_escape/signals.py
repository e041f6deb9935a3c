"""Signals that ask a process to end, as an exception: what must be left in order is left so on the way out."""

from __future__ import annotations


class Ended(BaseException):
    """A signal asks this process to end.

    Attributes:
        number: of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def end_by_signal(number: int, frame: object) -> None:
    """Handler of signals that raises `Ended`."""
    raise Ended(number)
