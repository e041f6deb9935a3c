"""Profiles of learners: who leads on which axis, where searching is beaten, and whether the axes grow harder."""

from __future__ import annotations

import collections
import dataclasses
import itertools
import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import stats  # pyright: ignore[reportMissingTypeStubs]

from hrl_escape.benchmark.inference import ALPHA, compare_pairs, correct_by_holm
from hrl_escape.benchmark.reporting.figures import draw_radar, list_references, make_profiles
from hrl_escape.benchmark.rung_references import load_references
from hrl_escape.benchmark.statistics import LEAST_RUNS
from hrl_escape.benchmark.verdict import count_things, spell_number
from hrl_escape.env.pictures import palette
from hrl_escape.errors import ComparisonError, UnknownNameError
from hrl_escape.names import join_words
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.sets.manifest import AxisRecord
from studies.baseline import BaselineRun
from studies.figures import FIGURE_STYLE
from studies.ladder.baselines import BaselineArgs, collect_lines, list_missing, run_baselines
from studies.page import make_table
from studies.store import Store
from studies.study import Page, Study

__all__ = ["Args", "Cells", "Gain", "analyse", "compare_everyone", "find_falls", "measure", "tell_falls",
           "tell_leads", "tell_others", "tell_searching", "tell_tops", "tell_upper"]

Cells: TypeAlias = Mapping[tuple[str, str], NDArray[np.float64]]
"""(agent, rung) -> efficiency (rooms,), in the order of the rooms."""
EASY = 0.9
"""Efficiency from which on a rung asks nothing more of a learner."""
SEARCHED = 0.5
"""Efficiency below which searching alone is no answer."""
LEAST_FALLING = 3
"""Learners that have to fall on an axis before its order of rungs is theirs and not one learner's weakness."""


@dataclasses.dataclass(frozen=True)
class Args(BaselineArgs):
    """Options of the study."""

    axes: tuple[str, ...] = ()
    """Axes to run; all by default."""
    runs: int = 1
    """Training seeds in each room."""


def measure(study: Study, args: Args, store: Store) -> None:
    """Run what is missing, agent by agent, and keep the lines; each group of others runs on its own axes."""
    bench, data = load_benchmark(study.data["benchmark"]), study.data
    known = {axis.name: axis.rungs for axis in bench.manifest.axes}
    if unknown := [name for name in args.axes if name not in known]:
        raise UnknownNameError(f"axis of {bench.name}", unknown[0], known)
    groups = [(tuple(known), (*data["searchers"], *data["agents"])),
              *((other["axes"], tuple(other["agents"])) for other in data["others"])]
    everyone = [agent for _, agents in groups for agent in agents]
    if unknown := [name for name in args.agents if name not in everyone]:
        raise UnknownNameError("agent of this study", unknown[0], everyone)
    left = 0
    for axes, agents in groups:
        agents = tuple(agent for agent in agents if agent in (args.agents or agents))
        rungs = tuple(rung for axis in axes if axis in (args.axes or known) for rung in known[axis]
                      if rung in (args.rung or known[axis]))
        if agents and rungs:
            found = run_baselines(bench, dataclasses.replace(
                args, rung=rungs, protocol=("per-instance",), agents=agents,
                primitives=args.primitives or data["primitives"], eval_episodes=data["eval_episodes"]))
            store.add(collect_lines(found))
            left += list_missing(found)
    print(f"{left} runs are left for another time")


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
        searcher: agent whose efficiency on each rung is that of the best search baseline there.

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
    """A sentence: axes on which a learner is shown to beat the best search baseline, and those on which all lose."""
    won = [axis for axis in axes if any(gains[axis, learner, searcher].is_shown for learner in names)]
    lost = [axis for axis in axes if all(gains[axis, searcher, learner].is_shown for learner in names)]
    told = f"On {join_words(won)} some learner beats the best search baseline, which starts anew in each episode" if (
        won) else ("On no axis is a learner shown to beat the best search baseline, which starts anew in each episode")
    return f"{told}{f'; on {join_words(lost)} all learners are below it' if lost else ''}."


def find_falls(cells: Cells, axes: Sequence[AxisRecord], learners: Iterable[str]) -> set[tuple[str, str]]:
    """(learner, axis) where efficiency is shown to fall over the rungs, and is nowhere shown to rise.

    A fall is a rank correlation of rung and efficiency (Kendall's tau, as in the trend test of Jonckheere) below 0, one
    family of tests over all learners and axes (Holm). Rises are Welch's tests from each rung to the next; those of a
    learner on an axis share Bonferroni's level.
    """
    levels = {(learner, axis.name): [cells[learner, rung] for rung in axis.rungs]
              for learner, axis in itertools.product(learners, axes) if (learner, axis.rungs[0]) in cells}
    p = correct_by_holm([_test_fall(own) for own in levels.values()])
    return {place for (place, own), each in zip(levels.items(), p, strict=True) if each < ALPHA
            and not any(_shift(before, after, len(own) - 1)[0] > 0 for before, after in itertools.pairwise(own))}


