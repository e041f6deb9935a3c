"""Freed memory kept for the next block of its size, where large tensors come and go with every minibatch.

glibc gives blocks of some megabytes back to the system as soon as they are freed, so that each minibatch of many
streams pays for fresh, zeroed pages. What is computed does not depend on it.
"""

from __future__ import annotations

import ctypes
import sys

__all__ = ["keep_freed_memory"]

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # parameters of glibc's mallopt
_KEPT = 1 << 30  # bytes


def keep_freed_memory() -> None:
    """Let this process keep up to 1 GiB of freed memory; nothing happens with a C library other than glibc."""
    if sys.platform != "linux":
        return
    set_option = getattr(ctypes.CDLL(None), "mallopt", None)
    if set_option is not None:
        set_option(_MMAP_THRESHOLD, _KEPT)
        set_option(_TRIM_THRESHOLD, _KEPT)
