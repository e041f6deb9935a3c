"""What a person sees while a comparison runs: a line for each finished run, and how far the others are.

On a terminal a table with scores so far and the time left stands below the lines; elsewhere
only the lines are written. It decides nothing.
"""

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

from hrl_escape.experiments.cell import CellResult
from hrl_escape.experiments.grid import Cell
from hrl_escape.experiments.launcher import Failure
from hrl_escape.experiments.statistics import compute_iqm, compute_score

__all__ = ["Monitor"]


class Monitor:
    """A `Listener` that shows what it hears.

    Args:
        cells: all of the comparison's.
        workers: how many run at a time, for the time left.
        console: where to write.
    """

    def __init__(self, cells: Sequence[Cell], workers: int, console: Console) -> None:
        self.cells, self.workers, self.console = cells, workers, console
        self.failures: list[Failure] = []
        self.results: list[tuple[Cell, CellResult]] = []
        self._seconds: dict[str, list[float]] = {}
        self._started: dict[str, float] = {}
        self._progress: Mapping[str, int] = {}
        self._live: Live | None = None

    @contextmanager
    def watch(self) -> Iterator[None]:
        """Show the table meanwhile."""
        if not self.console.is_terminal:
            yield
            return
        with Live(console=self.console, refresh_per_second=4, get_renderable=self._draw, transient=True) as self._live:
            yield

    def keep(self, cell: Cell, result: CellResult) -> None:
        """Take in a run that was finished before."""
        self.results.append((cell, result))

    def finish(self, cell: Cell, result: CellResult) -> None:
        """A run finished."""
        self.results.append((cell, result))
        seconds = time.monotonic() - self._started.pop(cell.folder, time.monotonic())
        self._seconds.setdefault(cell.agent.label, []).append(seconds)
        self._say(cell, f"score {_score(result):.3f}, escapes {result.get_final('success_rate'):.0%}, "
                        f"{result.get_final('mean_length'):.0f} primitives an episode", "green")

    def fail(self, failure: Failure) -> None:
        """A run failed."""
        self._started.pop(failure.cell.folder, None)
        self.failures.append(failure)
        self._say(failure.cell, f"failed: {failure.message}", "red")

    def tick(self, progress: Mapping[str, int]) -> None:
        """Where the running ones are."""
        now = time.monotonic()
        for folder in progress:
            self._started.setdefault(folder, now)
        self._progress = progress

    def _say(self, cell: Cell, words: str, colour: str) -> None:
        count = len(self.results) + len(self.failures)
        text = Text(f"[{count:>{len(str(len(self.cells)))}}/{len(self.cells)}] ", style="dim")
        self.console.print(text.append(f"{cell.name}: ", style="bold").append(words, style=colour), soft_wrap=True)

    # --- the table -----------------------------------------------------------------------

    def _draw(self) -> Group:
        table = Table(box=None, pad_edge=False, header_style="dim")
        table.add_column("agent")
        for heading in ("runs", "score so far", "escapes", "running"):
            table.add_column(heading, justify="right")
        for label in dict.fromkeys(cell.agent.label for cell in self.cells):
            mine = [cell for cell in self.cells if cell.agent.label == label]
            done = [(cell, result) for cell, result in self.results if cell.agent.label == label]
            failed = sum(failure.cell.agent.label == label for failure in self.failures)
            running = [f"{self._progress[cell.folder] / cell.grid.primitives:.0%}" for cell in mine
                       if cell.folder in self._progress]
            score = f"{float(compute_iqm([np.array([_score(result) for _, result in done])])):.3f}" if done else "-"
            escapes = f"{np.mean([result.get_final('success_rate') for _, result in done]):.0%}" if done else "-"
            count = f"{len(done)}/{len(mine)}" + (f", {failed} failed" if failed else "")
            table.add_row(label, count, score, escapes, " ".join(running))
        ended = len(self.results) + len(self.failures)
        bar = ProgressBar(len(self.cells), ended, width=40)
        left = self._estimate_seconds_left()
        return Group("", table, bar, Text(f"{ended} of {len(self.cells)} runs" + (
            f", about {_format_seconds(left)} left" if left is not None else ""), style="dim"))

    def _estimate_seconds_left(self) -> float | None:
        """By what runs of the same agent took, or of any agent where none has finished yet."""
        every = [seconds for known in self._seconds.values() for seconds in known]
        if not every:
            return None
        ended = {cell.folder for cell, _ in self.results} | {failure.cell.folder for failure in self.failures}
        total = 0.0
        for cell in self.cells:
            if cell.folder not in ended:
                known = self._seconds.get(cell.agent.label, every)
                share = min(1.0, self._progress.get(cell.folder, 0) / cell.grid.primitives)
                total += (1 - share) * sum(known) / len(known)
        return total / self.workers


def _score(result: CellResult) -> float:
    """The final score, by what was known before the comparison."""
    return float(compute_score(result.get_final("mean_return"), result.scale.worst, np.mean(result.scale.best)))


def _format_seconds(seconds: float) -> str:
    minutes = round(seconds / 60)
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"
