"""Ctrl-C in a run: it ends after the episode that is running, whose end is a point to resume from."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

__all__ = ["deferring_interrupts"]

NOTICE = b"\ninterrupted: the run is saved once this episode ends; Ctrl-C again stops it at once\n"


@contextmanager
def deferring_interrupts() -> Iterator[Callable[[], bool]]:
    """Note a first Ctrl-C instead of raising `KeyboardInterrupt`; a second one raises it.

    A terminal is told. Where Python's own handler is not in place, as in threads and in workers that ignore the
    signal, nothing changes.

    Yields:
        Function that tells whether Ctrl-C has been pressed.
    """
    pressed = threading.Event()

    def note(number: int, frame: FrameType | None) -> None:
        if pressed.is_set():
            raise KeyboardInterrupt
        pressed.set()
        if sys.stderr is not None and sys.stderr.isatty():
            os.write(2, NOTICE)  # a handler may run amid a print

    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield pressed.is_set
        return
    signal.signal(signal.SIGINT, note)
    try:
        yield pressed.is_set
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
