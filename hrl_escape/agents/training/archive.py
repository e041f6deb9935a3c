"""Archives of named parts, each with its size and SHA-256: how runs and trained agents are stored.

An archive is a zip of `manifest.json`, with the bytes and SHA-256 of each part, then the parts. The archive is not
compressed and no time is kept: equal parts give equal archives, byte for byte, and no archive unpacks to more than its
own bytes. Reading takes known names only, once each, so that no name in an archive, absolute, with `..` or of a link,
ever becomes a path.

A run's archive holds the files of its folder that are needed to read and resume it.
"""

from __future__ import annotations

import dataclasses
import errno
import hashlib
import io
import json
import os
import re
import shutil
import stat
import tempfile
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import IO, Any, NamedTuple

from hrl_escape.agents.training.checkpoint import drop_experience, load_checkpoint, save_checkpoint
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
    open_zip,
    parse_json,
    read_json,
    write_json,
)
from hrl_escape.processes import take_lock
from hrl_escape.settings import read_record

MANIFEST, FORMAT = "manifest.json", 1
LARGEST_ARCHIVE = 2**32 - 2**16
"""Bytes of the largest archive: what a zip holds without its extension to 64 bits."""
LARGEST_DIRECTORY = 2**12
"""Bytes of a zip's list of members; twenty of ours take under 2,000."""
CHUNK = 2**20
DISK_TROUBLE = (errno.ENOSPC, errno.EDQUOT, errno.EACCES, errno.EROFS, errno.EFBIG)
"""Errors of the folder that parts are written to; the archive is not to blame."""


@dataclasses.dataclass(frozen=True)
class Part:
    """File of an archive: its name, its size in bytes, and the SHA-256 of its content in hexadecimal digits."""

    name: str
    bytes: int
    sha256: str


class ArchiveKind(NamedTuple):
    """Kind of archive: whose parts, which names they may have, and what to do about a damaged one."""

    whose: str  # in words, such as `a run`
    names: re.Pattern[str]  # names of parts that it may hold
    cure: str  # sentence that ends the message about a damaged one


def compute_parts_digest(parts: Iterable[Part]) -> str:
    """SHA-256 over the names and contents of parts."""
    return hashlib.sha256(_make_manifest(parts)).hexdigest()


def describe_part(name: str, source: Path | bytes, what: str = "part of an archive") -> Part:
    """Size and hash of a file, or of bytes, as a part of this name; a link raises `FileReadError`."""
    with _open(source, what) as file:
        return _copy(file, None, name)


def pack_parts(path: str | os.PathLike[str], sources: Mapping[str, Path | bytes], kind: ArchiveKind
               ) -> tuple[Part, ...]:
    """Write an archive of these files or contents, by the names of their parts, atomically.

    Raises:
        FileReadError: a file is missing, or a link.
        FileWriteError: the archive cannot be written, or would have more than `LARGEST_ARCHIVE` bytes.
    """
    parts = tuple(describe_part(name, source, f"part of {kind.whose}") for name, source in sources.items())
    if sum(part.bytes for part in parts) > LARGEST_ARCHIVE:
        raise FileWriteError(f"cannot write {path}: {kind.whose} has more than {LARGEST_ARCHIVE:,} bytes")
    with atomic_writer(path) as file, zipfile.ZipFile(file, "w", allowZip64=False) as archive:
        with archive.open(_make_member(MANIFEST), "w") as target:
            target.write(_make_manifest(parts))
        for part, source in zip(parts, sources.values(), strict=True):
            with _open(source, f"part of {kind.whose}") as content, \
                    archive.open(_make_member(part.name), "w") as target:
                _check_part(part, _copy(content, target, part.name), path)
    return parts


