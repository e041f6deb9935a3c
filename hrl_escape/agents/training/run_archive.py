"""Run folders as single files, to be moved and handed on.

An archive is a zip of the files by which a run is read and resumed: `manifest.json` first, with the bytes and SHA-256
of each part, then the parts. Nothing in it is compressed and no time is kept: equal runs give equal archives, byte for
byte, and no archive unpacks to more than its own bytes. Reading takes the known names only, once each, so that no name
in an archive, absolute, with `..` or of a link, ever becomes a path.
"""

from __future__ import annotations

import dataclasses
import errno
import hashlib
import json
import os
import shutil
import stat
import struct
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from hrl_escape.agents.training.env_description import compute_digest, hash_large_parts
from hrl_escape.agents.training.run_folder import BEST, LAST, check_run, read_run
from hrl_escape.errors import (
    CheckpointError,
    EscapeError,
    FileReadError,
    FileWriteError,
    RunBusyError,
    describe_damage,
    show_value,
)
from hrl_escape.files import (
    TEMPORARY_PREFIX,
    atomic_writer,
    describe_write_failure,
    make_folder,
    open_plain,
    parse_json,
)
from hrl_escape.processes import take_lock
from hrl_escape.settings import read_record

__all__ = ["Part", "RunSummary", "pack_run", "read_summary", "unpack_run"]

MANIFEST, FORMAT = "manifest.json", 1
RUN_FILES = ("run.json", "log.jsonl", LAST, BEST, "result.json")
"""Files of a run that an archive holds; locks and TensorBoard's files stay behind."""
LARGEST_ARCHIVE = 2**32 - 2**16
"""Bytes of the largest archive: what a zip holds without its extension to 64 bits."""
LARGEST_DIRECTORY = 2**12
"""Bytes of a zip's list of members; six of ours take under 500."""
CHUNK = 2**20
DISK_TROUBLE = (errno.ENOSPC, errno.EDQUOT, errno.EACCES, errno.EROFS, errno.EFBIG)
"""Errors of the folder that parts are written to; the archive is not to blame."""


@dataclasses.dataclass(frozen=True)
class Part:
    """File of a run: its name, its size in bytes, and the SHA-256 of its content in hexadecimal digits."""

    name: str
    bytes: int
    sha256: str


@dataclasses.dataclass(frozen=True)
class RunSummary:
    """Content of a run's folder or archive.

    Attributes:
        described: the description of the run, see `read_run`.
        parts: its files.
    """

    described: Mapping[str, Any]
    parts: tuple[Part, ...]

    @property
    def key(self) -> str:
        """Key of the run, which its checkpoints carry."""
        return compute_digest(hash_large_parts(self.described))

    @property
    def is_finished(self) -> bool:
        """True where the run has a result."""
        return any(part.name == "result.json" for part in self.parts)

    @property
    def digest(self) -> str:
        """SHA-256 over the names and contents of all parts."""
        return hashlib.sha256(_make_manifest(self.parts)).hexdigest()


def pack_run(folder: str | os.PathLike[str], path: str | os.PathLike[str]) -> RunSummary:
    """Write a run's folder to one file, atomically.

    Args:
        folder: folder of a run that no process is training.
        path: the archive, by custom ending in `.zip`.

    Raises:
        FileReadError: the folder holds no run, or a link in place of a file.
        RunBusyError: a process is training into the folder.
        FileWriteError: the archive cannot be written, or would have more than `LARGEST_ARCHIVE` bytes.
    """
    folder = Path(folder)
    with _keeping_others_out(folder):
        summary = _summarise_folder(folder)
        if sum(part.bytes for part in summary.parts) > LARGEST_ARCHIVE:
            raise FileWriteError(f"cannot write {path}: this run has more than {LARGEST_ARCHIVE:,} bytes")
        with atomic_writer(path) as file, zipfile.ZipFile(file, "w", allowZip64=False) as archive:
            with archive.open(_make_member(MANIFEST), "w") as target:
                target.write(_make_manifest(summary.parts))
            for part in summary.parts:
                with open_plain(folder / part.name, "part of a run", LARGEST_ARCHIVE) as source, \
                        archive.open(_make_member(part.name), "w") as target:
                    _check_part(part, _copy(source, target, part.name), folder)
    return summary


def unpack_run(path: str | os.PathLike[str], folder: str | os.PathLike[str]) -> RunSummary:
    """Make a run's folder from its archive: whole, or not at all.

    Args:
        path: the archive.
        folder: the folder to make; nothing may be there.

    Raises:
        FileReadError: there is no archive, or it may not be read.
        CheckpointError: it is damaged or no archive of a run; nothing was written.
        FileWriteError: the folder is there already, or cannot be written.
    """
    folder = Path(folder)
    if os.path.lexists(folder):
        raise FileWriteError(f"cannot write {folder}: it is there already. Choose another folder, or delete this one")
    make_folder(folder.absolute().parent)
    made: Path | None = None
    try:
        made = Path(tempfile.mkdtemp(prefix=TEMPORARY_PREFIX, dir=folder.absolute().parent))
        summary = _read_archive(Path(path), made)
        made.chmod(0o755)
        made.rename(folder)
        made = None
        return summary
    except EscapeError:
        raise
    except OSError as error:
        raise FileWriteError(describe_write_failure(folder, error)) from error
    finally:
        if made is not None:
            shutil.rmtree(made, ignore_errors=True)


