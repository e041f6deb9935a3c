"""Run folders as single files, to be moved and handed on: archives of the files by which a run is read and resumed."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hrl_escape.agents.training.archive import (
    ArchiveKind,
    Part,
    compute_parts_digest,
    describe_part,
    making_folder,
    pack_parts,
    read_parts,
    refusing_archive,
)
from hrl_escape.agents.training.env_description import compute_digest, hash_large_parts
from hrl_escape.agents.training.run_folder import BEST, LAST, check_run, read_run
from hrl_escape.errors import RunBusyError
from hrl_escape.files import open_plain, parse_json
from hrl_escape.processes import take_lock

RUN_FILES = ("run.json", "log.jsonl", LAST, BEST, "result.json")
"""Files of a run that an archive holds; locks and TensorBoard's files stay behind."""
RUN_ARCHIVE = ArchiveKind("a run", re.compile("|".join(map(re.escape, RUN_FILES))),
                          "Pack the run anew with `hrl-escape run pack`")


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
        return any(part.name == "result.json" for part in self.parts)

    @property
    def digest(self) -> str:
        """SHA-256 over the names and contents of all parts."""
        return compute_parts_digest(self.parts)


def pack_run(folder: str | os.PathLike[str], path: str | os.PathLike[str], names: Sequence[str] = RUN_FILES
             ) -> RunSummary:
    """Write a run's folder to one file, atomically.

    Args:
        folder: folder of a run that no process is training.
        path: the archive, by custom ending in `.zip`.
        names: of the files to pack, where the folder has them; `run.json` among them.

    Raises:
        FileReadError: the folder holds no run, or a link in place of a file.
        RunBusyError: a process is training into the folder.
        FileWriteError: the archive cannot be written, or would have more than `LARGEST_ARCHIVE` bytes.
    """
    folder = Path(folder)
    with _keeping_others_out(folder):
        described = read_run(folder)
        files: dict[str, Path | bytes] = {name: path for name, path in _list_files(folder).items() if name in names}
        return RunSummary(described, pack_parts(path, files, RUN_ARCHIVE))


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
    """Hold the lock of a run's folder, where it has one."""
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