def read_parts(path: str | os.PathLike[str], kind: ArchiveKind, wanted: Iterable[str] = (), folder: Path | None = None
               ) -> tuple[tuple[Part, ...], dict[str, bytes]]:
    """Check an archive whole, hashes included, and read parts of it.

    Args:
        path: the archive.
        kind: of the archive.
        wanted: names of parts whose content is returned; it must have them.
        folder: write all parts there too, each as a new file, or None.

    Raises:
        FileReadError: no such archive, or it cannot be read.
        CheckpointError: it is damaged, or of another kind.
    """
    path = Path(path)
    with open_plain(path, f"archive of {kind.whose}", LARGEST_ARCHIVE) as file, refusing_archive(path, kind):
        with open_zip(file, LARGEST_DIRECTORY) as archive:
            members = {member.filename: member for member in archive.infolist()}
            _check_members(archive.infolist(), kind, os.fstat(file.fileno()).st_size)
            with archive.open(members[MANIFEST]) as source:
                parts = _read_manifest(source.read(LARGEST_DIRECTORY), path)
            if {MANIFEST, *(part.name for part in parts)} != members.keys():
                raise ValueError("its manifest lists other parts than it has")
            content = {name: archive.read(members[name]) for name in wanted}
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
            return parts, content


@contextmanager
def refusing_archive(path: Path, kind: ArchiveKind) -> Iterator[None]:
    """Raise a `CheckpointError` in one sentence for any error in the content of an archive."""
    try:
        yield
    except CheckpointError:
        raise
    except Exception as error:  # damaged bytes make the reader of zip raise almost anything
        if isinstance(error, OSError) and error.errno in DISK_TROUBLE:
            raise
        raise CheckpointError(f"{path}: this is no archive of {kind.whose}, or a damaged one "
                              f"({describe_damage(error)}). {kind.cure}") from error


