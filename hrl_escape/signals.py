"""Termination signals as an exception, which cleans up on the way out of the program."""

from __future__ import annotations


class Ended(BaseException):
    """A signal requests the end of this process.

    Attributes:
        number: number of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def end_by_signal(number: int, frame: object) -> None:
    """Raise `Ended`; install this as the handler of a signal."""
    raise Ended(number)
