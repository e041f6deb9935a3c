"""Runs cells in parallel processes, each cell in one of its own, and tells a listener how they fare.

A cell that raises, is killed or crashes its interpreter fails alone. Results travel through
files (`cell.py`), so nothing is lost with this process. What runs, and what is already finished, the caller decides.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Protocol

from hrl_escape.errors import ConfigError, FileReadError
from hrl_escape.experiments.cell import CellResult, get_cell_folder, read_cell
from hrl_escape.experiments.grid import Cell
from hrl_escape.files import read_json

__all__ = ["Failure", "Launcher", "Listener", "LocalLauncher", "choose_workers", "count_cores", "report_outcome"]

TICK_SECONDS = 0.5
THREAD_SETTINGS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class Failure:
    """A run that did not finish.

    Attributes:
        cell: which.
        message: what was wrong, for people.
        traceback: where it came from, if the error was not one of the package's own.
    """

    cell: Cell
    message: str
    traceback: str = ""


class Listener(Protocol):
    """Hears how cells fare."""

    def finish(self, cell: Cell, result: CellResult) -> None:
        """A cell finished."""
        ...

    def fail(self, failure: Failure) -> None:
        """A cell failed."""
        ...

    def tick(self, progress: Mapping[str, int]) -> None:
        """Now and then: primitives trained for by each running cell, by folder."""
        ...


class Launcher(Protocol):
    """Something that runs cells."""

    def run(self, cells: Sequence[Cell], out: Path, listener: Listener) -> None:
        """Run them all; returns when each has finished or failed."""
        ...


@dataclass(frozen=True)
class LocalLauncher:
    """Processes on this machine.

    Attributes:
        workers: how many run at a time; None for one a core.
        checkpoint_seconds: between checkpoints of a run: what a kill may cost.
    """

    workers: int | None = None
    checkpoint_seconds: float = 10.0

    def __post_init__(self) -> None:
        choose_workers(self.workers)  # a wrong number is refused before anything is begun

    def run(self, cells: Sequence[Cell], out: Path, listener: Listener) -> None:
        """Run them; on an interruption the processes are ended first, and can go on another time."""
        waiting, active = deque(cells), dict[int, tuple[BaseProcess, Cell]]()
        workers = choose_workers(self.workers)
        try:
            while waiting or active:
                while waiting and len(active) < workers:
                    cell = waiting.popleft()
                    process = _start(cell, out, self.checkpoint_seconds)
                    active[process.sentinel] = process, cell
                for sentinel in wait(list(active), TICK_SECONDS):
                    process, cell = active.pop(sentinel)  # pyright: ignore[reportArgumentType]
                    process.join()
                    report_outcome(out, cell, process.exitcode, listener)
                listener.tick({cell.folder: read_progress(out, cell) for _, cell in active.values()})
        finally:
            for process, _ in active.values():
                process.kill()
            for process, _ in active.values():
                process.join()


def _start(cell: Cell, out: Path, checkpoint_seconds: float) -> BaseProcess:
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["hrl_escape.experiments.worker"])
    process = context.Process(target=_work, args=(cell, out, checkpoint_seconds), daemon=True)
    with _one_thread_each():
        process.start()
    return process


def _work(cell: Cell, out: Path, checkpoint_seconds: float) -> None:
    from hrl_escape.experiments.worker import work  # brings torch in, which only the new process needs

    work(cell, out, checkpoint_seconds)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes started meanwhile have libraries that use one thread."""
    before = {name: os.environ.get(name) for name in THREAD_SETTINGS}
    os.environ.update(dict.fromkeys(THREAD_SETTINGS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def report_outcome(out: Path, cell: Cell, exit_code: int | None, listener: Listener) -> None:
    """Tell a listener what a cell that has ended left in its folder."""
    folder = get_cell_folder(out, cell)
    try:
        result = read_cell(out, cell)
        if result is not None:
            listener.finish(cell, result)
            return
        error = read_json(folder / "error.json", "error of a run")
        listener.fail(Failure(cell, error["message"], error["traceback"]))
    except (FileReadError, KeyError, TypeError):
        listener.fail(Failure(cell, _describe_death(exit_code), _read_tail(folder / "output.txt")))


def _describe_death(exit_code: int | None) -> str:
    if exit_code is not None and exit_code < 0:
        name = signal.Signals(-exit_code).name
        hint = "; the machine may have run out of memory" if name == "SIGKILL" else ""
        return f"its process was ended by {name}{hint}"
    return f"its process ended with code {exit_code} and left no result"


def _read_tail(path: Path, lines: int = 30) -> str:
    try:
        return "\n".join(path.read_text(errors="replace").splitlines()[-lines:])
    except OSError:
        return ""


def read_progress(out: Path, cell: Cell) -> int:
    """Primitives a running cell has trained for, by the last whole line of its log."""
    try:
        with open(get_cell_folder(out, cell) / "run" / "log.jsonl", "rb") as log:
            log.seek(max(0, log.seek(0, os.SEEK_END) - 16_384))
            lines = log.read().split(b"\n")
        return int(json.loads(lines[-2])["primitives"])
    except (OSError, IndexError, ValueError, KeyError, TypeError):
        return 0


def choose_workers(workers: int | None) -> int:
    """How many processes to use: one a core where nothing else is asked for.

    Raises:
        ConfigError: fewer than one.
    """
    if workers is None:
        return count_cores()
    if workers < 1:
        raise ConfigError("workers", workers, "it must be a whole number, 1 or more; leave it out for one a core")
    return workers


def count_cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
