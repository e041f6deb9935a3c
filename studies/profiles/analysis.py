"""Profiles of learners: who leads on which axis, where searching is beaten, and whether the axes grow harder."""

from __future__ import annotations

import dataclasses
import itertools
import warnings
from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeAlias

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import stats  # pyright: ignore[reportMissingTypeStubs]

from hrl_escape.comparison.inference import ALPHA, compare_pairs, correct_by_holm
from hrl_escape.comparison.reporting.figures import draw_radar, list_references, make_profiles
from hrl_escape.comparison.statistics import LEAST_RUNS
from hrl_escape.env.drawing import palette
from hrl_escape.errors import ComparisonError, UnknownNameError
from hrl_escape.ladder.benchmark import load_benchmark
from hrl_escape.ladder.manifest import AxisRecord, load_references
from hrl_escape.names import join_words
from studies.baseline import BaselineRun
from studies.figures import FIGURE_STYLE
from studies.ladder.baselines import BaselineArgs, collect_lines, list_missing, run_baselines
from studies.page import make_table
from studies.store import Store
from studies.study import Page, Study

__all__ = ["Args", "Cells", "Gain", "analyse", "compare_everyone", "measure", "tell_falls", "tell_leads",
           "tell_searching", "tell_tops"]

Cells: TypeAlias = Mapping[tuple[str, str], NDArray[np.float64]]
"""(agent, rung) -> efficiency (rooms,), in the order of the rooms."""
EASY = 0.9
"""Efficiency from which on a rung asks nothing more of a learner."""


@dataclasses.dataclass(frozen=True)
class Args(BaselineArgs):
    """Options of the study."""

    axes: tuple[str, ...] = ()
    """Axes to run; all by default."""
    runs: int = 1
    """Training seeds in each room."""


def measure(study: Study, args: Args, store: Store) -> None:
    """Run what is missing, agent by agent, and keep the lines."""
    bench, data = load_benchmark(study.data["benchmark"]), study.data
    known = {axis.name: axis.rungs for axis in bench.manifest.axes}
    if unknown := [name for name in args.axes if name not in known]:
        raise UnknownNameError(f"axis of {bench.name}", unknown[0], known)
    rungs = tuple(itertools.chain.from_iterable(known[name] for name in args.axes or known))
    chosen = dataclasses.replace(
        args, rung=args.rung or rungs, protocol=("per-instance",),
        agents=args.agents or (*data["searchers"], *data["agents"]), primitives=args.primitives or data["primitives"],
        eval_episodes=data["eval_episodes"])
    found = run_baselines(bench, chosen)
    store.add(collect_lines(found))
    print(f"{list_missing(found)} runs are left for another time")


# --- comparisons -----------------------------------------------------------------------------


class Gain(NamedTuple):
    """Mean gain in efficiency of one agent over another on an axis, rungs as strata and rooms as pairs.

    Attributes:
        value: mean over the rungs of the mean difference.
        p: two-sided, corrected over the whole study (Holm).
    """

    value: float
    p: float

    @property
    def is_shown(self) -> bool:
        """True if the first agent is shown to be more efficient than the second."""
        return self.p < ALPHA and self.value > 0


def compare_everyone(cells: Cells, axes: Sequence[AxisRecord], learners: Sequence[str], searcher: str
                     ) -> dict[tuple[str, str, str], Gain]:
    """Gains of each learner over the other learners and over the searcher, axis by axis: one family of tests.

    Args:
        cells: efficiencies.
        axes: those to compare on.
        learners: names.
        searcher: agent whose efficiency on each rung is that of the best searcher there.

    Returns:
        (axis, first agent, second agent) -> gain, both ways round between learners.
    """
    couples = [(axis, *pair) for axis in axes for pair in (*itertools.combinations(learners, 2),
                                                            *((learner, searcher) for learner in learners))]
    tests = [compare_pairs([cells[first, rung] - cells[second, rung] for rung in axis.rungs])
             for axis, first, second in couples]
    found = {}
    for (axis, first, second), test, p in zip(couples, tests, correct_by_holm([test.p for test in tests]), strict=True):
        found[axis.name, first, second] = Gain(test.difference, p)
        found[axis.name, second, first] = Gain(-test.difference, p)
    return found


def find_leader(gains: Mapping[tuple[str, str, str], Gain], axis: str, learners: Sequence[str]) -> str | None:
    """The learner that is shown to be more efficient than every other on an axis; None if there is none."""
    return next((first for first in learners if all(gains[axis, first, other].is_shown for other in learners
                                                    if other != first)), None)


