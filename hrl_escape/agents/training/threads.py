"""Threads of torch while a run lasts: sums over several differ in the last bit, so their number is part of a run."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["using_threads"]


@contextmanager
def using_threads(threads: int) -> Iterator[None]:
    """Set the number of torch's threads, and restore it afterwards; nothing happens where torch is not loaded."""
    torch = sys.modules.get("torch")
    if torch is None:
        yield
        return
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        yield
    finally:
        torch.set_num_threads(before)