def read_summary(path: str | os.PathLike[str]) -> RunSummary:
    """Read what a run's folder or archive holds, and check the hashes of an archive's parts.

    Raises:
        FileReadError: there is neither.
        CheckpointError: it is damaged, or of another format.
    """
    return _summarise_folder(Path(path)) if Path(path).is_dir() else _read_archive(Path(path), None)


@contextmanager
def _keeping_others_out(folder: Path) -> Iterator[None]:
    """Hold the lock of a run's folder, where it has one."""
    if not (folder / "lock").exists():
        yield
        return
    with open_plain(folder / "lock", "lock of a run") as lock:
        if not take_lock(lock):
            raise RunBusyError(f"{folder}: another process is training into this folder. Wait for it")
        yield


def _summarise_folder(folder: Path) -> RunSummary:
    described, parts = read_run(folder), []
    for name in RUN_FILES:
        path = folder / name
        if path.is_symlink():
            raise FileReadError(f"{path}: this is a link, and a run consists of plain files")
        if path.exists():
            with open_plain(path, "part of a run", LARGEST_ARCHIVE) as file:
                parts.append(_copy(file, None, name))
    return RunSummary(described, tuple(parts))


def _read_archive(path: Path, folder: Path | None) -> RunSummary:
    """Check an archive; with a folder also write its parts there."""
    with open_plain(path, "archive of a run", LARGEST_ARCHIVE) as file:
        try:
            _check_directory(file)
            with zipfile.ZipFile(file) as archive:
                members = {member.filename: member for member in archive.infolist()}
                _check_members(archive.infolist(), os.fstat(file.fileno()).st_size)
                with archive.open(members[MANIFEST]) as source:
                    parts = _read_manifest(source.read(LARGEST_DIRECTORY), path)
                if {MANIFEST, *(part.name for part in parts)} != members.keys():
                    raise ValueError("its manifest lists other parts than it has")
                content = archive.read(members["run.json"])
                described = check_run(parse_json(content, path, "description of a run"), path)
                for part in parts:
                    with archive.open(members[part.name]) as source:
                        if folder is None:
                            found = _copy(source, None, part.name)
                        else:
                            with open(folder / part.name, "xb") as target:
                                found = _copy(source, target, part.name)
                                target.flush()
                                os.fsync(target.fileno())
                    _check_part(part, found, path)
                return RunSummary(described, parts)
        except CheckpointError:
            raise
        except Exception as error:  # damaged bytes make the reader of zip raise almost anything
            if isinstance(error, OSError) and error.errno in DISK_TROUBLE:
                raise
            raise _make_damage(path, error) from error


def _make_damage(path: Path, error: Exception) -> CheckpointError:
    return CheckpointError(f"{path}: this is no archive of a run, or a damaged one ({describe_damage(error)}). Pack "
                           "the run anew with `hrl-escape run pack`")


def _check_directory(file: IO[bytes]) -> None:
    """Refuse long lists of members, comments and 64-bit zips before the list is read."""
    file.seek(-42, os.SEEK_END)
    end = file.read()
    if end[20:24] != b"PK\5\6":
        raise ValueError("it does not end as a zip does")
    size, comment = struct.unpack("<12xL4xH", end[20:])
    if size > LARGEST_DIRECTORY or comment or end.startswith(b"PK\6\7"):
        raise ValueError(f"its list of members has {size:,} bytes")


def _check_members(members: list[zipfile.ZipInfo], size: int) -> None:
    """Refuse all but plain, stored files of known names, once each."""
    left = size
    for member in members:
        left -= member.file_size
        kind = stat.S_IFMT(member.external_attr >> 16)
        if member.orig_filename not in (MANIFEST, *RUN_FILES) or kind not in (0, stat.S_IFREG):
            raise ValueError(f"it holds {show_value(member.orig_filename)}, which is no file of a run")
        if member.compress_type != zipfile.ZIP_STORED or member.file_size != member.compress_size or left < 0:
            raise ValueError(f"{member.filename} would unpack to more than the archive's own bytes")
    if len({member.filename for member in members}) < len(members):
        raise ValueError("it holds a file twice")


def _read_manifest(content: bytes, path: Path) -> tuple[Part, ...]:
    manifest = parse_json(content, path, "manifest of an archive")
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise ValueError(f"its manifest is not of format {FORMAT}")
    return tuple(read_record(Part, {"name": name, **part}) for name, part in manifest["parts"].items())


def _make_manifest(parts: tuple[Part, ...]) -> bytes:
    listed = {part.name: {"bytes": part.bytes, "sha256": part.sha256} for part in parts}
    return json.dumps({"format": FORMAT, "parts": listed}, indent=2).encode() + b"\n"


def _make_member(name: str) -> zipfile.ZipInfo:
    member = zipfile.ZipInfo(name)  # of 1980-01-01, the earliest time that a zip has
    member.create_system, member.external_attr = 3, (stat.S_IFREG | 0o644) << 16
    return member


def _copy(source: IO[bytes], target: IO[bytes] | None, name: str) -> Part:
    """Read a file to its end, write what was read, and say what it was."""
    size, content = 0, hashlib.sha256()
    while chunk := source.read(CHUNK):
        size += len(chunk)
        content.update(chunk)
        if target is not None:
            target.write(chunk)
    return Part(name, size, content.hexdigest())


def _check_part(part: Part, found: Part, where: Path) -> None:
    if found != part:
        raise CheckpointError(f"{where}: {part.name} has another content than its hash says: {part.bytes:,} bytes of "
                              f"{part.sha256[:16]}, found {found.bytes:,} of {found.sha256[:16]}")
