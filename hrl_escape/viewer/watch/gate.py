"""The gate between a driver and its room: pause, single steps and pace, turned from other threads."""

from __future__ import annotations

import threading


class Stopped(Exception):
    """Raised in the driver's thread to end it."""


class Gate:
    """Gate that lets primitives through at a pace, one at a time, or not at all.

    Attributes:
        pace: primitives a second; None for no limit.
    """

    def __init__(self, pace: float | None = 5.0, paused: bool = False) -> None:
        self.pace = pace
        self._turn = threading.Condition()
        self._paused, self._stopped = paused, False
        self._primitives, self._decisions = 0, 0

    @property
    def is_paused(self) -> bool:
        """Only what `step` lets through passes."""
        return self._paused

    @property
    def is_stopped(self) -> bool:
        """True once `stop` has closed the gate for good."""
        return self._stopped

    def pause(self, paused: bool = True) -> None:
        """Close the gate, or open it again."""
        with self._turn:
            self._paused = paused
            self._primitives = self._decisions = 0
            self._turn.notify_all()

    def step(self, primitives: int = 0, decisions: int = 0) -> None:
        """Let a number of primitives, or of whole decisions, through and close."""
        with self._turn:
            self._paused = True
            self._primitives, self._decisions = primitives, decisions
            self._turn.notify_all()

    def stop(self) -> None:
        """Make the driver give up, waiting or not."""
        with self._turn:
            self._stopped = True
            self._turn.notify_all()

    def pass_primitive(self) -> None:
        """Wait until a primitive may run. Raises `Stopped`."""
        with self._turn:
            self._turn.wait_for(lambda: self._stopped or not self._paused or self._primitives or self._decisions)
            if self._stopped:
                raise Stopped
            if self._paused and self._primitives:
                self._primitives -= 1

    def end_decision(self) -> None:
        """Note that a decision is over."""
        with self._turn:
            if self._decisions:
                self._decisions -= 1