@contextmanager
def making_folder(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder next to its place, and move it there at the end of the block: whole, or not at all.

    Raises:
        FileWriteError: the folder is there already, or cannot be written.
    """
    if os.path.lexists(folder):
        raise FileWriteError(f"cannot write {folder}: it is there already. Choose another folder, or delete this one")
    make_folder(folder.absolute().parent)
    made: Path | None = None
    try:
        made = Path(tempfile.mkdtemp(prefix=TEMPORARY_PREFIX, dir=folder.absolute().parent))
        yield made
        made.chmod(0o755)
        made.rename(folder)
        made = None
    except EscapeError:
        raise
    except OSError as error:
        raise FileWriteError(describe_write_failure(folder, error)) from error
    finally:
        if made is not None:
            shutil.rmtree(made, ignore_errors=True)


def _open(source: Path | bytes, what: str) -> AbstractContextManager[IO[bytes]]:
    if isinstance(source, bytes):
        return io.BytesIO(source)
    if source.is_symlink():
        raise FileReadError(f"{source}: this is a link, and a {what} is a plain file")
    return open_plain(source, what, LARGEST_ARCHIVE)


def _check_members(members: list[zipfile.ZipInfo], kind: ArchiveKind, size: int) -> None:
    left = size
    for member in members:
        left -= member.file_size
        name, mode = member.orig_filename, stat.S_IFMT(member.external_attr >> 16)
        if not (name == MANIFEST or kind.names.fullmatch(name)) or mode not in (0, stat.S_IFREG):
            raise ValueError(f"it holds {show_value(name)}, which is no file of {kind.whose}")
        if member.compress_type != zipfile.ZIP_STORED or member.file_size != member.compress_size or left < 0:
            raise ValueError(f"{member.filename} would unpack to more than the archive's own bytes")
    if len({member.filename for member in members}) < len(members):
        raise ValueError("it holds a file twice")


def _read_manifest(content: bytes, path: Path) -> tuple[Part, ...]:
    manifest = parse_json(content, path, "manifest of an archive")
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise ValueError(f"its manifest is not of format {FORMAT}")
    return tuple(read_record(Part, {"name": name, **part}) for name, part in manifest["parts"].items())


def _make_manifest(parts: Iterable[Part]) -> bytes:
    listed: dict[str, Any] = {part.name: {"bytes": part.bytes, "sha256": part.sha256} for part in parts}
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


def _check_part(part: Part, found: Part, where: str | os.PathLike[str]) -> None:
    if found != part:
        raise CheckpointError(f"{where}: {part.name} has another content than its hash says: {part.bytes:,} bytes of "
                              f"{part.sha256[:16]}, found {found.bytes:,} of {found.sha256[:16]}")


DESCRIBED = "run.json"
RESULT = "result.json"
RUN_FILES = (DESCRIBED, "log.jsonl", LAST, BEST, RESULT)
"""Files of a run that an archive holds; locks and TensorBoard's files stay behind."""
FROZEN = (DESCRIBED, LAST, RESULT)
"""Files of an agent that only acts."""
RUN_ARCHIVE = ArchiveKind("a run", re.compile("|".join(map(re.escape, RUN_FILES))),
                          "Pack the run again with `hrl-escape run pack`")


@dataclasses.dataclass(frozen=True)
class RunSummary:
    """Content of a run's folder or archive."""

    described: Mapping[str, Any]  # the description of the run, see `read_run`
    parts: tuple[Part, ...]  # its files

    @property
    def key(self) -> str:
        """Key of the run, which its checkpoints carry."""
        return compute_digest(hash_large_parts(self.described))

    @property
    def is_finished(self) -> bool:
        """True where the run has a result."""
        return any(part.name == RESULT for part in self.parts)

    @property
    def digest(self) -> str:
        """SHA-256 over the names and contents of all parts."""
        return compute_parts_digest(self.parts)


def pack_run(folder: str | os.PathLike[str], path: str | os.PathLike[str], is_frozen: bool = False) -> RunSummary:
    """Write a run's folder to one file, atomically.

    Args:
        folder: folder of a run that no process is training.
        path: the archive, by custom ending in `.zip`.
        is_frozen: take only what acting needs: the description, with ids in place of sets of rooms, the last
            checkpoint without the experience that is still to be learned from, and the result without its episodes.

    Raises:
        FileReadError: the folder holds no run, or a link in place of a file.
        RunBusyError: a process is training into the folder.
        FileWriteError: the archive cannot be written, or would have more than `LARGEST_ARCHIVE` bytes.
    """
    folder = Path(folder)
    with _keeping_others_out(folder), tempfile.TemporaryDirectory() as made:
        described, files = read_run(folder), _list_files(folder)
        if is_frozen:
            described = hash_large_parts(described, list)
            files = {name: Path(made) / name for name, path in files.items() if name in FROZEN}
            write_json(files[DESCRIBED], described)
            if LAST in files:
                save_checkpoint(files[LAST], drop_experience(load_checkpoint(folder / LAST)))
            if RESULT in files:
                write_json(files[RESULT], {**read_json(folder / RESULT, "result of a run"), "episodes": []})
        return RunSummary(described, pack_parts(path, {**files}, RUN_ARCHIVE))


def unpack_run(path: str | os.PathLike[str], folder: str | os.PathLike[str]) -> RunSummary:
    """Make a run's folder from its archive: whole, or not at all.

    Raises:
        FileReadError: no such archive, or it cannot be read.
        CheckpointError: it is damaged or not an archive of a run; no files were written.
        FileWriteError: the folder is there already, or cannot be written.
    """
    with making_folder(Path(folder)) as made:
        return _read_archive(Path(path), made)


def read_summary(path: str | os.PathLike[str]) -> RunSummary:
    """Read what a run's folder or archive holds, and check the hashes of an archive's parts.

    Raises:
        FileReadError: there is neither.
        CheckpointError: it is damaged, or of another format.
    """
    path = Path(path)
    if not path.is_dir():
        return _read_archive(path, None)
    return RunSummary(read_run(path), tuple(describe_part(name, file, "part of a run")
                                            for name, file in _list_files(path).items()))


@contextmanager
def _keeping_others_out(folder: Path) -> Iterator[None]:
    if not (folder / "lock").exists():
        yield
        return
    with open_plain(folder / "lock", "lock of a run") as lock:
        if not take_lock(lock):
            raise RunBusyError(f"{folder}: another process is training into this folder. Wait for it")
        yield


def _list_files(folder: Path) -> dict[str, Path]:
    return {name: folder / name for name in RUN_FILES if os.path.lexists(folder / name)}


def _read_archive(path: Path, folder: Path | None) -> RunSummary:
    """Check an archive; with a folder also write its parts there."""
    parts, content = read_parts(path, RUN_ARCHIVE, ["run.json"], folder)
    with refusing_archive(path, RUN_ARCHIVE):
        return RunSummary(check_run(parse_json(content["run.json"], path, "description of a run"), path), parts)