# --- sentences -------------------------------------------------------------------------------


def tell_leads(gains: Mapping[tuple[str, str, str], Gain], axes: Sequence[str], names: Mapping[str, str]) -> str:
    """The finding: whose profiles cross, or who is at least level everywhere.

    Args:
        gains: see `compare_everyone`.
        axes: names.
        names: learner -> what it is.
    """
    def list_wins(first: str, second: str) -> list[str]:
        return [axis for axis in axes if first != second and gains[axis, first, second].is_shown]

    crossing = [pair for pair in itertools.combinations(names, 2) if list_wins(*pair) and list_wins(*pair[::-1])]
    leads = {learner: [axis for axis in axes if find_leader(gains, axis, list(names)) == learner] for learner in names}
    told = [f"{names[learner]} leads on {join_words(own)}" for learner, own in leads.items() if own]
    if crossing:
        first, second = crossing[0]
        opening = (f"Profiles cross: {names[first]} beats {names[second]} on {join_words(list_wins(first, second))}, "
                   f"and is beaten on {join_words(list_wins(second, first))}")
        return f"{opening}; {'; '.join(told)}." if told else f"{opening}; nobody leads on any axis."
    best = next((learner for learner in names if any(list_wins(learner, other) for other in names)
                 and not any(list_wins(other, learner) for other in names)), None)
    if best is None:
        return "No two of these learners are told apart on any axis."
    return (f"One order holds on all axes: nobody is shown to beat {names[best]} on any"
            f"{f', and it leads on {join_words(leads[best])}' if leads[best] else ''}.")


def tell_searching(gains: Mapping[tuple[str, str, str], Gain], axes: Sequence[str], names: Mapping[str, str],
                   searcher: str) -> str:
    """A sentence: the axes on which a learner is shown to beat the best searcher, and those on which all lose to it."""
    won = [axis for axis in axes if any(gains[axis, learner, searcher].is_shown for learner in names)]
    lost = [axis for axis in axes if all(gains[axis, searcher, learner].is_shown for learner in names)]
    told = f"On {join_words(won)} some learner beats the best searcher, which starts anew in each episode" if won else (
        "On no axis is a learner shown to beat the best searcher, which starts anew in each episode")
    return f"{told}{f'; on {join_words(lost)} all learners are below it' if lost else ''}."


def tell_falls(cells: Cells, axes: Sequence[AxisRecord], names: Mapping[str, str]) -> str:
    """A sentence: the axes on which each learner falls, from the first rung to the last and never up."""
    falls = {learner: [axis.name for axis in axes if _falls([cells[learner, rung] for rung in axis.rungs])]
             for learner in names}
    told = [f"{names[learner]} falls on {join_words(own)}" for learner, own in falls.items() if own]
    if not told:
        return "No learner is shown to fall as rungs grow harder, on any axis."
    none = [axis.name for axis in axes if not any(axis.name in own for own in falls.values())]
    return f"As rungs grow harder {'; '.join(told)}{f'; none does on {join_words(none)}' if none else ''}."


def _falls(levels: Sequence[NDArray[np.float64]]) -> bool:
    """Return whether efficiency is shown to fall from the first rung to the last, and is nowhere shown to rise.

    Rungs have rooms of their own, so these are Welch's tests; rises share Bonferroni's level.
    """
    rises = [_shift(before, after, len(levels) - 1)[0] > 0 for before, after in itertools.pairwise(levels)]
    return _shift(levels[0], levels[-1], 1)[1] < 0 and not any(rises)


