"""The Bullet engine: one room, kinematic or rigid, the cameras that look at it, and its window.

Importing any module of this package imports pybullet first, here, without the line that its C
code writes to stderr. Everything else that C libraries write reaches the user at once.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager


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
    import pybullet  # noqa: F401  # so that the modules of this package find it imported
