"""The folder of one training run: what it is, its log, its checkpoint, its result.

`run.json` says what is run, `log.jsonl` grows a line an episode and an evaluation, `checkpoint.npz`
is replaced as a whole, `result.json` appears at the end. A checkpoint remembers how long the log was, and resuming
cuts the log back to that, so a run killed at any moment leaves the files of an uninterrupted one.
"""

from __future__ import annotations

import fcntl
import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

from hrl_escape.agents.agent import StateTree
from hrl_escape.agents.checkpoint import load_checkpoint, save_checkpoint
from hrl_escape.errors import CheckpointError, FileWriteError, MissingExtraError, RunBusyError, RunMismatchError
from hrl_escape.files import describe_write_failure, read_json, write_json

__all__ = ["RunFolder"]


class RunFolder:
    """Opens a run's folder for one process.

    Args:
        path: the folder; made if missing.
        identity: what decides the run's numbers, a JSON value. A folder never holds two runs.
        tensorboard: also write event files into `path/tensorboard`.

    Attributes:
        state: the checkpoint to go on from, or None.
        rows: the log's rows up to that checkpoint.

    Raises:
        RunBusyError: another process has the folder open.
        RunMismatchError: it holds a run of another identity.
        CheckpointError: checkpoint or log are damaged.
        FileWriteError: the folder cannot be made or written.
    """

    def __init__(self, path: str | os.PathLike[str], identity: Mapping[str, Any], tensorboard: bool) -> None:
        self.path = Path(path)
        self.state: StateTree | None = None
        self.rows: list[dict[str, Any]] = []
        self._lock = self._take_lock()
        try:
            self._claim(json.loads(json.dumps(identity)))
            offset = self._restore()
            self._log = self._open(self.path / "log.jsonl", "ab")
            self._log.truncate(offset)
            step = self.rows[-1]["primitives"] + 1 if self.rows else 0
            self._events = _open_events(self.path / "tensorboard", step) if tensorboard else None
        except BaseException:
            self._lock.close()
            raise

    @property
    def result(self) -> dict[str, Any] | None:
        """The result, if the run was finished."""
        path = self.path / "result.json"
        return read_json(path, "result of a run") if path.exists() else None

    def log(self, row: Mapping[str, Any]) -> None:
        """Append one row; numbers under names with a slash also go to TensorBoard, against primitives."""
        clean = {
            key: None if isinstance(value, float) and not math.isfinite(value) else value for key, value in row.items()
        }
        try:
            self._log.write(json.dumps(clean, allow_nan=False).encode() + b"\n")
            self._log.flush()
        except OSError as error:
            raise FileWriteError(describe_write_failure(self.path / "log.jsonl", error)) from error
        self.rows.append(clean)
        if self._events is not None:
            for key, value in clean.items():
                if "/" in key and isinstance(value, (int, float)):
                    self._events.add_scalar(key, value, clean["primitives"])

    def save(self, state: StateTree) -> None:
        """Make the log durable, then replace the checkpoint."""
        try:
            os.fsync(self._log.fileno())
        except OSError as error:
            raise FileWriteError(describe_write_failure(self.path / "log.jsonl", error)) from error
        save_checkpoint(self.path / "checkpoint.npz", {"log_bytes": self._log.tell(), **state})

    def finish(self, result: Mapping[str, Any]) -> None:
        """Write the result, which marks the run as finished."""
        write_json(self.path / "result.json", result)

    def close(self) -> None:
        """Close the files and let other processes in."""
        if self._events is not None:
            self._events.close()
        self._log.close()
        self._lock.close()

    def _take_lock(self) -> IO[bytes]:
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FileWriteError(describe_write_failure(self.path, error)) from error
        lock = self._open(self.path / "lock", "ab")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # falls with the process, however it ends
        except OSError as error:
            lock.close()
            raise RunBusyError(
                f"{self.path}: another process is training into this folder. Wait for it or choose another folder"
            ) from error
        return lock

    def _open(self, path: Path, mode: str) -> IO[bytes]:
        try:
            return open(path, mode)
        except OSError as error:
            raise FileWriteError(describe_write_failure(path, error)) from error

    def _claim(self, identity: dict[str, Any]) -> None:
        """Write down whose folder this is, or check it."""
        path = self.path / "run.json"
        if not path.exists():
            write_json(path, identity)
            return
        found = read_json(path, "description of a run")
        if found != identity:
            there, now = _flatten(found), _flatten(identity)
            differing = [key for key in {**there, **now} if there.get(key) != now.get(key)]
            changes = "; ".join(f"{key}: {there.get(key)!r} there, {now.get(key)!r} now" for key in differing)
            raise RunMismatchError(
                f"{self.path} holds a run that differs in {changes or 'its form'}. Choose another folder, or delete "
                "this one"
            )

    def _restore(self) -> int:
        """Read checkpoint and log; returns how long the log was at the checkpoint, in bytes."""
        path = self.path / "checkpoint.npz"
        if not path.exists():
            return 0
        self.state = load_checkpoint(path)
        log_path = self.path / "log.jsonl"
        try:
            offset = int(self.state["log_bytes"])
            content = log_path.read_bytes() if log_path.exists() else b""
            if len(content) < offset:
                raise ValueError(f"it has {len(content)} bytes; the checkpoint was made at {offset}")
            self.rows = [json.loads(line) for line in content[:offset].splitlines()]
        except (KeyError, TypeError, ValueError) as error:
            raise CheckpointError(
                f"{log_path}: this log is damaged ({error}). Delete the folder to start anew"
            ) from error
        return offset


def _flatten(value: Any, path: str = "") -> dict[str, Any]:
    """Dotted path -> value, of everything inside; what is no dict has none."""
    if not isinstance(value, dict):
        return {path: value} if path else {}
    parts = (_flatten(part, f"{path}.{name}" if path else name) for name, part in value.items())
    return {name: part for found in parts for name, part in found.items()}


def _open_events(path: Path, purge_step: int) -> Any:
    """TensorBoard's writer; events from after the checkpoint are dropped by `purge_step`."""
    try:
        from torch.utils.tensorboard import SummaryWriter  # optional
    except ImportError as error:
        raise MissingExtraError("tensorboard", "tensorboard", "writing TensorBoard files") from error
    return SummaryWriter(path, purge_step=purge_step)
