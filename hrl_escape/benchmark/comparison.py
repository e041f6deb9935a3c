"""Comparisons: all runs of a grid in one folder; finished runs are kept.

The console shows a line for each finished run and, on a terminal, a progress bar. `summary.py` computes the results and
`reporting/report.py` writes the report.
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
from rich.text import Text

from hrl_escape.benchmark.cost import describe_cost
from hrl_escape.benchmark.env_spec import EnvPlace
from hrl_escape.benchmark.grid import Grid, GridRun, load_grid
from hrl_escape.benchmark.launching.local import Failure, Launcher, LocalLauncher
from hrl_escape.benchmark.run_results import RunResult, get_run_folder, load_run_result
from hrl_escape.errors import ConfigError, FileReadError
from hrl_escape.figures import Pictured
from hrl_escape.files import clear_unfinished, write_json
from hrl_escape.names import parse_whole
from hrl_escape.processes import open_lock
from hrl_escape.progress import Reporter, describe_results, show_progress
from hrl_escape.sets.places import RunPlace


class Monitor:
    """Listener that shows the progress of a comparison's runs on a console."""

    def __init__(self, runs: Sequence[GridRun], console: Console, progress: bool | None = None) -> None:
        self.runs, self.console, self._shows = {run.folder: run for run in runs}, console, progress
        self.failures: list[Failure] = []
        self.results: list[tuple[GridRun, RunResult]] = []
        self._kept = 0
        self._finals: list[tuple[float, float]] = []  # mean return and success rate of finished runs
        self._primitives = runs[0].grid.primitives if runs else 0  # of each run
        self._report: Reporter = lambda primitives, words: None

    @contextmanager
    def watch(self) -> Iterator[None]:
        """Show a progress line while the body runs."""
        total = (len(self.runs) - self._kept) * self._primitives
        with show_progress("runs", total, show=self._shows, console=self.console, stays=False) as self._report:
            yield

    def keep(self, run: GridRun, result: RunResult) -> None:
        """Count a run of an earlier call."""
        self.results.append((run, result))
        self._kept += 1

    def finish(self, run: GridRun, result: RunResult) -> None:
        """Show a finished run."""
        self.results.append((run, result))
        self._say(run, result.describe_final(), "green")

    def fail(self, failure: Failure) -> None:
        """Show a failed run."""
        self.failures.append(failure)
        self._say(failure.run, f"failed: {failure.message}", "red")

    def tick(self, progress: Mapping[str, int]) -> None:
        """Show the primitives of finished and running runs, and the results of the finished ones."""
        ended = len(self.results) + len(self.failures)
        for _, result in self.results[len(self._finals):]:
            self._finals.append((result.get_final("mean_return"), result.get_final("success_rate")))
        running = sum(min(primitives, self._primitives) for primitives in progress.values())
        words = describe_results(*zip(*self._finals, strict=True)) if self._finals else ""
        self._report((ended - self._kept) * self._primitives + running, f"{ended} of {len(self.runs)} finished {words}")

    def _say(self, run: GridRun, words: str, colour: str) -> None:
        count = len(self.results) + len(self.failures)
        text = Text(f"[{count:>{len(str(len(self.runs)))}}/{len(self.runs)}] ", style="dim")
        self.console.print(text.append(f"{run.name}: ", style="bold").append(words, style=colour), soft_wrap=True)

@dataclass(frozen=True, repr=False)
class Comparison(Pictured):
    """Finished and failed runs of a grid."""

    grid: Grid  # the settings
    places: tuple[RunPlace | EnvPlace, ...]  # rooms, sets of rooms, or the environment, in the grid's order
    runs: tuple[tuple[GridRun, RunResult], ...]  # finished runs with their results, in the grid's order
    failures: tuple[Failure, ...]  # runs that failed
    out: Path  # its folder

    _picture = "hrl_escape.benchmark.reporting.figures:draw_comparison"

    def __repr__(self) -> str:
        where = self.grid.env.name if self.grid.env else f"{len(self.places)} rooms"
        return (f"<Comparison of {len(self.grid.agents)} agents in {where}: {len(self.runs)} finished "
                f"runs, {len(self.failures)} failed, in {self.out}>")


