"""The Bullet engine: one room, kinematic or rigid, its cameras, its window, and pybullet's clients.

Importing any module of this package imports pybullet here first, without the line that its C code writes to stderr. All
other output of C libraries is passed on.
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
    """Capture file descriptor 2, then pass on the lines that do not begin with `start`."""
    try:
        written = tempfile.TemporaryFile()
        stderr = os.dup(2)
    except OSError:  # there is no space for a file, or stderr is closed
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
    """Open a physics client and return pybullet's number of it.

    Raises:
        UnsupportedError: a window without a display, or too many clients in this process.
    """
    if window and sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        raise UnsupportedError("Bullet's window needs a display, and DISPLAY is not set. Use render_mode='rgb_array'")
    client = pybullet.connect(pybullet.GUI if window else pybullet.DIRECT)
    if client < 0:
        raise UnsupportedError("Bullet has no free physics client. Close rooms that are no longer used")
    return client


def disconnect(client: int) -> None:
    """Free a physics client, if it exists."""
    if pybullet.isConnected(client):
        pybullet.disconnect(client)
