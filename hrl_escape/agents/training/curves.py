"""Learning curves of many runs: common points, names of groups, and a line with a band for each group."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.figures import LINES, get_figure_class
from hrl_escape.intervals import compute_mean_interval

if TYPE_CHECKING:
    from matplotlib.figure import Figure

POINTS = 101
"""Points of the line of several runs."""


class Line(NamedTuple):
    """Learning curve of one run, and the name of its group."""

    group: str
    x: NDArray[np.float64]  # (points,) ascending
    y: NDArray[np.float64]  # (points,)
    seed: int | None = None  # of the run, if known


def join_curves(curves: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]]
                ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Interpolate curves linearly to common points.

    Args:
        curves: x and y of each run, (points,) with x ascending.

    Returns:
        x (n,) and y (n, runs). One curve keeps its own points. Several have `POINTS` from the latest start to the
        earliest end, or one point where they do not overlap.
    """
    if len(curves) == 1:
        return curves[0][0], curves[0][1][:, np.newaxis]
    start, end = max(x[0] for x, _ in curves), min(x[-1] for x, _ in curves)
    common = np.linspace(start, end, POINTS) if end > start else np.array([min(start, end)])
    return common, np.stack([np.interp(common, x, y) for x, y in curves], axis=-1)


def draw_lines(lines: Sequence[Line], x_label: str, y_label: str, level: float = 0.95) -> Figure:
    """Draw the mean of each group with the interval of the mean by Student's t; a single run has no band."""
    figure = get_figure_class()(figsize=(5.6, 3.0), dpi=120, layout="constrained")
    axes = figure.add_subplot()
    groups: dict[str, list[Line]] = {}
    for line in lines:
        groups.setdefault(line.group, []).append(line)
    for number, (name, runs) in enumerate(groups.items()):
        colour = LINES[number % len(LINES)]
        x, values = join_curves([(run.x, run.y) for run in runs])
        mean, low, high = compute_mean_interval(values, level)
        if len(runs) > 1:
            axes.plot(x, mean, color=colour, linewidth=1.8, label=f"{name} ({len(runs)} runs)")
            axes.fill_between(x, low, high, color=colour, alpha=0.16, linewidth=0)
        else:
            label = name if runs[0].seed is None else f"{name}, seed {runs[0].seed}"
            axes.plot(x, mean, color=colour, linewidth=1.8, marker="o", markersize=3, label=label)
    axes.set(xlabel=x_label, ylabel=y_label)
    axes.legend(frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def name_agents(agents: Sequence[tuple[str, Mapping[str, Any]]]) -> list[str]:
    """Return a name for each agent, given its name and settings: those of one name get the settings that differ."""
    names = []
    for name, own in agents:
        others = [settings for other, settings in agents if other == name]
        changed = [key for key, value in own.items() if any(other.get(key) != value for other in others)]
        words = ", ".join(f"{key} {own[key]}" for key in changed)
        names.append(f"{name} ({words})" if words else name)
    return names
