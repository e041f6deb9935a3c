"""Worker processes: their lifetime, and locks that give one process at a time access to a folder."""

from __future__ import annotations

import errno
import fcntl
import multiprocessing
import os
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import wait
from pathlib import Path
from typing import IO

from hrl_escape.errors import RunBusyError
from hrl_escape.files import make_folder, open_for_writing

NO_LOCKS = (errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK, errno.EINVAL, errno.EBADF)
"""Errors of file systems without locks, such as Lustre mounted without `-o flock`, or NFS for locks of folders."""


def die_with_parent() -> None:
    """End this process when its parent process ends, for any reason."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def take_lock(file: IO[bytes]) -> bool:
    """Lock an open file until the process ends. Returns False if another process holds the lock.

    On a file system without locks, warns and returns True.
    """
    return _lock(file.fileno(), file.name, fcntl.LOCK_EX | fcntl.LOCK_NB)


def open_lock(path: Path, busy: str) -> IO[bytes]:
    """Open a file, which is created with its folder if it is missing, and lock it until it is closed.

    Args:
        path: the lock file.
        busy: message if another process holds the lock.

    Raises:
        RunBusyError: another process holds the lock.
        FileWriteError: the file cannot be written.
    """
    make_folder(path.parent)
    file = open_for_writing(path)
    if not take_lock(file):
        file.close()
        raise RunBusyError(busy)
    return file


@contextmanager
def taking_turns(folder: Path) -> Iterator[None]:
    """Wait until no other process is in such a block for the same folder, which is created if it is missing.

    Use it to read, change and write a file: each process then reads what the previous one has written. It leaves no
    file behind, and a process that dies leaves its block. On a file system without locks, it warns and does not wait.
    """
    make_folder(folder)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        _lock(descriptor, folder, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _lock(descriptor: int, name: object, how: int) -> bool:
    """Lock an open descriptor; return False if another process holds the lock."""
    try:
        fcntl.flock(descriptor, how)
    except OSError as error:
        if error.errno not in NO_LOCKS:
            return False
        warnings.warn(f"{name}: this file system has no locks ({error.strerror}), and two processes could use one "
                      "folder. Start each run only once", RuntimeWarning, stacklevel=3)
    return True
