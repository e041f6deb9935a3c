"""Atomic writes, and bounded reads with precise errors.

A write goes to a temporary file in the same folder, is flushed to disk, and then renamed over the target, which POSIX
makes atomic: a process that is killed leaves either the old file or the new one. A read accepts plain files up to a
size. This module never unpickles.
"""

from __future__ import annotations

import errno
import json
import math
import os
import re
import stat
import struct
import sys
import tempfile
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, Literal

from hrl_escape.errors import FileReadError, FileWriteError, describe_damage

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # type: ignore[import-not-found]  # a dependency on Python 3.10

TEMPORARY_PREFIX = ".writing-"
LARGEST_FILE = 2**28
"""Largest file that is read whole, bytes (256 MiB)."""
LARGEST_TOML = 2**20
"""Largest TOML file, bytes (1 MiB): people write these, and the parser is slow."""
DEEPEST = 100
"""Most levels of lists and tables in a JSON or TOML file."""
LARGEST_PARSED = 2**30
"""Most memory for the values of a JSON file, bytes (1 GiB), as `_estimate_memory` counts it."""
LARGEST_MEMBER_LIST = 2**22
"""Largest list of members of a zip, bytes (4 MiB, some 40,000 members)."""
DOTTED_KEY = re.compile(r"""(?<![\w.-])(?<!\.[ \t])(?:(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*)"""
                        f"{{{DEEPEST}}}", re.ASCII)
"""Matches keys with more parts than this, for which the TOML parser takes quadratic time."""


@contextmanager
def atomic_writer(path: str | os.PathLike[str], *, parents: bool = True) -> Iterator[IO[bytes]]:
    """Open a binary file that gets its name only once it is complete and on disk; an exception changes nothing.

    With `parents`, missing folders are created.

    Raises:
        FileWriteError: the folder cannot be created or written, the disk is full, or the target is not a plain file.
    """
    path = Path(path)
    temporary: Path | None = None
    try:
        _check_replaceable(path)
        if parents:
            path.parent.mkdir(parents=True, exist_ok=True)
        descriptor, name = tempfile.mkstemp(prefix=TEMPORARY_PREFIX, dir=path.parent)
        temporary = Path(name)
        with os.fdopen(descriptor, "wb") as file:
            os.fchmod(descriptor, 0o666 & ~_umask())  # mkstemp makes files private
            yield file
            file.flush()
            os.fsync(descriptor)
        os.replace(temporary, path)
        temporary = None
        _sync_folder(path.parent)
    except FileWriteError:
        raise
    except OSError as error:
        raise FileWriteError(describe_write_failure(path, error)) from error
    finally:
        if temporary is not None:
            with suppress(OSError):
                temporary.unlink()


def open_for_writing(path: str | os.PathLike[str], mode: Literal["ab", "wb"] = "ab") -> IO[bytes]:
    """Open a plain file that grows in place, such as a log, but never through a link; errors as in `atomic_writer`."""
    try:
        _check_replaceable(Path(path))
        return open(path, mode, opener=lambda name, flags: os.open(name, flags | os.O_NOFOLLOW, 0o666))
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise FileWriteError(f"cannot write {path}: it is a link. Choose the path of a plain file") from error
        raise FileWriteError(describe_write_failure(path, error)) from error


def _check_replaceable(path: Path) -> None:
    """Refuse devices and pipes, which a file would replace or which could block forever."""
    try:
        kind = _name_kind(path.stat())
    except FileNotFoundError:
        return
    except ValueError as error:  # the path contains NUL or half a character
        raise FileWriteError(describe_write_failure(path, error)) from error
    if kind:
        raise FileWriteError(f"cannot write {path}: it is {kind}, and only plain files can be written")


def _name_kind(status: os.stat_result) -> str:
    """Kind of a path that is not a plain file, in words; empty for a plain file."""
    if stat.S_ISREG(status.st_mode):
        return ""
    return "a folder" if stat.S_ISDIR(status.st_mode) else "a device or a pipe"


