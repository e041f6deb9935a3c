"""Learning from cues across rooms: a learner with memory, search baselines and the Bayes planner."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import stats  # pyright: ignore[reportMissingTypeStubs]

from hrl_escape.errors import ComparisonError
from hrl_escape.names import count_nouns
from studies.figures import Theme, make_figure, write_label
from studies.statistics import Mean, compute_mean
from studies.store import Line
from studies.study import Findings, Study
from studies.tables import format_interval, make_table

__all__ = ["LINES", "Kind", "MarksRun", "analyse", "gather"]

FEW = 16
"""Training rooms that are compared with the most."""


@dataclasses.dataclass(frozen=True)
class MarksRun(Line):
    """A run, tested in unseen rooms.

    Attributes:
        agent: name with traits.
        rung: rung of training and test, with its benchmark: `marks-1/told`.
        rooms: number of training rooms; 0 for who does not learn.
        seed: of training.
        primitives: training budget.
        tested: number of unseen rooms, an episode each.
        efficiency: mean over these.
        escapes: share of episodes that escaped.
    """

    agent: str
    rung: str
    rooms: int
    seed: int
    primitives: int
    tested: int
    efficiency: float
    escapes: float

    PLACE = ("agent", "rung", "rooms", "seed")


LINES = (MarksRun,)


class Kind(NamedTuple):
    """Efficiencies with one kind of cue.

    Attributes:
        rung: set of the rooms, with its benchmark.
        told: with true cues, by number of training rooms.
        control: with cues that say nothing.
        searcher: the best search baseline in the same rooms.
        control_searcher: likewise with cues that say nothing.
        ceiling: the Bayes planner, which is given what cues mean.
        rise: from 16 to 1,000 training rooms, by pairs of seeds.
        worth: true cues less those that say nothing.
        less: with the smaller budget, if it was run.
    """

    rung: str
    told: Mapping[int, Mean]
    control: Mean
    searcher: float
    control_searcher: float
    ceiling: float
    rise: Mean
    worth: Mean
    less: Mean | None

    @property
    def most(self) -> Mean:
        """Efficiency after the most training rooms."""
        return self.told[max(self.told)]

    @property
    def share(self) -> float:
        """Share of the way from the search baseline to the Bayes planner after the most training rooms."""
        return (self.most.mean - self.searcher) / (self.ceiling - self.searcher)


def summarise(values: NDArray[np.float64]) -> Mean:
    """Mean over training seeds, which says nothing of other rooms; no narrower than one test episode in a thousand."""
    return compute_mean(values, least_error=1e-3)


def gather(study: Study, lines: Sequence[MarksRun]) -> dict[str, Kind]:
    """Kinds of cues by the set of their rooms.

    Raises:
        ComparisonError: runs are missing.
    """
    data = study.data

    def pick(agents: Sequence[str], rung: str, rooms: int) -> NDArray[np.float64]:
        found = np.array([line.efficiency for line in sorted(lines, key=lambda line: line.seed)
                          if line.agent in agents and line.rung == rung and line.rooms == rooms])
        if not len(found):
            raise ComparisonError(f"{rung} has no run of {' or '.join(agents)} with {rooms} training rooms")
        return found

    kinds = {}
    for kind in data["kind"]:
        told = {size: pick([kind["learner"]], kind["told"], size) for size in kind["sizes"]}
        most = max(told)
        control = pick([kind["learner"]], kind["control"], most)
        searched, shuffled = (float(pick(data["searchers"], kind[rung], 0).max()) for rung in ("told", "control"))
        worth = stats.ttest_ind(told[most], control, equal_var=False).confidence_interval()
        less = pick([kind["less"]["learner"]], kind["told"], most) if "less" in kind else None
        kinds[kind["told"]] = Kind(
            kind["told"], {size: summarise(values) for size, values in told.items()}, summarise(control), searched,
            shuffled, float(pick([data["ceiling"]], kind["told"], 0)[0]), summarise(told[most] - told[FEW]),
            Mean(float(told[most].mean() - control.mean()), float(worth.low), float(worth.high)),
            None if less is None else summarise(less))
    return kinds


def analyse(study: Study, lines: Sequence[MarksRun]) -> Findings:
    """Efficiency in unseen rooms with each kind of cue, after few and many training rooms."""
    kinds, data = gather(study, lines), study.data
    titles = {kind["told"]: kind["title"] for kind in data["kind"]}
    sizes = sorted({size for kind in kinds.values() for size in kind.told})
    rows = [[titles[rung], *(_format(kind.told.get(size)) for size in sizes), _format(kind.less),
             f"{kind.searcher:.2f}", f"{kind.ceiling:.2f}", f"{kind.share:.0%}"] for rung, kind in kinds.items()]
    controls = [[titles[rung], _format(kind.control), f"{kind.control_searcher:.2f}",
                 format_interval(kind.worth, "+.2f"), format_interval(kind.rise, "+.2f")]
                for rung, kind in kinds.items()]
    return Findings(SimpleNamespace(kinds=kinds, shares=[kind.share for kind in kinds.values()], data=data), {
        "cues": make_table(["kind of cue", *(f"{count_nouns(size, 'training room')}" for size in sizes),
                            "1,000, smaller budget", "search baseline", "Bayes planner", "normalised score"], rows),
        "cue_controls": make_table(["kind of cue", "control", "search baseline in the control",
                                    "true less control", "1,000 rooms less 16"], controls),
    }, {"marks": lambda theme: draw(kinds, titles, theme)})


def _format(cell: Mean | None) -> str:
    return "" if cell is None else format_interval(cell, ".2f")


def draw(kinds: Mapping[str, Kind], titles: Mapping[str, str], theme: Theme) -> Figure:
    """Draw a row a kind: after few and many training rooms, with the search baseline and the Bayes planner."""

    def draw_axes(axes: Axes) -> None:
        for number, kind in enumerate(kinds.values()):
            few, most = kind.told[FEW], kind.most
            axes.plot([few.mean, most.mean], [number] * 2, color=theme.lines[1], linewidth=2)
            axes.plot(few.mean, number, "o", color=theme.lines[1], markersize=7, markerfacecolor="none")
            axes.plot(most.mean, number, "o", color=theme.lines[1], markersize=7)
            for value, colour in ((kind.searcher, theme.muted), (kind.ceiling, theme.lines[2])):
                axes.plot([value] * 2, [number - 0.32, number + 0.32], color=colour, linewidth=2.4)
        first = next(iter(kinds.values()))
        write_label(axes, first.searcher, -0.62, "search", theme.muted, ha="center")
        write_label(axes, first.ceiling, -0.62, "Bayes", theme.lines[2], ha="center")
        last = [*kinds.values()][-1]
        row = len(kinds) - 0.45
        write_label(axes, last.told[FEW].mean, row, "16 rooms", theme.lines[1], ha="center")
        write_label(axes, last.most.mean, row, "1,000 rooms", theme.lines[1], ha="center")
        axes.set(xlabel="efficiency in unseen rooms", xlim=(0.25, 1.03), ylim=(row + 0.35, -1))
        axes.set_yticks(range(len(kinds)), [titles[rung] for rung in kinds])

    return make_figure(theme, draw_axes, height=3.9, grid="x")
