"""Runs a whole comparison in one folder, and goes on in it.

`run_grid` leaves a folder in which every finished run is kept and never run twice. What it
means is worked out in `summary.py` and told in `report.py`.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import FileReadError, FileWriteError, RunBusyError
from hrl_escape.experiments.cell import CellResult, get_cell_folder, get_room_file, read_cell
from hrl_escape.experiments.grid import Cell, Grid
from hrl_escape.experiments.launcher import Failure, Launcher, LocalLauncher, count_cores
from hrl_escape.experiments.monitor import Monitor
from hrl_escape.files import describe_write_failure, write_json

__all__ = ["Comparison", "run_grid"]


@dataclass(frozen=True)
class Comparison:
    """What a comparison has so far.

    Attributes:
        grid: what was asked for.
        instances: the rooms, in the grid's order.
        runs: finished cells with their results, in the grid's order.
        failures: cells that failed.
        out: its folder.
    """

    grid: Grid
    instances: tuple[RoomInstance, ...]
    runs: tuple[tuple[Cell, CellResult], ...]
    failures: tuple[Failure, ...]
    out: Path


def run_grid(grid: Grid, out: str | os.PathLike[str], launcher: Launcher | None = None,
             console: Console | None = None) -> Comparison:
    """Run what of a grid is not finished in a folder, and return all of it.

    Processes are started, so a script that calls this needs `if __name__ == "__main__":` around it.

    Args:
        grid: what to compare.
        out: the folder; made if missing. Runs in it that have the same settings are kept, others left alone.
        launcher: what runs the cells; processes on this machine by default.
        console: where progress is shown; standard error by default.

    Raises:
        GridError: the grid has nothing to run or the same thing twice.
        RunBusyError: another comparison is running in this folder.
        FileWriteError: the folder cannot be written.
        EscapeError: no such room, agent or setting.
    """
    out = Path(out).absolute()
    console = console or Console(stderr=True, highlight=False)
    launcher = launcher or LocalLauncher()
    instances = tuple(room.make_instance() for room in grid.rooms)
    cells = grid.make_cells(instances)
    with _lock(out):
        write_json(out / "grid.json", grid.to_dict())
        for instance in instances:
            instance.save(get_room_file(out, instance.id))
        workers = getattr(launcher, "workers", None) or count_cores()
        monitor = Monitor(cells, workers, console)
        unfinished = []
        for cell in cells:
            result = _read_finished(out, cell, console)
            if result is None:
                unfinished.append(cell)
            else:
                monitor.keep(cell, result)
        if len(unfinished) < len(cells):
            console.print(f"{len(cells) - len(unfinished)} of {len(cells)} runs were finished before and are kept")
        with monitor.watch():
            launcher.run(unfinished, out, monitor)
    order = {cell.folder: number for number, cell in enumerate(cells)}
    runs = sorted(monitor.results, key=lambda run: order[run[0].folder])
    failures = sorted(monitor.failures, key=lambda failure: order[failure.cell.folder])
    return Comparison(grid, instances, tuple(runs), tuple(failures), out)


@contextmanager
def _lock(out: Path) -> Iterator[None]:
    """One comparison at a time in a folder; the lock falls with the process, however it ends."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock = open(out / "lock", "ab")
    except OSError as error:
        raise FileWriteError(describe_write_failure(out, error)) from error
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise RunBusyError(
                f"{out}: another comparison is running in this folder. Wait for it or choose another folder"
            ) from error
        yield


def _read_finished(out: Path, cell: Cell, console: Console) -> CellResult | None:
    """A finished result; a damaged one is worked out again from its run, or run again."""
    try:
        return read_cell(out, cell)
    except FileReadError as error:
        console.print(f"{error}. It is made again", style="yellow")
        (get_cell_folder(out, cell) / "cell.json").unlink(missing_ok=True)
        return None