def _test_fall(levels: Sequence[NDArray[np.float64]]) -> float:
    """One-sided p-value of a fall over levels; 1 where all efficiencies are equal."""
    rungs, values = np.repeat(np.arange(len(levels)), list(map(len, levels))), np.concatenate(levels)
    found: Any = stats.kendalltau(rungs, values, alternative="less")
    return float(found.pvalue) if np.ptp(values) else 1.0


def tell_falls(falls: Iterable[tuple[str, str]], axes: Sequence[AxisRecord]) -> str:
    """A sentence: the axes on which several learners fall, and others."""
    counts = collections.Counter(axis for _, axis in falls)
    several, few, none = ([axis.name for axis in axes if low <= counts[axis.name] <= high]
                          for low, high in ((LEAST_FALLING, math.inf), (1, LEAST_FALLING - 1), (0, 0)))
    if len(none) == len(axes):
        return "No learner is shown to fall as rungs grow harder, on any axis."
    some = f"{join_words(map(spell_number, range(1, LEAST_FALLING)), 'or')} learner{'s' * (LEAST_FALLING > 2)}"
    told = [f"{who} fall{'s' * (most == 1)} on {join_words(own)}" for who, most, own in (
        (f"{count_things(LEAST_FALLING, 'learner')} or more", LEAST_FALLING, several),
        (some, LEAST_FALLING - 1, few)) if own]
    return f"As rungs grow harder {'; '.join(told)}{f'; none does on {join_words(none)}' if none else ''}."


def tell_others(cells: Cells, axes: Sequence[AxisRecord], learners: Iterable[str], others: Iterable[str], words: str
                ) -> str:
    """A sentence: the axes on which each learner of another kind is shown to be below each of planned options alone.

    Args:
        cells: efficiencies.
        axes: those on which the others ran.
        learners: names of those that choose among planned options.
        others: names of the others.
        words: what the others choose among, "of single moves".
    """
    pairs = [(axis.name, compare_pairs([cells[learner, rung] - cells[other, rung] for rung in axis.rungs]))
             for axis in axes for learner, other in itertools.product(learners, others)]
    level = {axis for (axis, test), p in zip(pairs, correct_by_holm([test.p for _, test in pairs]), strict=True)
             if p >= ALPHA or test.difference < 0}
    below, rest = ([axis.name for axis in axes if (axis.name in level) == is_level] for is_level in (False, True))
    if not below:
        return f"On {join_words(rest)} some learner {words} keeps up with some of planned options alone."
    told = f"On {join_words(below)} every learner {words} is below every one of planned options alone"
    return f"{told}{f'; on {join_words(rest)} some keep up' if rest else ''}."