def _shift(before: NDArray[np.float64], after: NDArray[np.float64], tests: int) -> tuple[float, float]:
    """Interval of the difference of two means of independent rooms."""
    if not (np.ptp(before) or np.ptp(after)):
        return float(after[0] - before[0]), float(after[0] - before[0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # rooms of one of both may all be equal
        found = stats.ttest_ind(after, before, equal_var=False).confidence_interval(1 - ALPHA / tests)
    return float(found.low), float(found.high)


def tell_tops(cells: Cells, axes: Sequence[AxisRecord], learners: Sequence[str]) -> str:
    """A sentence: the axes whose hardest rung some learner has all but solved."""
    solved = [axis.name for axis in axes
              if max(cells[learner, axis.rungs[-1]].mean() for learner in learners) >= EASY]
    if not solved:
        return f"No axis is used up: on every top rung all learners stay below an efficiency of {EASY:g}."
    return f"The top rung of {join_words(solved)} is all but solved: the best learner has {EASY:g} or more there."


# --- page ------------------------------------------------------------------------------------


def analyse(study: Study, lines: Sequence[BaselineRun]) -> Page:
    """Sentences, tables and figures.

    Raises:
        ComparisonError: no axis has all agents in enough rooms on each rung.
    """
    data, bench = study.data, load_benchmark(study.data["benchmark"])
    names, searchers = data["agents"], data["searchers"]
    cells = collect_cells(lines)
    everyone = (*names, *searchers)
    axes = [axis for axis in bench.manifest.axes if all(len(cells.get((agent, rung), ())) >= LEAST_RUNS
                                                        for agent in everyone for rung in axis.rungs)]
    if not axes:
        raise ComparisonError(f"no axis of {bench.name} has every agent in {LEAST_RUNS} rooms of each rung")
    rungs = [rung for axis in axes for rung in axis.rungs]
    searcher = "best searcher"
    best = {rung: max((cells[agent, rung] for agent in searchers), key=np.mean) for rung in rungs}
    cells |= {(searcher, rung): values for rung, values in best.items()}
    gains, order = compare_everyone(cells, axes, list(names), searcher), [axis.name for axis in axes]
    efficiencies = {name: {rung: float(cells[agent, rung].mean()) for rung in rungs} for agent, name in names.items()}
    efficiencies[searcher] = {rung: float(values.mean()) for rung, values in best.items()}
    efficiencies["smdp-bayes"] = list_references(load_references(bench.name)).get("smdp-bayes", {})
    profiles = make_profiles(axes, efficiencies)
    headline = tell_leads(gains, order, names)
    sentences = [tell_searching(gains, order, names, searcher), tell_falls(cells, axes, names),
                 tell_tops(cells, axes, list(names))]
    table = make_table(["axis", *efficiencies], [[axis.name, *(str(profile.get(axis.name, "-")) for profile in
                                                               profiles.values())] for axis in axes])
    return Page({"headline": headline, "sentences": sentences, "table": table, "left": [
        axis.name for axis in bench.manifest.axes if axis not in axes], "rooms": min(map(len, cells.values())), **data},
        {"profiles": draw_radar({name: own for name, own in profiles.items() if len(own) == len(axes)}, axes),
         "profiles-axes": draw_axes(cells, axes, names, searcher)},
        [headline, *sentences])


def collect_cells(lines: Sequence[BaselineRun]) -> dict[tuple[str, str], NDArray[np.float64]]:
    """Efficiency of each agent on each rung, room by room, means over training seeds."""
    found: dict[tuple[str, str], dict[str, list[float]]] = {}
    for line in lines:
        found.setdefault((line.agent, line.rung), {}).setdefault(line.rooms, []).append(line.efficiency)
    return {place: np.array([np.mean(rooms[room]) for room in sorted(rooms)]) for place, rooms in found.items()}


def draw_axes(cells: Cells, axes: Sequence[AxisRecord], names: Mapping[str, str], searcher: str) -> Figure:
    """Efficiency rung by rung, a panel an axis."""
    columns = 4
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(9.2, 2.1 * -(-len(axes) // columns)), facecolor=palette.BACKGROUND,
                        layout="constrained")
        panels = figure.subplots(-(-len(axes) // columns), columns, sharey=True, squeeze=False).ravel()
        for panel, axis in zip(panels, axes, strict=False):
            numbers = range(1, len(axis.rungs) + 1)
            for agent, colour in zip((*names, searcher), (*palette.LINES[:len(names)], palette.INK), strict=True):
                panel.plot(numbers, [cells[agent, rung].mean() for rung in axis.rungs], "o-", markersize=3.5,
                           linewidth=1.4, color=colour, label=names.get(agent, agent))
            panel.set(ylim=(-0.03, 1.03), xticks=numbers)
            panel.set_title(axis.name, fontsize=9, color=palette.INK)
            panel.grid(axis="y", color="#e5dfd2", linewidth=0.8)
            panel.tick_params(colors=palette.MUTED, labelcolor=palette.INK, labelsize=7)
            panel.spines[["top", "right"]].set_visible(False)
        for panel in panels[len(axes):]:
            panel.set_axis_off()
        figure.legend(*panels[0].get_legend_handles_labels(), loc="lower right", frameon=False)
        figure.supylabel("efficiency", color=palette.INK, fontsize=9)
    return figure
