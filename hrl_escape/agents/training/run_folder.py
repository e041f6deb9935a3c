"""Folder of one training run: identity, log, checkpoint and result.

`run.json` holds the identity, `log.jsonl` one line an episode and an evaluation, `checkpoint.npz` the latest state,
`best.npz` the state at the best evaluation (the first of equals), `result.json` the result of a finished run. A
checkpoint records the length of the log, and resuming cuts the log back to it. So a run killed at any moment leaves the
files of an uninterrupted one.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from hrl_escape.agents.state import StateTree
from hrl_escape.agents.training.checkpoint import load_checkpoint, save_checkpoint
from hrl_escape.agents.training.env_description import compute_digest, hash_large_parts
from hrl_escape.agents.training.results import TrainResult, read_result
from hrl_escape.errors import (
    CheckpointError,
    EscapeError,
    FileWriteError,
    RunMismatchError,
    describe_damage,
    show_value,
)
from hrl_escape.files import (
    clear_unfinished,
    describe_write_failure,
    open_for_writing,
    open_plain,
    parse_json,
    read_json,
    write_json,
)
from hrl_escape.processes import open_lock

FORMAT = 3
"""Version of the fields of `run.json`; another version is refused."""

LAST, BEST = "checkpoint.npz", "best.npz"
"""Checkpoints of a run: the latest, and the one of the best evaluation."""

MOST_NAMED = 8
"""Differences that a message names."""


class RunFolder:
    """Folder of a run, opened for one process.

    Args:
        path: path of the folder; made if missing.
        identity: everything that decides the run's numbers, a JSON value. A folder never holds two runs.

    Attributes:
        key: short hash of the identity; checkpoint and result carry it.
        state: checkpoint to resume from, or None.
        rows: rows of the log up to that checkpoint.

    Raises:
        RunBusyError: another process has the folder open.
        RunMismatchError: it holds a run of another identity.
        CheckpointError: checkpoint or log are damaged.
        FileWriteError: the folder cannot be made or written.
    """

    def __init__(self, path: str | os.PathLike[str], identity: Mapping[str, Any]) -> None:
        self.path = Path(path)
        self.key = compute_digest(hash_large_parts(identity))
        self.state: StateTree | None = None
        self.rows: list[dict[str, Any]] = []
        self._lock = open_lock(self.path / "lock", f"{self.path}: another process is training into this folder. Wait "
                                                   "for it or choose another folder")
        try:
            clear_unfinished(self.path)
            self._claim(json.loads(json.dumps(identity)))
            offset = self._restore()
            self._log = open_for_writing(self.path / "log.jsonl")
            self._log.truncate(offset)
        except BaseException:
            self._lock.close()
            raise

    @property
    def result(self) -> TrainResult | None:
        """Result of a finished run, else None."""
        if not (self.path / "result.json").exists():
            return None
        key, result = read_result(self.path)
        self._check_key(key, "result.json")
        return result

    def log(self, row: Mapping[str, Any]) -> None:
        """Append one row."""
        clean = {
            key: None if isinstance(value, float) and not math.isfinite(value) else value for key, value in row.items()
        }
        with self._writing_log():
            self._log.write(json.dumps(clean, allow_nan=False).encode() + b"\n")
            self._log.flush()
        self.rows.append(clean)

    def save(self, state: StateTree) -> None:
        """Make the log durable, then replace the checkpoint."""
        with self._writing_log():
            os.fsync(self._log.fileno())
            save_checkpoint(self.path / LAST, {"key": self.key, "log_bytes": self._log.tell(), **state})

    def save_best(self, state: StateTree) -> None:
        """Replace the checkpoint of the best evaluation."""
        with self._writing_log():
            save_checkpoint(self.path / BEST, {"key": self.key, **state})

    def finish(self, result: Mapping[str, Any]) -> None:
        """Write the result, which marks the run as finished."""
        with self._writing_log():
            write_json(self.path / "result.json", {"key": self.key, **result}, parents=False)

    def close(self) -> None:
        """Close the files and release the lock."""
        with suppress(OSError):  # a full disk has been reported
            self._log.close()
        self._lock.close()

    @contextmanager
    def _writing_log(self) -> Iterator[None]:
        """Raise `FileWriteError` if the log's disk is full, or its folder was deleted or moved."""
        path = self.path / "log.jsonl"
        try:
            if not self._is_in_place(path):
                raise FileNotFoundError
            yield
        except OSError as error:
            if not self._is_in_place(path):
                raise FileWriteError(f"{path} was deleted or moved while its run was writing it. Start the run again, "
                                     "and leave its folder where it is") from error
            if isinstance(error, FileWriteError):
                raise
            raise FileWriteError(describe_write_failure(path, error)) from error

    def _is_in_place(self, path: Path) -> bool:
        """True while the log that is open is the one that the folder has."""
        try:
            return os.path.samestat(os.stat(path), os.fstat(self._log.fileno()))
        except FileNotFoundError:
            return False

    def _claim(self, identity: dict[str, Any]) -> None:
        path = self.path / "run.json"
        if not path.exists():
            left = [name for name in ("result.json", LAST, BEST, "log.jsonl") if (self.path / name).exists()]
            if left:
                raise CheckpointError(f"{self.path / left[0]}: this folder is damaged: its run.json is gone. Choose "
                                      "another folder, or delete this one")
            write_json(path, identity)
            return
        found = read_run(self.path)
        there, now = _flatten(hash_large_parts(found)), _flatten(hash_large_parts(identity))
        if there != now:
            differing = [key for key in {**there, **now} if there.get(key) != now.get(key)]
            named = differing[:MOST_NAMED]
            changes = "; ".join(f"{key}: {show_value(there.get(key))} there, {show_value(now.get(key))} now"
                                for key in named)
            changes += f"; and {len(differing) - MOST_NAMED} more" if len(differing) > MOST_NAMED else ""
            raise RunMismatchError(
                f"{self.path} holds a run that differs in {changes}. Choose another folder, or delete "
                "this one"
            )

    def _restore(self) -> int:
        """Read checkpoint and log; return the length of the log at the checkpoint, in bytes."""
        path = self.path / LAST
        if not path.exists():
            return 0
        self.state = load_checkpoint(path)
        self._check_key(self.state.get("key"), path.name)
        log_path = self.path / "log.jsonl"
        try:
            offset = self.state["log_bytes"]
            with open_plain(log_path, "log of a run") as log:
                size = os.fstat(log.fileno()).st_size
                if not isinstance(offset, int) or not 0 <= offset <= size:
                    raise ValueError(f"it has {size} bytes; the checkpoint was made at {show_value(offset)}")
                content = log.read(offset)
            self.rows = [parse_json(line, log_path, "log of a run") for line in content.splitlines()]
        except (EscapeError, KeyError, TypeError, ValueError) as error:
            raise CheckpointError(f"{log_path}: this log is damaged ({describe_damage(error)}). Delete the folder to "
                                  "start again") from error
        return offset

    def _check_key(self, key: Any, name: str) -> None:
        if key != self.key:
            raise CheckpointError(f"{self.path / name} belongs to another run than run.json in its folder. Delete the "
                                  "folder to start again")


