"""Files that are either whole or not there: atomic writes, and reads that say what is wrong.

A write goes to a temporary file in the same folder, is flushed to disk, and then renamed
over the target, which POSIX makes atomic: a process killed at any moment leaves the old
file or the new one, never a half. Nothing here pickles. It is not a cache or a database.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from hrl_escape.errors import FileReadError, FileWriteError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # type: ignore[import-not-found]  # a dependency there

TEMPORARY_PREFIX = ".writing-"


@contextmanager
def atomic_writer(path: str | os.PathLike[str]) -> Iterator[IO[bytes]]:
    """Open a binary file that takes its name only once it is complete and on disk.

    Args:
        path: where the file shall be; missing parent folders are made.

    Yields:
        A binary file object. If the body raises, nothing changes at `path`.

    Raises:
        FileWriteError: the folder cannot be made or written, or the disk is full.
    """
    path = Path(path)
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor, name = tempfile.mkstemp(prefix=f"{TEMPORARY_PREFIX}{path.name}-", dir=path.parent)
        temporary = Path(name)
        with os.fdopen(descriptor, "wb") as file:
            os.fchmod(descriptor, 0o666 & ~_umask())  # mkstemp makes files private; ours are plain
            yield file
            file.flush()
            os.fsync(descriptor)
        os.replace(temporary, path)
        temporary = None
        _sync_folder(path.parent)
    except OSError as error:
        if isinstance(error, FileWriteError):
            raise
        raise FileWriteError(describe_write_failure(path, error)) from error
    finally:
        if temporary is not None:
            with suppress(OSError):
                temporary.unlink()


def write_bytes(path: str | os.PathLike[str], content: bytes) -> None:
    """Write bytes to `path` atomically; see `atomic_writer` for errors."""
    with atomic_writer(path) as file:
        file.write(content)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write text as UTF-8 to `path` atomically; see `atomic_writer` for errors."""
    write_bytes(path, text.encode("utf-8"))


def write_json(path: str | os.PathLike[str], value: Any, indent: int | None = 2) -> None:
    """Write a JSON value atomically; floats come back bit for bit, NaN is refused.

    Raises:
        FileWriteError: see `atomic_writer`.
        TypeError: the value holds something JSON has no form for.
        ValueError: the value holds NaN or an infinity, which JSON has no form for.
    """
    write_text(path, json.dumps(value, indent=indent, allow_nan=False) + "\n")


def read_bytes(path: str | os.PathLike[str], what: str = "file") -> bytes:
    """Read a whole file.

    Args:
        path: the file.
        what: what it should be, in words, for the message.

    Raises:
        FileReadError: it is missing, a folder, or may not be read.
    """
    path = Path(path)
    try:
        return path.read_bytes()
    except FileNotFoundError as error:
        raise FileReadError(f"{path}: no such {what}") from error
    except OSError as error:
        raise FileReadError(f"{path}: cannot read this {what}: {error.strerror or error}") from error


def read_text(path: str | os.PathLike[str], what: str = "file") -> str:
    """Read a whole UTF-8 file; see `read_bytes` for errors."""
    try:
        return read_bytes(path, what).decode("utf-8")
    except UnicodeDecodeError as error:
        raise FileReadError(f"{path}: this {what} is not UTF-8 text (byte {error.start})") from error


def read_json(path: str | os.PathLike[str], what: str = "JSON file") -> Any:
    """Read one JSON value.

    Raises:
        FileReadError: the file is missing, unreadable or not JSON; the message gives line and column.
    """
    text = read_text(path, what)
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise FileReadError(f"{path}: this {what} is truncated or not JSON: {error.msg} at {where}") from error


def read_toml(path: str | os.PathLike[str], what: str = "TOML file") -> dict[str, Any]:
    """Read a TOML document.

    Raises:
        FileReadError: the file is missing, unreadable or not TOML; the message gives line and column.
    """
    text = read_text(path, what)
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise FileReadError(f"{path}: this {what} is not TOML: {error}") from error


def claim_folder(path: str | os.PathLike[str]) -> None:
    """Make a folder and see that files can be written there, before work begins whose results belong there.

    Raises:
        FileWriteError: they cannot.
    """
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(prefix=TEMPORARY_PREFIX, dir=path):
            pass
    except OSError as error:
        raise FileWriteError(describe_write_failure(path, error)) from error


def describe_write_failure(path: str | os.PathLike[str], error: OSError) -> str:
    """The message for a failed write: what, where, why, and what to do about it."""
    return f"cannot write {path}: {error.strerror or error}. Free some space or choose a folder you may write to"


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _sync_folder(folder: Path) -> None:
    """Make the rename itself durable; some file systems refuse, and then there is nothing more to do."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
