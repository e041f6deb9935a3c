"""Comparisons: all runs of a grid in one folder, in which finished runs are kept and never run twice.

While runs are made, a line stands for each that has ended and, on a terminal, a bar with the time left.
`summary.py` computes the results, `reporting/report.py` writes them up.
"""

from __future__ import annotations

import os
import statistics
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

from hrl_escape.benchmark.cost import describe_cost
from hrl_escape.benchmark.grid import Grid, GridRun, load_grid
from hrl_escape.benchmark.launching.local import Failure, Launcher, LocalLauncher
from hrl_escape.benchmark.runs import RunResult, get_run_folder, load_run_result
from hrl_escape.errors import ConfigError, FileReadError, RunBusyError
from hrl_escape.figures import Pictured
from hrl_escape.files import clear_unfinished, make_folder, open_for_writing, write_json
from hrl_escape.names import parse_whole
from hrl_escape.processes import take_lock
from hrl_escape.sets.places import RunPlace

SPEED_SECONDS = 3600.0
"""Time over which the speed is averaged that the time left follows from."""


class Monitor:
    """Listener that shows the progress of a comparison's runs on a console."""

    def __init__(self, runs: Sequence[GridRun], console: Console) -> None:
        self.runs, self.console = {run.folder: run for run in runs}, console
        self.failures: list[Failure] = []
        self.results: list[tuple[GridRun, RunResult]] = []
        self._kept = 0
        self._bar: Progress | None = None

    @contextmanager
    def watch(self) -> Iterator[None]:
        """Show a bar, and the time left, while the body runs."""
        if not self.console.is_terminal:
            yield
            return
        words = TextColumn("{task.completed:.0f} of {task.total:.0f} runs")
        with Progress(words, BarColumn(), TimeRemainingColumn(), console=self.console, transient=True,
                      speed_estimate_period=SPEED_SECONDS) as self._bar:
            self._bar.add_task("runs", total=len(self.runs) - self._kept)
            yield

    def keep(self, run: GridRun, result: RunResult) -> None:
        """Count a run that was finished before."""
        self.results.append((run, result))
        self._kept += 1

    def finish(self, run: GridRun, result: RunResult) -> None:
        """Show a finished run."""
        self.results.append((run, result))
        self._say(run, f"efficiency {result.get_final('efficiency'):.3f}, success rate "
                        f"{result.get_final('success_rate'):.0%}, {result.get_final('mean_length'):.0f} primitives an "
                        "episode", "green")

    def fail(self, failure: Failure) -> None:
        """Show a failed run."""
        self.failures.append(failure)
        self._say(failure.run, f"failed: {failure.message}", "red")

    def tick(self, progress: Mapping[str, int]) -> None:
        """Move the bar to the runs that have ended and the shares that running ones have trained for."""
        if self._bar is not None:
            ended = len(self.results) + len(self.failures) - self._kept
            shares = [min(1.0, done / self.runs[folder].grid.primitives) for folder, done in progress.items()]
            self._bar.update(self._bar.task_ids[0], completed=ended + sum(shares))

    def _say(self, run: GridRun, words: str, colour: str) -> None:
        count = len(self.results) + len(self.failures)
        text = Text(f"[{count:>{len(str(len(self.runs)))}}/{len(self.runs)}] ", style="dim")
        self.console.print(text.append(f"{run.name}: ", style="bold").append(words, style=colour), soft_wrap=True)

@dataclass(frozen=True, repr=False)
class Comparison(Pictured):
    """Runs of a grid that have ended."""

    grid: Grid  # the settings
    places: tuple[RunPlace, ...]  # rooms, or sets of rooms, in the grid's order
    runs: tuple[tuple[GridRun, RunResult], ...]  # finished runs with their results, in the grid's order
    failures: tuple[Failure, ...]  # runs that failed
    out: Path  # its folder

    _picture = "hrl_escape.benchmark.reporting.figures:draw_comparison"

    def __repr__(self) -> str:
        return (f"<Comparison of {len(self.grid.agents)} agents in {len(self.places)} rooms: {len(self.runs)} finished "
                f"runs, {len(self.failures)} failed, in {self.out}>")


