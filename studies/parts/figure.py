"""The figure: growth of every cell under each rule, and the ratios of all questions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

from hrl_escape.env.pictures import palette
from hrl_escape.names import join_words
from studies.figures import FIGURE_STYLE, finish_axes
from studies.parts.answers import Answer, Law, PartsRun

__all__ = ["draw"]

COLOURS = {"flat": palette.LINES[0], "learned walks": palette.LINES[2], "options": palette.LINES[1]}
MARKS = {"": "o", "commitment": "s", "memory": "^", "structure": "D", "both": "*"}


def draw(runs: Sequence[PartsRun], laws: Mapping[tuple[str, str], Law | None], answers: Sequence[Answer],
         data: Mapping[str, Any]) -> Figure:
    """Medians to the first escape under each rule, both axes logarithmic, and a forest of the answers."""
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(11.2, 4.6), facecolor=palette.BACKGROUND, layout="constrained")
        *panels, forest = figure.subplots(1, len(data["rules"]) + 1, width_ratios=[1] * len(data["rules"]) + [0.9])
        for axes, rule in zip(panels, data["rules"], strict=True):
            _draw_growth(axes, [run for run in runs if (run.rule, run.failure) == (rule, 0)], laws, rule, data)
        for axes in panels[1:]:
            axes.sharey(panels[0])
            axes.set_ylabel("")
        _draw_forest(forest, answers, data["rules"])
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=6, frameon=False, fontsize=8)
    return figure


def _draw_growth(axes: Axes, runs: Sequence[PartsRun], laws: Mapping[tuple[str, str], Law | None], rule: str,
                 data: Mapping[str, Any]) -> None:
    for cell in data["cells"]:
        base, _, part = cell["name"].partition(" + ")
        colour, mark = COLOURS.get(base, palette.MUTED), MARKS.get(part, ".")
        own = [run for run in runs if run.cell == cell["name"]]
        times = {size: [run.first_escape or math.inf for run in own if run.buttons == size]
                 for size in sorted({run.buttons for run in own})}
        medians = {size: middle for size, ends in times.items() if np.isfinite(middle := float(np.median(ends)))}
        style = {"linestyle": ":" if "reference" in cell else "-", "linewidth": 1.5, "markersize": 4.5}
        axes.plot(list(medians), list(medians.values()), marker=mark, color=colour, label=cell["name"],
                  alpha=0.6 if "reference" in cell else 1.0, **style)
        if (law := laws.get((cell["name"], rule))) is not None:
            axes.fill_between(law.sizes, *law.band, color=colour, alpha=0.12, linewidth=0)
    finish_axes(axes)
    axes.set(xscale="log", yscale="log", xlabel="buttons", ylabel="primitives to the first escape (median)")
    axes.set_title(f"rule: {rule}", fontsize=9, loc="left")
    axes.set_xticks(data["sizes"], [str(size) for size in data["sizes"]])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.axhline(data["budget"], color=palette.MUTED, linewidth=0.8, linestyle="--")
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))


def _draw_forest(axes: Axes, answers: Sequence[Answer], rules: Sequence[str]) -> None:
    """Ratios with their intervals, a row a question; those that pay to the right of 1, hollow under further rules."""
    rows = list(dict.fromkeys((one.part, one.more) for one in answers))
    names = {row: f"{row[1]} against\n{join_words(list(dict.fromkeys(one.less for one in answers if one[:2] == row)))}"
             for row in rows}
    for one in answers:
        if math.isnan(one.factor):
            continue
        place = rules.index(one.rule)
        row = rows.index((one.part, one.more)) + 0.3 * (place - (len(rules) - 1) / 2)
        colour = {"pays": palette.LINES[2], "costs": palette.LINES[1]}.get(one.verdict, palette.MUTED)
        axes.plot([one.low, one.high], [row, row], color=colour, linewidth=1.5)
        axes.plot(one.factor, row, "o", color=colour, markersize=5,
                  markerfacecolor=palette.BACKGROUND if place else colour)
    finish_axes(axes)
    axes.axvline(1.0, color=palette.INK, linewidth=0.8)
    axes.set(xscale="log", xlabel="times fewer primitives with the part")
    axes.set_title(f"● {rules[0]}   " + "   ".join(f"○ {rule}" for rule in rules[1:]), fontsize=9, loc="left")
    axes.set_yticks(range(len(rows)), [names[row] for row in rows], fontsize=7.5)
    axes.yaxis.tick_right()
    axes.invert_yaxis()
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
