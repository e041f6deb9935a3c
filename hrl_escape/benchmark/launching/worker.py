"""Process of one run: one torch thread, its own output file, and no life beyond its parent's.

Everything heavy is imported here, so that a fork server that preloads this module starts each process in milliseconds;
so are the 800 modules that torch imports with its first optimiser. Numba's tables of types and functions, which the
first kernel would build in every process, are built here too.
"""

from __future__ import annotations

import faulthandler
import os
import signal
import time
import traceback
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import torch
import torch._dynamo
from numba.core.registry import cpu_target

import hrl_escape.agents.training.train
import hrl_escape.options.best_with_options
import hrl_escape.options.memory
import hrl_escape.options.options_env  # noqa: F401  # preloaded, like those above, for the processes forked from here
from hrl_escape.benchmark.grid import GridRun
from hrl_escape.benchmark.runs import execute_run, get_run_folder
from hrl_escape.errors import EscapeError, FileWriteError, RunBusyError
from hrl_escape.files import make_folder, open_for_writing
from hrl_escape.processes import die_with_parent

NUMBA: Any = cpu_target
"""Without the type of its cached properties, which pyright does not see through."""
NUMBA.typing_context.refresh()
NUMBA.target_context.refresh()

ORPHAN_SECONDS = 20.0
"""Longest wait for a process of a killed comparison to let go of its run."""
MOST_CHARACTERS = 10_000
"""Longest message and traceback; both go through a pipe that nobody reads before the process ends."""


def work(run: GridRun, out: Path, checkpoint_seconds: float, answer: Connection) -> None:
    """Run a run in a process of the local launcher, which hears of an error through `answer`."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent too, and the parent decides
    die_with_parent()
    folder = get_run_folder(out, run)
    try:
        make_folder(folder)
        with open_for_writing(folder / "output.txt", "wb") as output:
            os.dup2(output.fileno(), 1)
            os.dup2(output.fileno(), 2)
    except FileWriteError as error:
        answer.send(describe_error(error))
        return
    faulthandler.enable()
    error = run_guarded(run, out, checkpoint_seconds)
    if error is not None:
        answer.send(error)


def run_guarded(run: GridRun, out: Path, checkpoint_seconds: float) -> dict[str, str] | None:
    """Execute a run and return the error that ended it, as `describe_error` has it: a full disk would take no file."""
    torch.set_num_threads(1)  # the runs fill the cores already, and sums split over threads differ in the last bit
    deadline = time.monotonic() + ORPHAN_SECONDS
    while True:
        try:
            execute_run(run, out, checkpoint_seconds)
            return None
        except RunBusyError as error:
            if time.monotonic() > deadline:
                return describe_error(error)
            time.sleep(0.1)
        except Exception as error:
            return describe_error(error)


def describe_error(error: Exception) -> dict[str, str]:
    """Message of an error, and its traceback where it is not one of the package's own."""
    expected = isinstance(error, EscapeError)
    message = str(error) if expected else "".join(traceback.format_exception_only(error)).strip()
    return {
        "message": message[:MOST_CHARACTERS],
        "traceback": "" if expected else "".join(traceback.format_exception(error))[-MOST_CHARACTERS:],
    }