class Shard(NamedTuple):
    """Static part of a grid's runs: every `parts`-th, beginning with number `number`."""

    number: int  # number of the part, from 1
    parts: int  # number of parts

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Read `2/8`; `ConfigError` where it is no part."""
        number, _, parts = map(parse_whole, text.partition("/"))
        if number is None or parts is None or not 1 <= number <= parts:
            raise ConfigError("shard", text, "the number of a part and how many there are, such as 2/8")
        return cls(number, parts)

    def choose(self, runs: Sequence[GridRun]) -> list[GridRun]:
        """Runs of this part, in order; the parts are disjoint, and together they are all."""
        return list(runs[self.number - 1 :: self.parts])


WHOLE = Shard(1, 1)


def run_grid(grid: Grid, out: str | os.PathLike[str], launcher: Launcher | None = None,
             console: Console | None = None, shard: Shard = WHOLE) -> Comparison:
    """Run what of a grid is not finished in a folder, and return all of it.

    Processes are started, so a script that calls this needs `if __name__ == "__main__":` around it.

    Args:
        grid: what to compare.
        out: the folder; made if missing. Runs in it that have the same settings are kept, others left alone.
        launcher: starts the runs; processes on this machine by default.
        console: shows progress; standard error by default.
        shard: part of the runs to make. Machines that share the folder make one part each; `read_comparison` reads
            what all have made.

    Raises:
        GridError: the grid has nothing to run or the same thing twice.
        RunBusyError: another comparison is running in this folder.
        FileWriteError: the folder cannot be written.
        EscapeError: no such room, agent or setting.
    """
    places, every = _make_runs(grid)
    runs, out = shard.choose(every), Path(out).absolute()
    console = console or Console(stderr=True, highlight=False)
    with _lock(out, shard):
        shared = [out, out / "rooms"] if shard == WHOLE else []  # where other parts may be writing at this moment
        for folder in (*shared, *(get_run_folder(out, run) for run in runs)):
            clear_unfinished(folder)
        write_json(out / "grid.json", grid.to_dict())
        for place in places:
            place.save(out / "rooms")
        monitor, unfinished = Monitor(runs, console), []
        for run in runs:
            result = _read_finished(out, run, console)
            if result is None:
                unfinished.append(run)
            else:
                monitor.keep(run, result)
        if len(unfinished) < len(runs):
            console.print(f"{len(runs) - len(unfinished)} of {len(runs)} runs were finished before and are kept")
        else:
            console.print(describe_cost(grid, places))
        with monitor.watch():
            (launcher or LocalLauncher()).run(unfinished, out, monitor)
    order = {run.folder: number for number, run in enumerate(runs)}
    finished = sorted(monitor.results, key=lambda result: order[result[0].folder])
    failures = sorted(monitor.failures, key=lambda failure: order[failure.run.folder])
    return Comparison(grid, places, tuple(finished), tuple(failures), out)


def read_comparison(out: str | os.PathLike[str], grid: Grid | None = None) -> Comparison:
    """Read the finished runs of a comparison, wherever they were made, without running or changing anything.

    Args:
        out: its folder.
        grid: what was compared; None for what the folder says.

    Raises:
        FileReadError: there is no comparison, or one of its files is damaged.
    """
    out = Path(out).absolute()
    grid = grid or load_grid(out / "grid.json")
    places, runs = _make_runs(grid)
    found = [(run, result) for run in runs if (result := load_run_result(out, run)) is not None]
    return Comparison(grid, places, tuple(found), (), out)


def count_missing(grid: Grid, out: str | os.PathLike[str]) -> tuple[int, int, float | None]:
    """Count a grid's runs, those to be made in a folder, and the median seconds of training of those finished.

    The seconds are None where none has finished.
    """
    (_, runs), out = _make_runs(grid), Path(out).absolute()
    seconds = [result.seconds[-1] for run in runs if (result := load_run_result(out, run)) is not None]
    return len(runs), len(runs) - len(seconds), statistics.median(seconds) if seconds else None


def _make_runs(grid: Grid) -> tuple[tuple[RunPlace, ...], list[GridRun]]:
    """Make the places and the runs of a grid, which refuses impossible ones."""
    places = grid.make_places()
    return places, grid.make_runs(places)


@contextmanager
def _lock(out: Path, shard: Shard = WHOLE) -> Iterator[None]:
    """One comparison at a time in a folder, or one of each part; the lock falls with the process, however it ends."""
    make_folder(out)
    with open_for_writing(out / ("lock" if shard == WHOLE else f"lock-{shard.number}-of-{shard.parts}")) as lock:
        if not take_lock(lock):
            raise RunBusyError(
                f"{out}: another comparison is running in this folder. Wait for it or choose another folder")
        yield


def _read_finished(out: Path, run: GridRun, console: Console) -> RunResult | None:
    """Result of a finished run; a damaged one is removed, so that the run is finished again from its training."""
    try:
        return load_run_result(out, run)
    except FileReadError as error:
        console.print(f"{error}. It is made again", style="yellow")
        (get_run_folder(out, run) / "run_result.json").unlink(missing_ok=True)
        return None
