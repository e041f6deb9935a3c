"""A process that runs one cell: one torch thread, its own output file, and no life beyond its parent's.

Everything heavy is imported here, so that a fork server that preloads this module starts each
process in milliseconds.
"""

from __future__ import annotations

import faulthandler
import os
import signal
import time
import traceback
from pathlib import Path
from typing import Any

import torch

import hrl_escape.agents.training
import hrl_escape.options.best_known  # noqa: F401  # preloaded for the processes forked from here
from hrl_escape.errors import EscapeError, RunBusyError
from hrl_escape.experiments.cell import get_cell_folder, run_cell
from hrl_escape.experiments.grid import Cell
from hrl_escape.files import write_json
from hrl_escape.processes import die_with_parent

__all__ = ["run_guarded", "work"]

ORPHAN_SECONDS = 20.0
"""How long to wait for a process of a killed comparison to let go of its run."""


def work(cell: Cell, out: Path, checkpoint_seconds: float) -> None:
    """What a process of the local launcher does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent too, and the parent decides
    die_with_parent()
    folder = get_cell_folder(out, cell)
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / "output.txt", "wb") as output:
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
    faulthandler.enable()
    run_guarded(cell, out, checkpoint_seconds)


def run_guarded(cell: Cell, out: Path, checkpoint_seconds: float) -> None:
    """Run a cell; whatever it raises is written to `error.json` in its folder."""
    torch.set_num_threads(1)  # the cells fill the cores already, and sums split over threads differ in the last bit
    error_file = get_cell_folder(out, cell) / "error.json"
    error_file.unlink(missing_ok=True)
    try:
        _run_patiently(cell, out, checkpoint_seconds)
    except Exception as error:
        write_json(error_file, describe_error(error))


def _run_patiently(cell: Cell, out: Path, checkpoint_seconds: float) -> None:
    deadline = time.monotonic() + ORPHAN_SECONDS
    while True:
        try:
            return run_cell(cell, out, checkpoint_seconds)
        except RunBusyError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.1)


def describe_error(error: Exception) -> dict[str, Any]:
    """An error as a JSON value: `kind`, `message`, and `traceback` where it is not one of the package's own."""
    expected = isinstance(error, EscapeError)
    return {
        "kind": type(error).__name__,
        "message": str(error) if expected else "".join(traceback.format_exception_only(error)).strip(),
        "traceback": "" if expected else "".join(traceback.format_exception(error)),
    }
