"""Process of one run: one torch thread, a file for its output, and an end with its parent.

All heavy modules are imported here, including the 800 modules of torch's first optimiser, so a fork server that
preloads this module starts a process in milliseconds. Numba's tables of types and functions are built here too.
"""

from __future__ import annotations

import faulthandler
import os
import pickle
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
from hrl_escape.benchmark.execution import execute_run
from hrl_escape.benchmark.grid import GridRun
from hrl_escape.benchmark.run_results import get_run_folder
from hrl_escape.errors import EscapeError, FileWriteError, RunBusyError
from hrl_escape.files import make_folder, open_for_writing
from hrl_escape.processes import die_with_parent

NUMBA: Any = cpu_target
"""Cast for pyright, which does not resolve its cached properties."""
NUMBA.typing_context.refresh()
NUMBA.target_context.refresh()

ORPHAN_SECONDS = 20.0
"""Longest wait for the lock of a run of a killed comparison, s."""
MOST_CHARACTERS = 10_000
"""Longest message and traceback, which have to fit into the buffer of a pipe."""


def work(packed: bytes, out: Path, checkpoint_seconds: float, answer: Connection) -> None:
    """Execute a run, packed by `cloudpickle`, in a process of the local launcher; `answer` sends an error to it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent also receives Ctrl-C and ends its processes
    die_with_parent()
    try:
        run: GridRun = pickle.loads(packed)  # from the parent process, through its pipe
    except Exception as error:  # code of other packages is imported here
        answer.send(describe_error(error))
        return
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
    """Execute a run and return its error as text, because a file could fail on a full disk."""
    torch.set_num_threads(1)  # runs already use all cores, and sums over several threads differ in the last bit
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
    """Return the message of an error, with traceback for errors from outside the package."""
    expected = isinstance(error, EscapeError)
    message = str(error) if expected else "".join(traceback.format_exception_only(error)).strip()
    return {
        "message": message[:MOST_CHARACTERS],
        "traceback": "" if expected else "".join(traceback.format_exception(error))[-MOST_CHARACTERS:],
    }
