"""Progress of a comparison: a line for each finished run and, on a terminal, a table of scores and time left."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from hrl_escape.comparison.grid import GridRun
from hrl_escape.comparison.launching.local import Failure
from hrl_escape.comparison.runs import RunResult
from hrl_escape.comparison.statistics import compute_iqm
from hrl_escape.names import tell_seconds


@dataclass
class _Tally:
    """Numbers of one agent's runs, kept up to date so that a table costs the same however many have ended."""

    runs: int = 0
    failed: int = 0
    efficiencies: list[float] = field(default_factory=list)
    escapes: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    @property
    def left(self) -> int:
        """Runs that have not ended."""
        return self.runs - self.failed - len(self.efficiencies)


class Monitor:
    """Listener that shows the progress of runs.

    Args:
        runs: all of the comparison's.
        console: shows the progress.
    """

    def __init__(self, runs: Sequence[GridRun], console: Console) -> None:
        self.runs, self.workers, self.console = {run.folder: run for run in runs}, 1, console
        self.failures: list[Failure] = []
        self.results: list[tuple[GridRun, RunResult]] = []
        self._tallies = {run.agent.label: _Tally() for run in runs}
        for run in runs:
            self._tallies[run.agent.label].runs += 1
        self._started: dict[str, float] = {}
        self._progress: Mapping[str, int] = {}
        self._live: Live | None = None

    @contextmanager
    def watch(self) -> Iterator[None]:
        """Show the table while the body runs."""
        if not self.console.is_terminal:
            yield
            return
        with Live(console=self.console, refresh_per_second=4, get_renderable=self._draw, transient=True) as self._live:
            yield

    def keep(self, run: GridRun, result: RunResult) -> None:
        """Count a run that was finished before."""
        self.results.append((run, result))
        tally = self._tallies[run.agent.label]
        tally.efficiencies.append(result.get_final("efficiency"))
        tally.escapes.append(result.get_final("success_rate"))

    def finish(self, run: GridRun, result: RunResult) -> None:
        """Show a finished run."""
        self.keep(run, result)
        started = self._started.pop(run.folder, None)
        seconds = result.seconds[-1] if started is None else time.monotonic() - started
        self._tallies[run.agent.label].seconds.append(seconds)
        self._say(run, f"efficiency {result.get_final('efficiency'):.3f}, escapes "
                        f"{result.get_final('success_rate'):.0%}, {result.get_final('mean_length'):.0f} primitives an "
                        "episode", "green")

    def fail(self, failure: Failure) -> None:
        """Show a failed run."""
        self._started.pop(failure.run.folder, None)
        self.failures.append(failure)
        self._tallies[failure.run.agent.label].failed += 1
        self._say(failure.run, f"failed: {failure.message}", "red")

    def tick(self, progress: Mapping[str, int], workers: int) -> None:
        """Take note of the primitives that running runs have trained for, and of how many run at a time."""
        now, self.workers = time.monotonic(), max(1, workers)
        for folder in progress:
            self._started.setdefault(folder, now)
        self._progress = progress

    def _say(self, run: GridRun, words: str, colour: str) -> None:
        count = len(self.results) + len(self.failures)
        text = Text(f"[{count:>{len(str(len(self.runs)))}}/{len(self.runs)}] ", style="dim")
        self.console.print(text.append(f"{run.name}: ", style="bold").append(words, style=colour), soft_wrap=True)

    # --- the table -----------------------------------------------------------------------

    def _draw(self) -> Group:
        table = Table(box=None, pad_edge=False, header_style="dim")
        table.add_column("agent")
        for heading in ("runs", "efficiency so far", "escapes", "running"):
            table.add_column(heading, justify="right")
        for label, tally in self._tallies.items():
            running = [f"{share:.0%}" for run, share in self._list_running() if run.agent.label == label]
            done = len(tally.efficiencies)
            score = f"{float(compute_iqm([np.array(tally.efficiencies)])):.3f}" if done else "-"
            escapes = f"{np.mean(tally.escapes):.0%}" if done else "-"
            count = f"{done}/{tally.runs}" + (f", {tally.failed} failed" if tally.failed else "")
            table.add_row(label, count, score, escapes, " ".join(running))
        ended = len(self.results) + len(self.failures)
        bar = ProgressBar(len(self.runs), ended, width=40)
        left = self._estimate_seconds_left()
        return Group("", table, bar, Text(f"{ended} of {len(self.runs)} runs" + (
            f", about {tell_seconds(left)} left" if left is not None else ""), style="dim"))

    def _estimate_seconds_left(self) -> float | None:
        """Estimate from the finished runs of the same agent, or of all agents before its first has finished."""
        every = [seconds for tally in self._tallies.values() for seconds in tally.seconds]
        if not every:
            return None
        means = {label: float(np.mean(tally.seconds or every)) for label, tally in self._tallies.items()}
        total = sum(tally.left * means[label] for label, tally in self._tallies.items())
        total -= sum(share * means[run.agent.label] for run, share in self._list_running())
        return max(0.0, total) / self.workers

    def _list_running(self) -> list[tuple[GridRun, float]]:
        """Running runs, and the share of its budget that each has trained for."""
        runs = [(self.runs[folder], primitives) for folder, primitives in self._progress.items()]
        return [(run, min(1.0, primitives / run.grid.primitives)) for run, primitives in runs]