class Shard(NamedTuple):
    """Part of a grid's runs for one machine: every `parts`-th run, starting with run `number`."""

    number: int  # number of the part, from 1
    parts: int  # number of parts

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Parse a text such as `2/8`.

        Raises:
            ConfigError: the text is malformed.
        """
        number, _, parts = map(parse_whole, text.partition("/"))
        if number is None or parts is None or not 1 <= number <= parts:
            raise ConfigError("shard", text, "the number of a part and how many there are, such as 2/8")
        return cls(number, parts)

    def choose(self, runs: Sequence[GridRun]) -> list[GridRun]:
        """Return the runs of this part, in order."""
        return list(runs[self.number - 1 :: self.parts])


WHOLE = Shard(1, 1)


def run_grid(grid: Grid, out: str | os.PathLike[str], launcher: Launcher | None = None,
             console: Console | None = None, shard: Shard = WHOLE, progress: bool | None = None) -> Comparison:
    """Run the unfinished runs of a grid and return the comparison.

    It starts processes, so a script needs `if __name__ == "__main__":` around the call.

    Args:
        grid: agents, rooms and seeds.
        out: folder of the runs. Finished runs with the same settings are kept.
        launcher: executes the runs; processes on this machine by default.
        console: shows progress; standard error by default.
        shard: part of the runs to make, for several machines that share the folder; `read_comparison` then reads all
            parts.
        progress: False for no progress line, as in `train`.

    Raises:
        GridError: the grid has no runs, or two equal ones.
        RunBusyError: another comparison is running in this folder.
        FileWriteError: the folder cannot be written.
        EscapeError: no such room, agent or setting.
    """
    places, every = _make_runs(grid)
    runs, out = shard.choose(every), Path(out).absolute()
    console = console or Console(stderr=True, highlight=False)
    lock = out / ("lock" if shard == WHOLE else f"lock-{shard.number}-of-{shard.parts}")
    with open_lock(lock, f"{out}: another comparison is running in this folder. Wait for it or choose another folder"):
        shared = [out, out / "rooms"] if shard == WHOLE else []  # other parts can be writing now
        for folder in (*shared, *(get_run_folder(out, run) for run in runs)):
            clear_unfinished(folder)
        write_json(out / "grid.json", grid.to_dict())
        for place in places:
            place.save(out / "rooms")
        monitor, unfinished = Monitor(runs, console, progress), []
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
    """Read the finished runs of a comparison.

    Args:
        out: its folder.
        grid: its grid, or None for the grid in the folder.

    Raises:
        FileReadError: the folder has no comparison, or a file is damaged.
    """
    out = Path(out).absolute()
    grid = grid or load_grid(out / "grid.json")
    places, runs = _make_runs(grid)
    found = [(run, result) for run in runs if (result := load_run_result(out, run)) is not None]
    return Comparison(grid, places, tuple(found), (), out)


def count_missing(grid: Grid, out: str | os.PathLike[str]) -> tuple[int, int, float | None]:
    """Count a grid's runs and its missing runs in a folder.

    Returns:
        Number of runs, number of missing runs, and median seconds of training of finished runs or None.
    """
    (_, runs), out = _make_runs(grid), Path(out).absolute()
    seconds = [result.seconds[-1] for run in runs if (result := load_run_result(out, run)) is not None]
    return len(runs), len(runs) - len(seconds), statistics.median(seconds) if seconds else None


def _make_runs(grid: Grid) -> tuple[tuple[RunPlace | EnvPlace, ...], list[GridRun]]:
    places = grid.make_places()
    return places, grid.make_runs(places)


def _read_finished(out: Path, run: GridRun, console: Console) -> RunResult | None:
    """Read the result of a finished run; removes a damaged result, so the run is completed again."""
    try:
        return load_run_result(out, run)
    except FileReadError as error:
        console.print(f"{error}. It is made again", style="yellow")
        (get_run_folder(out, run) / "run_result.json").unlink(missing_ok=True)
        return None
