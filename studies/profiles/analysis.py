"""Profiles of learners: which of them leads on each axis, where they beat searching, and where they fall."""

from __future__ import annotations

import dataclasses
import itertools
import warnings
from collections.abc import Iterable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import stats  # pyright: ignore[reportMissingTypeStubs]

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.inference import ALPHA, compare_pairs, correct_by_holm
from hrl_escape.benchmark.reporting.figures import list_references, make_profiles
from hrl_escape.benchmark.rung_references import load_references
from hrl_escape.benchmark.statistics import LEAST_RUNS
from hrl_escape.errors import ComparisonError, UnknownNameError
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.sets.manifest import AxisRecord
from studies.baseline import BaselineRun
from studies.figures import draw_rows
from studies.ladder.baselines import BaselineArgs, collect_lines, list_missing, run_baselines
from studies.store import Store
from studies.study import Findings, Study
from studies.tables import make_table

__all__ = ["Args", "Cells", "Gain", "analyse", "compare_everyone", "find_below", "find_falls", "find_leader", "measure"]

SEARCH = "best search baseline"
Cells: TypeAlias = Mapping[tuple[str, str], NDArray[np.float64]]
"""(agent, rung) -> efficiency (rooms,), in the order of the rooms."""


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
    groups = [(tuple(known), (*data["search"], *data["agents"])),
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
        """True if the first agent is significantly more efficient than the second."""
        return self.p < ALPHA and self.value > 0


def compare_everyone(cells: Cells, axes: Sequence[AxisRecord], learners: Sequence[str], search: str
                     ) -> dict[tuple[str, str, str], Gain]:
    """Gains of each learner over the others and over the best search baseline, axis by axis: one family of tests.

    Args:
        cells: efficiencies.
        axes: those to compare on.
        learners: names.
        search: name of the best search baseline of each rung in `cells`.

    Returns:
        (axis, first agent, second agent) -> gain, both ways round between learners.
    """
    couples = [(axis, *pair) for axis in axes for pair in (*itertools.combinations(learners, 2),
                                                            *((learner, search) for learner in learners))]
    tests = [compare_pairs([cells[first, rung] - cells[second, rung] for rung in axis.rungs])
             for axis, first, second in couples]
    found = {}
    for (axis, first, second), test, p in zip(couples, tests, correct_by_holm([test.p for test in tests]), strict=True):
        found[axis.name, first, second] = Gain(test.difference, p)
        found[axis.name, second, first] = Gain(-test.difference, p)
    return found


def find_leader(gains: Mapping[tuple[str, str, str], Gain], axis: str, learners: Sequence[str]) -> str | None:
    """The learner that is significantly more efficient than every other on an axis, or None."""
    return next((first for first in learners if all(gains[axis, first, other].is_shown for other in learners
                                                    if other != first)), None)


def find_falls(cells: Cells, axes: Sequence[AxisRecord], learners: Iterable[str]) -> set[tuple[str, str]]:
    """(learner, axis) where efficiency falls significantly over the rungs, and rises significantly nowhere.

    A fall is a rank correlation of rung and efficiency (Kendall's tau, as in the trend test of Jonckheere) below 0, one
    family of tests over all learners and axes (Holm). Rises are Welch's tests from each rung to the next, which
    share Bonferroni's level for a learner on an axis.
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


def _shift(before: NDArray[np.float64], after: NDArray[np.float64], tests: int) -> tuple[float, float]:
    """Interval of the difference of two means of independent rooms."""
    if not (np.ptp(before) or np.ptp(after)):
        return float(after[0] - before[0]), float(after[0] - before[0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # rooms of one of both may all be equal
        found = stats.ttest_ind(after, before, equal_var=False).confidence_interval(1 - ALPHA / tests)
    return float(found.low), float(found.high)


# --- findings --------------------------------------------------------------------------------


def analyse(study: Study, lines: Sequence[BaselineRun]) -> Findings:
    """Leaders and falls by axis, tables and the figure.

    Raises:
        ComparisonError: no axis has all agents in enough rooms on each rung.
    """
    data, bench = study.data, load_benchmark(study.data["benchmark"])
    learners, baselines = list(data["agents"]), data["search"]
    cells = collect_cells(lines)

    def list_agents(axis: str) -> list[str]:
        return [*learners, *baselines, *(agent for other in data["others"] if axis in other["axes"]
                                         for agent in other["agents"])]

    axes = [axis for axis in bench.manifest.axes if all(len(cells.get((agent, rung), ())) >= LEAST_RUNS
                                                        for rung in axis.rungs for agent in list_agents(axis.name))]
    if not axes:
        raise ComparisonError(f"no axis of {bench.name} has every agent in {LEAST_RUNS} rooms of each rung")
    others = [(list(other["agents"]), own) for other in data["others"]
              if (own := [axis for axis in axes if axis.name in other["axes"]])]
    rungs = [rung for axis in axes for rung in axis.rungs]
    cells |= {(SEARCH, rung): max((cells[agent, rung] for agent in baselines), key=np.mean) for rung in rungs}
    gains, order = compare_everyone(cells, axes, learners, SEARCH), [axis.name for axis in axes]
    everyone = [*learners, *(agent for agents, _ in others for agent in agents)]
    means = {agent: {axis.name: float(np.mean([cells[agent, rung].mean() for rung in axis.rungs]))
                     for axis in axes if (agent, axis.rungs[0]) in cells} for agent in [*everyone, SEARCH]}
    falls = find_falls(cells, axes, everyone)
    profiles = make_profiles(axes, {name: {rung: float(cells[agent, rung].mean()) for rung in rungs
                                           if (agent, rung) in cells} for agent in [*everyone, SEARCH]
                                    for name in [name_agent(agent)]}
                             | {"Bayes planner": list_references(load_references(bench.name)).get("Bayes planner", {})})
    marks = {(name_agent(agent), axis): " ↓" for agent, axis in falls}
    columns = [([*map(name_agent, [*learners, SEARCH]), "Bayes planner"], axes),
               *((list(map(name_agent, agents)), own) for agents, own in others)]
    return Findings(SimpleNamespace(
        axes=order, leaders={axis: find_leader(gains, axis, learners) for axis in order}, gains=gains, means=means,
        beyond=[axis for axis in order if any(gains[axis, learner, SEARCH].is_shown for learner in learners)],
        falls={axis: sorted(agent for agent, own in falls if own == axis) for axis in order},
        below=[axis.name for agents, own in others[:1] for axis in own
               if find_below(cells, axis, learners, agents)],
        rooms=min(map(len, cells.values())), budget=data["primitives"]), {
            "profiles": "\n\n".join(make_table(["axis", *shown], [[axis.name, *(
                f"{profiles[name].get(axis.name, '-')}{marks.get((name, axis.name), '')}" for name in shown)]
                for axis in rows]) for shown, rows in columns),
            "profiles_labels": make_table(["agent", "label"], [[name_agent(agent), f"`{agent}`"]
                                                               for agent in [*everyone, *baselines]])},
        {"profiles": lambda theme: draw_rows(
            order, [(name_agent(agent), means[agent]) for agent in [*learners, SEARCH]],
            "mean efficiency over the rungs of an axis", theme, is_joined=False)})


def name_agent(agent: str) -> str:
    """Display name of an agent, or of the best search baseline."""
    return agent if agent == SEARCH else AgentSpec.parse(agent).title


def find_below(cells: Cells, axis: AxisRecord, learners: Iterable[str], others: Iterable[str]) -> bool:
    """Return whether each of the others is significantly below each learner on an axis."""
    tests = [compare_pairs([cells[learner, rung] - cells[other, rung] for rung in axis.rungs])
             for learner, other in itertools.product(learners, others)]
    return all(p < ALPHA and test.difference > 0 for test, p in
               zip(tests, correct_by_holm([test.p for test in tests]), strict=True))


def collect_cells(lines: Sequence[BaselineRun]) -> dict[tuple[str, str], NDArray[np.float64]]:
    """Efficiency of each agent on each rung, room by room, means over training seeds."""
    found: dict[tuple[str, str], dict[str, list[float]]] = {}
    for line in lines:
        found.setdefault((line.agent, line.rung), {}).setdefault(line.rooms, []).append(line.efficiency)
    return {place: np.array([np.mean(rooms[room]) for room in sorted(rooms)]) for place, rooms in found.items()}
