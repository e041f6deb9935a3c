"""The look of the studies' figures, for light and dark pages."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

__all__ = ["FIGURE_STYLE", "THEMES", "Drawing", "Theme", "draw_rows", "make_figure", "mark_counts",
           "write_key", "write_label"]

FIGURE_STYLE: dict[Any, Any] = {"font.family": "DejaVu Sans", "font.size": 9, "svg.hashsalt": "hrl-escape"}
WIDTH = 5.6
"""Inches of a figure: at 390 px, text of 10 points is 9 px high."""


class Theme(NamedTuple):
    """Colours of figures on a page.

    Attributes:
        suffix: of the name of the file.
        ink: text and axes.
        muted: text and lines that stand back.
        grid: of axes.
        lines: five colours of lines that differ for any colour vision.
    """

    suffix: str
    ink: str
    muted: str
    grid: str
    lines: tuple[str, ...]


LIGHT = Theme("", "#22262e", "#5b616b", "#d8d3c8", ("#00795a", "#0072b2", "#b86f00", "#a8497f", "#5b616b"))
DARK = Theme("-dark", "#e6edf3", "#9aa4b0", "#3a424d", ("#2fbf8f", "#56b4e9", "#e69f00", "#dd8fbe", "#9aa4b0"))
THEMES = (LIGHT, DARK)

Drawing: TypeAlias = Callable[[Theme], Figure]
"""Draws a figure for a theme."""


def make_figure(theme: Theme, draw: Callable[[Any], None], height: float = 3.7, grid: str = "y", **how: Any) -> Figure:
    """Draw a transparent figure of the common width.

    Args:
        theme: colours.
        draw: draws into the axes: one, or an array of them, as `Figure.subplots` returns them.
        height: inches.
        grid: axis that has grid lines.
        how: for `Figure.subplots`.
    """
    style: Any = FIGURE_STYLE | {
        "font.size": 10, "text.color": theme.ink, "axes.labelcolor": theme.ink, "axes.titlecolor": theme.ink,
        "axes.edgecolor": theme.ink, "axes.facecolor": "none", "axes.axisbelow": True, "axes.spines.top": False,
        "axes.spines.right": False}
    with matplotlib.rc_context(style):
        figure = Figure(figsize=(WIDTH, height), facecolor="none", layout="constrained")
        axes = figure.subplots(**how)
        for each in figure.axes:  # ticks are made when they are drawn, outside this context
            each.tick_params(which="both", colors=theme.ink, grid_color=theme.grid, grid_linewidth=0.8)
            each.grid(axis=grid)  # pyright: ignore[reportArgumentType]
        draw(axes)
    return figure


def mark_counts(axis: Any) -> None:
    """Mark an axis with plain numbers, 10,000 and 0.1 in place of powers of ten."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}" if value >= 1 else f"{value:g}"))


def write_label(axes: Axes, x: float, y: float, text: str, colour: str, **how: Any) -> None:
    """Write the label of a line next to it, in its colour."""
    axes.text(x, y, text, color=colour, fontweight="bold", va="center", **how)


def write_key(axes: Axes, words: Sequence[tuple[str, str]]) -> None:
    """Write names in their colours above the axes, one a line."""
    for number, (text, colour) in enumerate(reversed(words)):
        axes.annotate(text, (0, 1), (0, 6 + 15 * number), xycoords="axes fraction", textcoords="offset points",
                      color=colour, fontweight="bold")


def draw_rows(rows: Sequence[str], lines: Sequence[tuple[str, Mapping[str, float]]], label: str, theme: Theme,
              is_joined: bool = True) -> Figure:
    """Draw values of agents by row, an agent a colour of its own, the last one grey.

    Args:
        rows: names, from the top.
        lines: name of an agent, and its value in each row that it has; five at most.
        label: of the x-axis, which runs from 0 to 1.
        theme: colours.
        is_joined: lines join the values of an agent, because the rows have an order.
    """
    colours = [*theme.lines[: len(lines) - 1], theme.lines[-1]]

    def paint(axes: Axes) -> None:
        for number, ((_, values), colour) in enumerate(zip(lines, colours, strict=True)):
            known = [(value, place) for place, row in enumerate(rows) if (value := values.get(row)) is not None]
            style = ("" if not is_joined else ":" if number == len(lines) - 1 else "-") + "o"
            axes.plot(*zip(*known, strict=True), style, markersize=4 if is_joined else 6, linewidth=1.6, color=colour)
        write_key(axes, [(name, colour) for (name, _), colour in zip(lines, colours, strict=True)])
        axes.set_yticks(range(len(rows)), rows)
        axes.set(xlabel=label, xlim=(-0.03, 1.03), ylim=(len(rows) - 0.4, -0.6))

    return make_figure(theme, paint, height=1.9 + 0.23 * len(rows), grid="x")
