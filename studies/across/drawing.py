"""Figure of references and learners in unseen rooms: a row for each kind of cue and of family."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from studies.figures import Theme, make_figure, write_key
from studies.titles import find_title

__all__ = ["draw"]


def draw(rungs: Mapping[str, SimpleNamespace], data: Mapping[str, Any], theme: Theme) -> Figure:
    """Draw mean efficiencies: bars for search and the Bayes planner, rings after few training rooms, discs after many.

    Args:
        rungs: summaries by benchmark and name.
        data: of the study.
        theme: colours.
    """
    colours = dict(zip((*data["learners"], data["counting"]), theme.lines, strict=False))
    few, many = min(data["train_sizes"]), max(data["train_sizes"])

    def paint(axes: Axes) -> None:
        for number, own in enumerate(rungs.values()):
            for cell, colour in (((own.best, 0), theme.muted), ((data["planner"], 0), theme.lines[2])):
                axes.plot([own.means[cell].value] * 2, [number - 0.36, number + 0.36], color=colour, linewidth=2.4)
            for place, (agent, colour) in enumerate(colours.items()):
                means = own.means | {cell: learner.efficiency for cell, learner in own.learners.items()}
                known = {size: means[agent, size].value for size in (few, many) if (agent, size) in means}
                _draw_sizes(axes, known, many, number + 0.3 * place - 0.15 * (len(colours) - 1), colour)
        axes.set(xlabel="efficiency in unseen rooms", xlim=(0, 1.03), ylim=(len(rungs) - 0.4, -0.6))
        axes.set_yticks(range(len(rungs)), [name.partition("/")[2].replace("-", " ") for name in rungs])
        write_key(axes, [(find_title(agent), colour) for agent, colour in colours.items()]
                  + [("best search baseline", theme.muted), ("Bayes planner", theme.lines[2])])

    return make_figure(theme, paint, height=1.6 + 0.34 * len(rungs), grid="x")


def _draw_sizes(axes: Axes, values: Mapping[int, float], many: int, height: float, colour: str) -> None:
    """Draw the values of an agent by number of training rooms: a disc for `many`, a ring for fewer."""
    axes.plot([*values.values()], [height] * len(values), color=colour, linewidth=1.6)
    for size, value in values.items():
        axes.plot(value, height, "o", color=colour, markersize=5, markerfacecolor=colour if size == many else "none")
