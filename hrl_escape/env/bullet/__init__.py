"""The Bullet engine: one room, kinematic or rigid, the cameras that look at it, its window, and pybullet's clients.

Importing any module of this package imports pybullet first, here, without the line that its C
code writes to stderr. Everything else that C libraries write reaches the user at once.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

from hrl_escape.errors import UnsupportedError


@contextmanager
def _drop_stderr_lines(start: bytes) -> Iterator[None]:
    """Hold back what is written to file descriptor 2, then pass on the lines that do not begin with `start`."""
    try:
        written = tempfile.TemporaryFile()
        stderr = os.dup(2)
    except OSError:  # no space for a file, or stderr is closed and nobody reads it
        yield
        return
    with written:
        os.dup2(written.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            written.seek(0)
            os.write(2, b"".join(line for line in written if not line.startswith(start)))


with _drop_stderr_lines(b"pybullet build time"):
    import pybullet


def connect(window: bool = False) -> int:
    """Open a physics client; returns pybullet's number of it.

    Raises:
        UnsupportedError: a window without a display, or too many clients in this process.
    """
    if window and sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        raise UnsupportedError("Bullet's window needs a display (DISPLAY is not set); use pictures (rgb_array) instead")
    client = pybullet.connect(pybullet.GUI if window else pybullet.DIRECT)
    if client < 0:
        raise UnsupportedError("Bullet gives no further physics client; close rooms that are no longer used")
    return client


def disconnect(client: int) -> None:
    """Free a physics client, if it is there yet."""
    if pybullet.isConnected(client):
        pybullet.disconnect(client)
