"""Figures by number of buttons, where a wrong press resets the room: who escapes, and how soon.

A cell that was given up has fewer runs there, and none with more buttons. Intervals are Wilson's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator, PercentFormatter

from hrl_escape.benchmark.inference import compute_wilson_interval
from studies.figures import Theme, make_figure, mark_counts, write_label
from studies.parts.answers import PartsRun

__all__ = ["BASELINE", "FULL", "LIMIT", "RULE", "STRUCTURED", "count_escapes", "draw_medians", "draw_reach",
           "find_medians"]

LIMIT, RULE = 10, "reset"
FULL, BASELINE = "options + both", "retrace"
STRUCTURED = (FULL, "options + structure", "learned walks + structure")
"""Cells that learn which button enables which."""


class _Line(NamedTuple):
    """Look of a cell: its label, its place in either figure, and dashes."""

    label: str
    reach: tuple[float, float]
    medians: tuple[float, float]
    dashes: str = "-"


_LINES = {
    FULL: _Line("+ memory\n+ structure", (6.3, 0.96), (13.3, 3_000)),
    "options + memory": _Line("+ memory", (3.7, 0.87), (7.7, 6_000)),
    "options": _Line("options", (0.85, 0.91), (6.2, 15_000)),
    "flat": _Line("moves\nonly", (0.45, 0.66), (2.05, 40_000)),
    BASELINE: _Line("search\nbaseline", (5.6, 0.52), (8.3, 190), "--"),
}


def count_escapes(runs: Sequence[PartsRun], cell: str, rule: str = RULE) -> dict[int, tuple[int, int]]:
    """Count by number of buttons the runs of a cell that escaped, and all, with walks that never fail."""
    return {size: (sum(map(math.isfinite, ends)), len(ends)) for size, ends in _list_ends(runs, cell, rule).items()}


def find_medians(runs: Sequence[PartsRun], cell: str, rule: str = RULE) -> dict[int, float]:
    """Median primitives to the first escape by number of buttons; infinite where most runs do not escape."""
    return {size: float(np.median(ends)) for size, ends in _list_ends(runs, cell, rule).items()}


def _list_ends(runs: Sequence[PartsRun], cell: str, rule: str) -> dict[int, list[float]]:
    ends: dict[int, list[float]] = {}
    for run in sorted(runs, key=lambda run: run.buttons):
        if (run.cell, run.rule, run.failure) == (cell, rule, 0.0):
            ends.setdefault(run.buttons, []).append(run.first_escape or math.inf)
    return ends


def draw_reach(runs: Sequence[PartsRun], theme: Theme) -> Figure:
    """Draw the share of runs that escape, by number of buttons."""
    counts = {cell: count_escapes(runs, cell) for cell in _LINES}
    sizes = sorted({size for own in counts.values() for size in own})

    def draw(axes: Axes) -> None:
        for number, ((cell, line), colour) in enumerate(zip(_LINES.items(), theme.lines, strict=True)):
            places = [sizes.index(size) + 0.05 * (2 - number) for size in counts[cell]]
            shares = [escaped / count for escaped, count in counts[cell].values()]
            for place, share, (_, count) in zip(places, shares, counts[cell].values(), strict=True):
                axes.plot([place, place], compute_wilson_interval(share, count), color=colour, linewidth=1, alpha=0.45)
            axes.plot(places, shares, line.dashes, color=colour, linewidth=2.2, marker="o", markersize=4)
            write_label(axes, *line.reach, line.label, colour)
        axes.set(xlabel="buttons in the room", ylabel="runs that escape", ylim=(-0.04, 1.06),
                 xlim=(-0.3, len(sizes) - 0.3))
        axes.set_xticks(range(len(sizes)), [str(size) for size in sizes])
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))

    return make_figure(theme, draw)


def draw_medians(medians: Mapping[tuple[str, str], Mapping[int, float]], theme: Theme) -> Figure:
    """Draw the median primitives to the first escape; a line ends where half of the runs or more do not."""

    def draw(axes: Axes) -> None:
        sizes = sorted(medians[FULL, RULE])
        for (cell, line), colour in zip(_LINES.items(), theme.lines, strict=True):
            own = {size: middle for size, middle in medians[cell, RULE].items() if math.isfinite(middle)}
            axes.plot(list(own), list(own.values()), line.dashes, color=colour, linewidth=2.2, marker="o", markersize=4)
            write_label(axes, *line.medians, line.label, colour)
        axes.set(xscale="log", yscale="log", xlabel="buttons in the room", ylabel="primitives to the first escape")
        axes.set_xticks(sizes, [str(size) for size in sizes])
        axes.xaxis.set_minor_locator(NullLocator())
        mark_counts(axes.yaxis)

    return make_figure(theme, draw)
