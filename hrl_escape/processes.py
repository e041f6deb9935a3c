"""Worker processes: their life and the locks by which they keep each other out of a folder."""

from __future__ import annotations

import errno
import fcntl
import multiprocessing
import os
import threading
import warnings
from multiprocessing.connection import wait
from typing import IO

__all__ = ["die_with_parent", "take_lock"]

NO_LOCKS = (errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK, errno.EINVAL)
"""Errors of file systems without locks, such as Lustre mounted without `-o flock`."""


def die_with_parent() -> None:
    """End this process when its parent process ends, for whatever reason."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def take_lock(file: IO[bytes]) -> bool:
    """Lock an open file; the lock falls with the process, however it ends.

    A file system without locks is warned of, and its files count as free.

    Returns:
        False where another process holds the lock.
    """
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno not in NO_LOCKS:
            return False
        warnings.warn(f"{file.name}: this file system has no locks ({error.strerror}), so that nothing keeps two "
                      "processes out of one folder: start each but once", RuntimeWarning, stacklevel=2)
    return True
