"""Progress of a comparison: a line for each finished run and, on a terminal, a table of scores and time left."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from hrl_escape.experiments.grid import GridRun
from hrl_escape.experiments.launching.local import Failure
from hrl_escape.experiments.runs import RunResult
from hrl_escape.experiments.statistics import compute_iqm

__all__ = ["Monitor"]


class Monitor:
    """Listener that shows the progress of runs.

    Args:
        runs: all of the comparison's.
        workers: how many run at a time, for the time left.
        console: shows the progress.
    """

    def __init__(self, runs: Sequence[GridRun], workers: int, console: Console) -> None:
        self.runs, self.workers, self.console = runs, workers, console
        self.failures: list[Failure] = []
        self.results: list[tuple[GridRun, RunResult]] = []
        self._seconds: dict[str, list[float]] = {}
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

    def finish(self, run: GridRun, result: RunResult) -> None:
        """Show a finished run."""
        self.results.append((run, result))
        seconds = time.monotonic() - self._started.pop(run.folder, time.monotonic())
        self._seconds.setdefault(run.agent.label, []).append(seconds)
        self._say(run, f"efficiency {result.get_final('efficiency'):.3f}, escapes "
                        f"{result.get_final('success_rate'):.0%}, {result.get_final('mean_length'):.0f} primitives an "
                        "episode", "green")

    def fail(self, failure: Failure) -> None:
        """Show a failed run."""
        self._started.pop(failure.run.folder, None)
        self.failures.append(failure)
        self._say(failure.run, f"failed: {failure.message}", "red")

    def tick(self, progress: Mapping[str, int]) -> None:
        """Take note of the primitives that running runs have trained for, by folder."""
        now = time.monotonic()
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
        for label in dict.fromkeys(run.agent.label for run in self.runs):
            mine = [run for run in self.runs if run.agent.label == label]
            done = [(run, result) for run, result in self.results if run.agent.label == label]
            failed = sum(failure.run.agent.label == label for failure in self.failures)
            running = [f"{self._progress[run.folder] / run.grid.primitives:.0%}" for run in mine
                       if run.folder in self._progress]
            finals = [np.array([result.get_final("efficiency") for _, result in done])]
            score = f"{float(compute_iqm(finals)):.3f}" if done else "-"
            escapes = f"{np.mean([result.get_final('success_rate') for _, result in done]):.0%}" if done else "-"
            count = f"{len(done)}/{len(mine)}" + (f", {failed} failed" if failed else "")
            table.add_row(label, count, score, escapes, " ".join(running))
        ended = len(self.results) + len(self.failures)
        bar = ProgressBar(len(self.runs), ended, width=40)
        left = self._estimate_seconds_left()
        return Group("", table, bar, Text(f"{ended} of {len(self.runs)} runs" + (
            f", about {_format_seconds(left)} left" if left is not None else ""), style="dim"))

    def _estimate_seconds_left(self) -> float | None:
        """Estimate from the finished runs of the same agent, or of all agents before its first has finished."""
        every = [seconds for known in self._seconds.values() for seconds in known]
        if not every:
            return None
        ended = {run.folder for run, _ in self.results} | {failure.run.folder for failure in self.failures}
        total = 0.0
        for run in self.runs:
            if run.folder not in ended:
                known = self._seconds.get(run.agent.label, every)
                share = min(1.0, self._progress.get(run.folder, 0) / run.grid.primitives)
                total += (1 - share) * sum(known) / len(known)
        return total / self.workers


def _format_seconds(seconds: float) -> str:
    minutes = round(seconds / 60)
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"