def write_bytes(path: str | os.PathLike[str], content: bytes) -> None:
    """Write bytes to `path` atomically; errors as in `atomic_writer`."""
    with atomic_writer(path) as file:
        file.write(content)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write text as UTF-8 to `path` atomically; errors as in `atomic_writer`."""
    write_bytes(path, text.encode("utf-8"))


def write_json(path: str | os.PathLike[str], value: Any, indent: int | None = 2, *, parents: bool = True) -> None:
    """Write a JSON value atomically. Floats are preserved exactly; NaN and infinities raise `ValueError`."""
    text = json.dumps(value, indent=indent, allow_nan=False) + "\n"
    with atomic_writer(path, parents=parents) as file:
        file.write(text.encode())


@contextmanager
def open_plain(path: str | os.PathLike[str], what: str = "file", largest: int = LARGEST_FILE) -> Iterator[IO[bytes]]:
    """Open a plain file for reading. Devices, pipes and folders are refused before a byte is read.

    Args:
        path: path of the file.
        what: kind of file for messages, in words.
        largest: largest size of the file, bytes.

    Raises:
        FileReadError: the file is missing, not a plain file, too large, or not readable.
    """
    path = Path(path)
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            status = os.fstat(descriptor)
            if kind := _name_kind(status):
                raise FileReadError(f"{path}: cannot read this {what}: it is {kind}, and only plain files are read")
            if status.st_size > largest:
                raise FileReadError(f"{path}: this {what} has {status.st_size:,} bytes; at most {largest:,} are read "
                                    "here")
            with os.fdopen(descriptor, "rb", closefd=False) as file:  # raises its own error for a folder
                yield file
        finally:
            os.close(descriptor)
    except FileReadError:
        raise
    except FileNotFoundError as error:
        raise FileReadError(f"{path}: no such {what}") from error
    except (OSError, ValueError) as error:  # a ValueError means NUL in the path
        raise FileReadError(f"{path}: cannot read this {what}: {getattr(error, 'strerror', None) or error}") from error


@contextmanager
def open_zip(file: IO[bytes], largest: int = LARGEST_MEMBER_LIST) -> Iterator[zipfile.ZipFile]:
    """Open a zip for reading, after a check of the size of its list of members, which `zipfile` reads whole.

    Args:
        file: the open file.
        largest: largest size of the list, bytes.

    Raises:
        ValueError: the file does not end as a zip does, has a comment, or its list is larger.
    """
    file.seek(-min(98, file.seek(0, os.SEEK_END)), os.SEEK_END)
    end = file.read().rjust(98, b"\0")  # 22 bytes; in a zip of 64 bits 56 and 20 more before them
    if end[76:80] != b"PK\5\6" or end[96:] != b"\0\0":
        raise ValueError("it does not end as a zip does")
    (size,) = struct.unpack("<L", end[88:92])
    if end[56:60] == b"PK\6\7":
        if end[:4] != b"PK\6\6":
            raise ValueError("it does not end as a zip does")
        (size,) = struct.unpack("<Q", end[40:48])
    if size > largest:
        raise ValueError(f"its list of members has {size:,} bytes; at most {largest:,} are read here")
    with zipfile.ZipFile(file) as archive:
        yield archive


def list_members(path: str | os.PathLike[str], what: str, largest: int) -> list[str]:
    """Return the names in a zip; see `open_plain` for arguments and errors.

    Raises:
        BadZipFile: the file is not a zip, or is damaged.
    """
    with open_plain(path, what, largest) as file:
        try:
            with open_zip(file) as archive:
                return archive.namelist()
        except (OSError, ValueError, zipfile.BadZipFile, NotImplementedError) as error:
            raise zipfile.BadZipFile(describe_damage(error)) from error


def check_files(paths: Iterable[str], what: str, endings: Sequence[str], largest: int) -> None:
    """Check files before a library opens them: plain, of known kinds, and not too large together.

    A file named twice counts once. `endings` are the endings of the known kinds, such as `.stl`. Archives are not
    allowed, because their unpacked size is unknown. Raises the errors of `open_plain`.
    """
    left = largest
    for name in sorted(set(paths)):
        if Path(name).suffix.lower() not in endings:
            raise FileReadError(f"{name[:200]}: this {what} must end in one of {', '.join(endings)}")
        with open_plain(name, what, largest) as file:
            left -= os.fstat(file.fileno()).st_size
        if left < 0:
            raise FileReadError(f"{name}: files of this kind ({what}) have more than {largest:,} bytes together. "
                                "Simplify them")


def read_bytes(path: str | os.PathLike[str], what: str = "file", largest: int = LARGEST_FILE) -> bytes:
    """Read a whole file; see `open_plain` for arguments and errors."""
    with open_plain(path, what, largest) as file:
        return file.read(os.fstat(file.fileno()).st_size)


def read_text(path: str | os.PathLike[str], what: str = "file", largest: int = LARGEST_FILE) -> str:
    """Read a whole UTF-8 file; see `open_plain` for arguments and errors."""
    try:
        return read_bytes(path, what, largest).decode("utf-8")
    except UnicodeDecodeError as error:
        raise FileReadError(f"{path}: this {what} is not UTF-8 text (byte {error.start})") from error


def read_json(path: str | os.PathLike[str], what: str = "JSON file") -> Any:
    """Read one JSON value of finite numbers, at most `DEEPEST` levels deep; the error gives the place."""
    return parse_json(read_text(path, what), path, what)


def parse_json(text: str | bytes, path: str | os.PathLike[str], what: str, *, takes_nan: bool = False) -> Any:
    """Parse the text of a JSON file, as in `read_json`; with `takes_nan`, NaN and infinities are numbers."""
    needed = _estimate_memory(text)
    if needed > LARGEST_PARSED:
        raise FileReadError(f"{path}: this {what} cannot be read: its values may take {needed >> 20:,} MiB of memory; "
                            f"at most {LARGEST_PARSED >> 20:,} are read here")
    try:
        value = json.loads(text) if takes_nan else json.loads(
            text, parse_constant=_refuse_constant, parse_float=_read_float)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise FileReadError(f"{path}: this {what} is truncated or not JSON: {error.msg} at {where}") from error
    except (ValueError, RecursionError) as error:
        raise FileReadError(f"{path}: this {what} cannot be read: {_describe_extreme(error)}") from error
    _check_depth(value, path, what)
    return value


def read_toml(path: str | os.PathLike[str], what: str = "TOML file") -> dict[str, Any]:
    """Read a TOML document, at most `DEEPEST` levels deep; the error gives line and column."""
    text = read_text(path, what, LARGEST_TOML)
    if DOTTED_KEY.search(text):
        raise FileReadError(f"{path}: this {what} cannot be read: {_describe_extreme(RecursionError())}")
    try:
        value = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise FileReadError(f"{path}: this {what} is not TOML: {error}") from error
    except (ValueError, RecursionError) as error:
        raise FileReadError(f"{path}: this {what} cannot be read: {_describe_extreme(error)}") from error
    _check_depth(value, path, what)
    return value


def _estimate_memory(text: str | bytes) -> int:
    """Generous estimate, in bytes, of the memory of a JSON text's values in CPython."""
    marks = {"{": 240, "[": 90, ":": 40, ",": 40}
    content = text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass")
    return len(content) + sum(cost * content.count(mark.encode()) for mark, cost in marks.items())


