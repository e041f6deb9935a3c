"""The Bullet engine: one room, kinematic or rigid, its cameras, its window, and pybullet's clients.

`pybullet` of this module is imported on first use, without the line that its C code writes to stderr. All other output
of C libraries is passed on. Physics, the window and the cameras need pybullet; kinematic rooms step without it.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from hrl_escape.errors import MissingExtraError, UnsupportedError


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


@cache
def load_pybullet() -> Any:
    """Import pybullet.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        with _drop_stderr_lines(b"pybullet build time"):
            import pybullet
    except ImportError as error:
        raise MissingExtraError("pybullet", "bullet", "physics and Bullet's pictures (kinematic rooms step without it)"
                                ) from error
    return pybullet


def __getattr__(name: str) -> Any:
    """Import pybullet for modules that name it; raises as `load_pybullet`."""
    if name == "pybullet":
        return load_pybullet()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def is_connected(client: int) -> bool:
    """Return whether a physics client exists."""
    return bool(load_pybullet().isConnected(client))


def connect(window: bool = False) -> int:
    """Open a physics client and return pybullet's number of it.

    Raises:
        UnsupportedError: a window without a display, or too many clients in this process.
    """
    if window and sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        raise UnsupportedError("Bullet's window needs a display, and DISPLAY is not set. Use render_mode='rgb_array'")
    pybullet = load_pybullet()
    client = pybullet.connect(pybullet.GUI if window else pybullet.DIRECT)
    if client < 0:
        raise UnsupportedError("Bullet has no free physics client. Close rooms that are no longer used")
    return client


def disconnect(client: int) -> None:
    """Free a physics client, if it exists."""
    if is_connected(client):
        load_pybullet().disconnect(client)