def read_run(folder: str | os.PathLike[str]) -> dict[str, Any]:
    """Read the description of a run: its identity, as `run.json` keeps it.

    Raises:
        FileReadError: there is none.
        CheckpointError: it is damaged, or of another format.
    """
    path = Path(folder) / "run.json"
    return check_run(read_json(path, "description of a run"), path)


def check_run(described: Any, path: Path) -> dict[str, Any]:
    """Return the description of a run, or raise `CheckpointError`, which names `path`."""
    if isinstance(described, dict) and described.get("format") == FORMAT - 1:
        raise CheckpointError(f"{path}: this run is of version 0.3, in format {FORMAT - 1}. `hrl-escape convert "
                              f"{path.parent if path.name == 'run.json' else path}` writes it in the form of this "
                              "version")
    if not isinstance(described, dict) or described.get("format") != FORMAT:
        raise CheckpointError(f"{path}: this is not the description of a run in format {FORMAT}. Train the run again "
                              "with this version of hrl-escape")
    return described


def _flatten(value: Any, path: str = "") -> dict[str, Any]:
    """Values by their dotted path; lists of tables count as tables whose names are numbers."""
    if isinstance(value, list) and any(isinstance(part, dict) for part in value):
        value = dict(enumerate(value))
    if not isinstance(value, dict) or not value:
        return {path: value}
    parts = (_flatten(part, f"{path}.{name}" if path else str(name)) for name, part in value.items())
    return {name: part for found in parts for name, part in found.items()}