def _read_float(text: str) -> float:
    value = float(text)
    if math.isinf(value):
        raise ValueError(f"{text[:20]} is larger than every finite number")
    return value


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is not a JSON number")


def _describe_extreme(error: Exception) -> str:
    if isinstance(error, RecursionError):
        return f"it is nested more than {DEEPEST} levels deep"
    return "it has a number of thousands of digits" if "integer string conversion" in str(error) else str(error)


def _check_depth(value: Any, path: str | os.PathLike[str], what: str) -> None:
    """Refuse nesting so deep that recursive functions would fail."""
    level = [value]
    for _ in range(DEEPEST + 1):
        level = [part for part in level if isinstance(part, (dict, list))]
        if not level:
            return
        level = [part for outer in level for part in (outer.values() if isinstance(outer, dict) else outer)]
    raise FileReadError(f"{path}: this {what} cannot be read: {_describe_extreme(RecursionError())}")


def make_folder(path: str | os.PathLike[str]) -> None:
    """Create a folder and its missing parents; errors as in `atomic_writer`."""
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:  # a ValueError means NUL or half a character in the path
        raise FileWriteError(describe_write_failure(path, error)) from error


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Make a folder for files that a library reads, and delete it after the block; errors as in `atomic_writer`."""
    try:
        with tempfile.TemporaryDirectory(prefix="hrl_escape-") as folder:
            yield Path(folder)
    except (FileReadError, FileWriteError):
        raise
    except OSError as error:
        raise FileWriteError(describe_write_failure("the folder of temporary files (TMPDIR)", error)) from error


def clear_unfinished(folder: str | os.PathLike[str]) -> None:
    """Remove the remains of killed writers in a folder. No other process may be writing there."""
    with suppress(OSError):
        for path in Path(folder).glob(f"{TEMPORARY_PREFIX}*"):
            path.unlink()


def describe_write_failure(path: str | os.PathLike[str], error: OSError | ValueError) -> str:
    """Return the message for a failed write: path, cause and remedy."""
    cause = getattr(error, "strerror", None) or error
    return f"cannot write {path}: {cause}. Free some space or choose a writable folder"


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _sync_folder(folder: Path) -> None:
    """Make the rename itself durable, if the file system supports it."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
