"""Launcher on this machine: parallel runs in separate processes, with a listener for their outcomes.

A run that raises, is killed or crashes its interpreter does not affect others. Results are files (`run_results.py`), so
they outlive this process.
"""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import signal
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerContext
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Protocol

from hrl_escape.benchmark.grid import GridRun
from hrl_escape.benchmark.run_results import RunResult, get_run_folder, get_training_folder, load_run_result
from hrl_escape.errors import ConfigError, FileReadError, GridError
from hrl_escape.files import open_plain

TICK_SECONDS = 0.5
TAIL = 16_384
"""Bytes at the end of a log that are read."""
THREAD_SETTINGS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class Failure:
    """A run that ended in an error."""

    run: GridRun  # the run
    message: str  # message of the error
    traceback: str = ""  # its traceback; empty for errors of the package's own


class Listener(Protocol):
    """Receiver of the outcomes of runs."""

    def finish(self, run: GridRun, result: RunResult) -> None:
        """Receive a finished run."""
        ...

    def fail(self, failure: Failure) -> None:
        """Receive a failed run."""
        ...

    def tick(self, progress: Mapping[str, int]) -> None:
        """Receive the primitives of each running run, by folder, periodically."""
        ...


class Launcher(Protocol):
    """Executes runs, locally or on a cluster, and reports to a listener."""

    def run(self, runs: Sequence[GridRun], out: Path, listener: Listener) -> None:
        """Execute all runs; return once each has finished or failed."""
        ...


@dataclass(frozen=True)
class LocalLauncher:
    """Launcher with processes on this machine."""

    workers: int | None = None  # runs at a time, or None for one a core
    checkpoint_seconds: float = 10.0  # between checkpoints of a run, so the most that a kill costs
    begin_until: float = math.inf  # `time.monotonic()` of the last start of a run

    def __post_init__(self) -> None:
        choose_workers(self.workers)  # raises for a wrong number before any run

    def run(self, runs: Sequence[GridRun], out: Path, listener: Listener) -> None:
        """Execute the runs; an interruption ends their processes, and runs can be resumed later."""
        waiting, active = deque(runs), dict[int, tuple[BaseProcess, GridRun, Connection]]()
        workers = choose_workers(self.workers)
        try:
            while waiting or active:
                if time.monotonic() > self.begin_until:
                    waiting.clear()
                while waiting and len(active) < workers:
                    run = waiting.popleft()
                    process, answer = _start(run, out, self.checkpoint_seconds)
                    active[process.sentinel] = process, run, answer
                for sentinel in wait(list(active), TICK_SECONDS):
                    process, run, answer = active.pop(sentinel)  # pyright: ignore[reportArgumentType]
                    process.join()
                    report_outcome(out, run, process.exitcode, _receive(answer), listener)
                listener.tick({run.folder: read_progress(out, run) for _, run, _ in active.values()})
        finally:
            for process, _, _ in active.values():
                process.kill()
            for process, _, _ in active.values():
                process.join()


def get_fork_server() -> ForkServerContext:
    """Return a process context that forks from a server with all heavy imports, in milliseconds."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["hrl_escape.benchmark.launching.worker"])
    return context


def _start(run: GridRun, out: Path, checkpoint_seconds: float) -> tuple[BaseProcess, Connection]:
    """Start the process of a run; it sends an error through the connection."""
    import cloudpickle  # Gymnasium requires it; it takes functions and classes of scripts and notebooks

    try:
        packed = cloudpickle.dumps(run)
    except Exception as error:  # raised by the parts of other packages
        raise GridError(f"{run.name} cannot be sent to another process: {type(error).__name__}: {error}. Give a "
                        "function or a class that makes what cannot be sent") from error
    context = get_fork_server()
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(packed, out, checkpoint_seconds, sender), daemon=True)
    with _one_thread_each():
        process.start()
    sender.close()
    return process, receiver


def _work(packed: bytes, out: Path, checkpoint_seconds: float, answer: Connection) -> None:
    from hrl_escape.benchmark.launching.worker import work  # loads torch, which only the new process needs

    work(packed, out, checkpoint_seconds, answer)


def _receive(answer: Connection) -> dict[str, str] | None:
    """Return the error that a process has sent, or None."""
    with answer:
        try:
            return answer.recv()
        except EOFError:
            return None


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Set one thread per library for processes that are started in the body."""
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


def report_outcome(out: Path, run: GridRun, exit_code: int | None, error: dict[str, str] | None,
                   listener: Listener) -> None:
    """Report the end of a run to a listener: a result in its folder, an error, or the end of its process."""
    if error is not None:
        listener.fail(Failure(run, **error))
        return
    try:
        result = load_run_result(out, run)
    except FileReadError as damage:
        listener.fail(Failure(run, str(damage)))
        return
    if result is None:
        listener.fail(Failure(run, _describe_death(exit_code), _read_tail(get_run_folder(out, run) / "output.txt")))
    else:
        listener.finish(run, result)


def _describe_death(exit_code: int | None) -> str:
    if exit_code is not None and exit_code < 0:
        name = signal.Signals(-exit_code).name
        hint = "; the machine may have run out of memory" if name == "SIGKILL" else ""
        return f"its process was ended by {name}{hint}"
    how = "died" if exit_code is None else f"ended with code {exit_code}"
    return f"its process {how} and left no result"


def _read_tail(path: Path) -> str:
    with suppress(FileReadError), open_plain(path, "error log") as log:
        log.seek(max(0, log.seek(0, os.SEEK_END) - TAIL))
        return "\n".join(log.read(TAIL).decode(errors="replace").splitlines()[-30:])
    return ""


def read_progress(out: Path, run: GridRun) -> int:
    """Return the primitives of a running run, from the last complete line of its log."""
    try:
        with open_plain(get_training_folder(out, run) / "log.jsonl", "log of a run", largest=2**40) as log:
            log.seek(max(0, log.seek(0, os.SEEK_END) - TAIL))
            lines = log.read(TAIL).split(b"\n")
        return int(json.loads(lines[-2])["primitives"])
    except (OSError, IndexError, ValueError, KeyError, TypeError, RecursionError):
        return 0


def choose_workers(workers: int | None) -> int:
    """Return the number of processes, one per core by default.

    Raises:
        ConfigError: it is below one.
    """
    if workers is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if workers < 1:
        raise ConfigError("workers", workers, "it must be a whole number, 1 or more; leave it out for one a core")
    return workers
