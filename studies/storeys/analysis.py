"""Room sequences: what one room teaches for the next, where all rooms of a sequence share one order of symbols."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from types import SimpleNamespace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hrl_escape.errors import ComparisonError
from studies.figures import Theme, make_figure, write_label
from studies.statistics import Mean, compute_mean
from studies.store import Line
from studies.study import Findings, Study
from studies.tables import format_interval, make_table

__all__ = ["LINES", "FloorRun", "analyse"]


@dataclasses.dataclass(frozen=True)
class FloorRun(Line):
    """Episodes of one agent in one room of the sequences.

    Attributes:
        agent: name with traits.
        repeats: False where it forgets the rooms before.
        floor: number of the room, from 1.
        efficiencies: in each sequence.
    """

    agent: str
    repeats: bool
    floor: int
    efficiencies: tuple[float, ...]

    PLACE = ("agent", "repeats", "floor")


LINES = (FloorRun,)


def analyse(study: Study, lines: Sequence[FloorRun]) -> Findings:
    """Efficiency in each room of the sequences, and the gain from the first to the last.

    Raises:
        ComparisonError: an agent was not played in every room.
    """
    data, found = study.data, {}
    for name, agent, repeats in (("Bayes planner, remembering", data["ceiling"], True),
                                 ("Bayes planner, forgetting", data["ceiling"], False),
                                 ("search baseline", data["searcher"], True)):
        own = sorted((line for line in lines if (line.agent, line.repeats) == (agent, repeats)), key=lambda o: o.floor)
        if len(own) != data["floors"]:
            raise ComparisonError(f"{agent} was not played in every room of the sequences")
        found[name] = [np.array(line.efficiencies) for line in own]
    cells = {name: [compute_mean(values) for values in own] for name, own in found.items()}
    gains = {name: compute_mean(own[-1] - own[0]) for name, own in found.items()}
    table = make_table(["agent", *(f"room {number}" for number in range(1, data["floors"] + 1)), "last less first"], [
        [name, *(format_interval(cell, ".3f") for cell in own), format_interval(gains[name], "+.3f")]
        for name, own in cells.items()])
    remembering, forgetting, searching = gains.values()
    return Findings(
        SimpleNamespace(remembering=remembering, forgetting=forgetting, searching=searching,
                        count=len(found["search baseline"][0]), data=data),
        {"sequences": table}, {"storeys": lambda theme: draw(cells, theme)})


def draw(cells: Mapping[str, Sequence[Mean]], theme: Theme) -> Figure:
    """Draw the efficiency in each room of the sequences."""

    def draw_axes(axes: Axes) -> None:
        for (name, own), colour, shift in zip(cells.items(), (theme.lines[0], theme.lines[1], theme.muted),
                                              (-0.06, 0.04, -0.06), strict=True):
            places = range(1, len(own) + 1)
            for place, cell in zip(places, own, strict=True):
                axes.plot([place] * 2, [cell.low, cell.high], color=colour, linewidth=1.4, alpha=0.6)
            axes.plot(places, [cell.mean for cell in own], "o-", color=colour, linewidth=2.2, markersize=5)
            write_label(axes, 2.05, own[-1].mean + shift, name, colour)
        axes.set(xlabel="room of the sequence", ylabel="efficiency", ylim=(0.5, 1.02), xlim=(0.85, 3.15))
        axes.set_xticks(range(1, len(next(iter(cells.values()))) + 1))

    return make_figure(theme, draw_axes, height=3.2)
