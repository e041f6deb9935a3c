"""Figure of the README: share of runs that escape, by number of buttons, where a wrong press resets the room.

A cell that was given up has fewer runs there, and none with more buttons. Intervals are Wilson's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from hrl_escape.benchmark.inference import compute_wilson_interval
from studies.figures import FIGURE_STYLE
from studies.parts.answers import PartsRun

__all__ = ["BASELINE", "FULL", "HEADLINE", "LIMIT", "RULE", "count_escapes", "draw_reach", "supports_headline"]

HEADLINE = ("When a wrong press turns all buttons off, only agents that learn the dependencies escape from more than "
            "ten buttons.")
"""Stands in the README; `supports_headline` guards it."""
LIMIT, RULE = 10, "reset"
FULL, BASELINE = "options + both", "retrace"
STRUCTURED = (FULL, "options + structure", "learned walks + structure")
"""Cells that learn which button enables which."""


class _Line(NamedTuple):
    """Look of a cell: its label and where it stands, a colour for each theme, and dashes."""

    label: str
    x: float
    y: float
    light: str
    dark: str
    dashes: str = "-"


_LINES = {
    FULL: _Line("+ memory\n+ structure", 6.3, 0.96, "#00795a", "#2fbf8f"),
    "options + memory": _Line("+ memory", 4.1, 0.86, "#0072b2", "#56b4e9"),
    "options": _Line("options", 0.85, 0.91, "#b86f00", "#e69f00"),
    "flat": _Line("moves\nonly", 0.45, 0.66, "#a8497f", "#dd8fbe"),
    BASELINE: _Line("search\nbaseline", 5.6, 0.52, "#5b616b", "#9aa4b0", "--"),
}
_THEMES = {"reach": ("light", "#22262e", "#d8d3c8"), "reach-dark": ("dark", "#e6edf3", "#3a424d")}
"""Name of a file: theme, colours of text and of the grid."""


def count_escapes(runs: Sequence[PartsRun], cell: str) -> dict[int, tuple[int, int]]:
    """Count by number of buttons the runs of a cell that escaped, and all, with walks that never fail."""
    own = [run for run in runs if (run.cell, run.rule, run.failure) == (cell, RULE, 0.0)]
    return {size: (sum(run.first_escape is not None for run in mine), len(mine))
            for size in sorted({run.buttons for run in own}) if (mine := [run for run in own if run.buttons == size])}


def supports_headline(runs: Sequence[PartsRun]) -> bool:
    """Return whether more than `LIMIT` buttons stop all runs without structure, and fewer than half of those with all.

    With all parts, at least half of the runs escape with every number of buttons. Some run without structure must have
    been made beyond the limit, for a run that was never made is not data.
    """
    beyond = {cell: {size: count for size, count in count_escapes(runs, cell).items() if size > LIMIT}
              for cell in {run.cell for run in runs}}
    without = [escaped for cell, counts in beyond.items() if cell not in STRUCTURED for escaped, _ in counts.values()]
    full = beyond.get(FULL, {})
    return bool(without) and not any(without) and len(full) > 1 and all(
        2 * escaped >= count for escaped, count in full.values())


def draw_reach(runs: Sequence[PartsRun]) -> Mapping[str, Figure]:
    """Draw the figure for a light and a dark page."""
    sizes = sorted({size for cell in _LINES for size in count_escapes(runs, cell)})
    return {name: _draw(runs, sizes, *theme) for name, theme in _THEMES.items()}


def _draw(runs: Sequence[PartsRun], sizes: Sequence[int], theme: str, ink: str, grid: str) -> Figure:
    style: Any = FIGURE_STYLE | {"font.size": 11}
    with matplotlib.rc_context(style):
        figure = Figure(figsize=(5.6, 3.7), facecolor="none", layout="constrained")
        axes: Axes = figure.subplots()
        axes.set_facecolor("none")
        for number, (cell, line) in enumerate(_LINES.items()):
            colour = getattr(line, theme)
            counts = count_escapes(runs, cell)
            places = [sizes.index(size) + 0.05 * (2 - number) for size in counts]
            shares = [escaped / count for escaped, count in counts.values()]
            for place, share, (_, count) in zip(places, shares, counts.values(), strict=True):
                axes.plot([place, place], compute_wilson_interval(share, count), color=colour, linewidth=1, alpha=0.45)
            axes.plot(places, shares, line.dashes, color=colour, linewidth=2.2, marker="o", markersize=4)
            axes.text(line.x, line.y, line.label, color=colour, fontsize=10.5, fontweight="bold", va="center")
        axes.set(xlabel="buttons in the room", ylabel="runs that escape", ylim=(-0.04, 1.06),
                 xlim=(-0.3, len(sizes) - 0.3))
        axes.set_xticks(range(len(sizes)), [str(size) for size in sizes])
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        axes.grid(axis="y", color=grid, linewidth=0.8)
        axes.set_axisbelow(True)
        axes.tick_params(colors=ink)
        for side, spine in axes.spines.items():
            spine.set_visible(side in ("left", "bottom"))
            spine.set_color(ink)
        axes.xaxis.label.set_color(ink)
        axes.yaxis.label.set_color(ink)
    return figure