def _shift(before: NDArray[np.float64], after: NDArray[np.float64], tests: int) -> tuple[float, float]:
    """Interval of the difference of two means of independent rooms."""
    if not (np.ptp(before) or np.ptp(after)):
        return float(after[0] - before[0]), float(after[0] - before[0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # rooms of one of both may all be equal
        found = stats.ttest_ind(after, before, equal_var=False).confidence_interval(1 - ALPHA / tests)
    return float(found.low), float(found.high)


def tell_upper(cells: Cells, axes: Sequence[AxisRecord], searcher: str) -> str:
    """A sentence: the axes on which the best search baseline is below `SEARCHED` on every rung of the upper half.

    Of three rungs the middle one belongs to it.
    """
    hard = [axis.name for axis in axes
            if all(cells[searcher, rung].mean() < SEARCHED for rung in axis.rungs[len(axis.rungs) // 2:])]
    rest = [axis.name for axis in axes if axis.name not in hard]
    if not hard:
        return f"On no axis does the best search baseline stay below {SEARCHED:g} on the upper half of the rungs."
    told = f"On the upper half of {join_words(hard)} the best search baseline stays below {SEARCHED:g}"
    return f"{told}{f'; on that of {join_words(rest)} it does not' if rest else ''}."


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

    def list_agents(axis: str) -> list[str]:
        return [*names, *searchers, *(agent for other in data["others"] if axis in other["axes"]
                                      for agent in other["agents"])]

    axes = [axis for axis in bench.manifest.axes if all(len(cells.get((agent, rung), ())) >= LEAST_RUNS
                                                        for rung in axis.rungs for agent in list_agents(axis.name))]
    if not axes:
        raise ComparisonError(f"no axis of {bench.name} has every agent in {LEAST_RUNS} rooms of each rung")
    others = [(other, own) for other in data["others"]
              if (own := [axis for axis in axes if axis.name in other["axes"]])]
    everyone: dict[str, str] = names | {agent: name for other, _ in others for agent, name in other["agents"].items()}
    rungs = [rung for axis in axes for rung in axis.rungs]
    searcher = "best search baseline"
    best = {rung: max((cells[agent, rung] for agent in searchers), key=np.mean) for rung in rungs}
    cells |= {(searcher, rung): values for rung, values in best.items()}
    gains, order = compare_everyone(cells, axes, list(names), searcher), [axis.name for axis in axes]
    efficiencies = {name: {rung: float(cells[agent, rung].mean()) for rung in rungs if (agent, rung) in cells}
                    for agent, name in everyone.items()}
    efficiencies[searcher] = {rung: float(values.mean()) for rung, values in best.items()}
    efficiencies["Bayes planner"] = list_references(load_references(bench.name)).get("Bayes planner", {})
    profiles, falls = make_profiles(axes, efficiencies), find_falls(cells, axes, everyone)
    headline = tell_leads(gains, order, names)
    sentences = [tell_searching(gains, order, names, searcher), tell_falls(falls, axes),
                 *(tell_others(cells, own, names, other["agents"], other["words"]) for other, own in others),
                 tell_upper(cells, axes, searcher), tell_tops(cells, axes, list(names))]
    marks = {(everyone[agent], axis): " ↓" for agent, axis in falls}
    columns = [([*names.values(), searcher, "Bayes planner"], axes),
               *((list(other["agents"].values()), own) for other, own in others)]
    tables = [make_table(["axis", *shown], [[axis.name, *(
        f"{profiles[name].get(axis.name, '-')}{marks.get((name, axis.name), '')}" for name in shown)] for axis in rows])
        for shown, rows in columns]
    return Page({"headline": headline, "sentences": sentences, "tables": tables, "everyone": everyone, "left": [
        axis.name for axis in bench.manifest.axes if axis not in axes], "rooms": min(map(len, cells.values())), **data},
        {"profiles": draw_radar({name: profiles[name] for name in [*names.values(), searcher]}, axes),
         "profiles-axes": draw_axes(cells, axes, names, [other["agents"] for other, _ in others], searcher)},
        [headline, *sentences])


def collect_cells(lines: Sequence[BaselineRun]) -> dict[tuple[str, str], NDArray[np.float64]]:
    """Efficiency of each agent on each rung, room by room, means over training seeds."""
    found: dict[tuple[str, str], dict[str, list[float]]] = {}
    for line in lines:
        found.setdefault((line.agent, line.rung), {}).setdefault(line.rooms, []).append(line.efficiency)
    return {place: np.array([np.mean(rooms[room]) for room in sorted(rooms)]) for place, rooms in found.items()}


def draw_axes(cells: Cells, axes: Sequence[AxisRecord], names: Mapping[str, str],
              others: Sequence[Mapping[str, str]], searcher: str) -> Figure:
    """Efficiency rung by rung, a panel an axis; "a table of moves" has the colour of "a table", in another style."""
    colours = dict(zip(names.values(), palette.LINES, strict=False))
    looks = {agent: (name, colours[next(known for known in colours if name.startswith(known))], style)
             for group, style in zip((names, *others), ("o-", "o--", "o:"), strict=False)
             for agent, name in group.items()}
    looks[searcher] = searcher, palette.INK, "o-"
    columns = 4
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(9.2, 2.1 * -(-len(axes) // columns)), facecolor=palette.BACKGROUND,
                        layout="constrained")
        panels = figure.subplots(-(-len(axes) // columns), columns, sharey=True, squeeze=False).ravel()
        for panel, axis in zip(panels, axes, strict=False):
            numbers = range(1, len(axis.rungs) + 1)
            for agent, (label, colour, style) in looks.items():
                if (agent, axis.rungs[0]) in cells:
                    panel.plot(numbers, [cells[agent, rung].mean() for rung in axis.rungs], style, markersize=3.5,
                               linewidth=1.4, color=colour, label=label)
            panel.set(ylim=(-0.03, 1.03), xticks=numbers)
            panel.set_title(axis.name, fontsize=9, color=palette.INK)
            panel.grid(axis="y", color="#e5dfd2", linewidth=0.8)
            panel.tick_params(colors=palette.MUTED, labelcolor=palette.INK, labelsize=7)
            panel.spines[["top", "right"]].set_visible(False)
        for panel in panels[len(axes):]:
            panel.set_axis_off()
        keys = {label: line for panel in panels[:len(axes)] for line, label in zip(*panel.get_legend_handles_labels(),
                                                                                   strict=True)}
        figure.legend(keys.values(), keys.keys(), loc="lower right", frameon=False, fontsize=8)
        figure.supylabel("efficiency", color=palette.INK, fontsize=9)
        figure.supxlabel("rung of the axis", color=palette.INK, fontsize=9)
    return figure
