"""From 2 to 20 buttons: who escapes and when, whether the graph is recovered, and what structure learners are given."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.statistics import LEAST_RUNS
from hrl_escape.errors import ComparisonError, ConfigError, UnknownNameError
from studies.figures import Theme, make_figure, mark_counts, write_label
from studies.running import GridArgs
from studies.scaling.results import ScalingRun
from studies.scaling.rounds import (
    AGENTS,
    BAR,
    BAR_AGENT,
    BAR_RUNS,
    FRESH,
    GIVEN,
    GIVEN_TASKS,
    HOLDS,
    RULES,
    SIZES,
    STUDY_PARTS,
    run_scaling,
)
from studies.statistics import Difference, compare_signs, compute_restricted_mean
from studies.store import Store
from studies.study import Findings, Study
from studies.tables import format_interval, make_table

__all__ = ["LINES", "Args", "BarRuns", "FollowedRuns", "analyse", "compare_given", "follow", "measure",
           "summarise_bar"]

LINES = (ScalingRun,)
_KNOWN = (*AGENTS, *(spec.label for spec in GIVEN))


@dataclasses.dataclass(frozen=True)
class Args(GridArgs):
    """Options of the scaling study."""

    first_seed: int = 0
    """Lowest seed of rooms and training; those from 100 on are fresh runs of the bar."""
    runs: int = 2
    """Runs of each agent in each kind of room, each in a room of its own."""
    primitives: int = 20_000
    """Training budget of a run."""
    minutes: float = 40.0
    """Begin no run after so long; an empty field of the table was not run."""
    parts: tuple[str, ...] = STUDY_PARTS
    """Parts to run: bar, `told` (knowledge that the learner is given), agents."""
    agents: tuple[str, ...] = AGENTS
    """Agents of the part agents."""


def measure(study: Study, args: Args, store: Store) -> None:
    """Run the parts that are asked for, as far as the time goes.

    Raises:
        ComparisonError: no run is finished.
        ConfigError: runs that new ones would join had another budget.
    """
    for what, names, known in (("part", args.parts, STUDY_PARTS), ("agent", args.agents, AGENTS)):
        for name in names:
            if name not in known:
                raise UnknownNameError(f"{what} of the scaling study", name, known)
    there: list[ScalingRun] = store.load()
    for run in there:
        if run.budget != args.primitives:
            raise ConfigError("primitives", args.primitives, f"the runs in {store.path}, which new ones join, have "
                              f"{run.budget}. Choose another --docs")
    run_scaling(store, args)
    if not store.load():
        raise ComparisonError(f"no run is finished after {args.minutes:g} minutes: raise --minutes")


class BarRuns(NamedTuple):
    """Runs of factored R-MAX in the rooms of the bar: 10 to 20 buttons modelled and solved within 20,000 primitives.

    Attributes:
        runs: all.
        escaped: within the budget.
        near_best: came near the best known return.
        whole: with every edge that matters and no other at the end.
        median: primitives to the first escape.
    """

    runs: int
    escaped: int
    near_best: int
    whole: int
    median: float


def summarise_bar(runs: Sequence[ScalingRun]) -> BarRuns:
    """Count what runs reach; without a run the median is NaN."""
    ends = [np.inf if run.first_escape is None else run.first_escape for run in runs]
    return BarRuns(len(runs), int(np.isfinite(ends).sum()), sum(run.near_best is not None for run in runs),
                   sum(map(_has_graph, runs)), float(np.median(ends)) if runs else np.nan)


def _has_graph(run: ScalingRun) -> bool:
    """Return whether it ends with every edge that matters, and none too many."""
    return bool(run.structure) and run.structure[-1][1:] == (1.0, 1.0)


def wait_for_graph(run: ScalingRun) -> int:
    """Primitives until it was near the best with the whole graph, which ends a run; the budget if it never was."""
    return min(run.primitives, run.budget) if run.near_best is not None and _has_graph(run) else run.budget


@dataclasses.dataclass(frozen=True)
class FollowedRuns:
    """Times of an event over planned runs, censored at the budget.

    Attributes:
        times: of each run, primitives.
        observed: whether the event came, run by run.
        budget: of a run, primitives.
    """

    times: tuple[int, ...]
    observed: tuple[bool, ...]
    budget: int

    @property
    def restricted_mean(self) -> float:
        """Mean primitives to the event, at most the budget: the area under the Kaplan-Meier curve."""
        return compute_restricted_mean(self.times, self.observed, self.budget)

    @property
    def median(self) -> float | None:
        """Time until the Kaplan-Meier curve falls to one half; None if it does not within the budget."""
        runs = zip(self.times, self.observed, strict=True)
        middle = sorted(time if seen else math.inf for time, seen in runs)[(len(self.times) - 1) // 2]
        return float(middle) if math.isfinite(middle) else None

    def __str__(self) -> str:
        return f"{sum(self.observed)} of {len(self.times)}; {self.restricted_mean:,.0f}"


def compare_given(results: Sequence[ScalingRun]) -> dict[tuple[str, str], Difference]:
    """Compare learners that are given something else with the one that is given what holds, seed by seed.

    Returns:
        By rule and label, the primitives more until the whole graph is found and the return is near the best; all
        comparisons are one family (Holm).
    """
    differences: dict[str, list[float]] = {}
    for task in GIVEN_TASKS:
        waits = {spec.label: {run.run: wait_for_graph(run) for run in results
                              if (run.task, run.agent) == (task, spec.label)} for spec in GIVEN}
        known = waits.pop(HOLDS)
        differences |= {f"{task.rule}/{label}": [float(own[seed] - known[seed])
                                                 for seed in sorted(own.keys() & known.keys())]
                        for label, own in waits.items() if len(own.keys() & known.keys()) >= LEAST_RUNS}
    return {(key.split("/")[0], key.split("/")[1]): found for key, found in compare_signs(differences).items()}


def analyse(study: Study, lines: Sequence[ScalingRun]) -> Findings:
    """First escapes by number of buttons, the rooms of the bar, and what structure learners are given.

    Raises:
        ComparisonError: none of the runs is of an agent of `AGENTS`.
        UnknownNameError: a run is of an agent that the study does not have.
    """
    for name in {run.agent for run in lines} - set(_KNOWN):
        raise UnknownNameError("agent of the scaling study", name, _KNOWN)
    everything, fresh = ([run for run in sorted(lines, key=lambda run: run.place) if (run.run >= FRESH) == is_fresh]
                         for is_fresh in (False, True))
    results = [run for run in everything if run.agent in AGENTS]
    if not results:
        raise ComparisonError("no run of this study's agents is finished: run it with the part agents")
    budget = max(run.budget for run in results)
    escapes = {(rule, agent, size): followed for rule, agent, size in itertools.product(RULES, AGENTS, SIZES)
               if (followed := follow(results, rule, agent, size, budget)) is not None}
    bar = {task: [summarise_bar([run for run in own if (run.task, run.agent) == (task, BAR_AGENT)][:BAR_RUNS])
                  for own in (everything, fresh)] for task in BAR}
    given, costs = _count_graphs(everything), compare_given(everything)
    return Findings(
        SimpleNamespace(escapes=escapes, bar=[runs for own in bar.values() for runs in own], given=given, costs=costs,
                        trials=len({run.place for run in everything}), budget=budget, data=study.data),
        {"escapes": make_table(["rule", "agent", *SIZES], [
            [f"`{rule}`", AgentSpec.parse(agent).title, *(escapes.get((rule, agent, size), "") for size in SIZES)]
            for rule, agent in itertools.product(RULES, AGENTS)]),
         "bar": make_table(["room", "runs", "escaped", "near the best", "whole graph", "first escape, median"], [
             [f"{task.buttons} buttons, `{task.rule}`{', fresh rooms' * place}", own.runs, own.escaped, own.near_best,
              own.whole, f"{own.median:,.0f}"] for task, both in bar.items() for place, own in enumerate(both)]),
         "given": make_table(["rule", "condition, parents", "whole graph", "primitives more"], [
             [f"`{rule}`", f"`{label}`", f"{whole} of {made}",
              format_interval(costs[rule, label], "+,.0f") if (rule, label) in costs else "true values"]
             for (rule, label), (whole, made) in given.items()])},
        {"scaling": lambda theme: draw(escapes, theme)})


def follow(results: Sequence[ScalingRun], rule: str, agent: str, size: int, budget: int) -> FollowedRuns | None:
    """First escapes of an agent's planned runs with some number of buttons; None where no run was planned.

    A run that was not made because the agent never escaped with fewer buttons (same graph and seed) counts as one that
    fails. A run that was not begun because the time was up says nothing and is left out.
    """
    own = [run for run in results if (run.rule, run.agent) == (rule, agent)]
    made = {(run.graph, run.run): run.first_escape for run in own if run.buttons == size}
    failed = {(run.graph, run.run) for run in own if run.buttons < size and run.first_escape is None}
    ends = [*made.values(), *[None] * len(failed - made.keys())]
    return FollowedRuns(tuple(budget if end is None else min(end, budget) for end in ends),
                        tuple(end is not None for end in ends), budget) if ends else None


def _count_graphs(results: Sequence[ScalingRun]) -> dict[tuple[str, str], tuple[int, int]]:
    """By rule and label, runs with the whole graph, and all."""
    return {(task.rule, spec.label): (sum(map(_has_graph, own)), len(own))
            for task, spec in itertools.product(GIVEN_TASKS, GIVEN)
            if (own := [run for run in results if (run.task, run.agent) == (task, spec.label)])}


_LINES = {"smdp-factored-r-max": (0, "factored R-MAX", (7.0, 75)),
          "smdp-monte-carlo-model": (1, "Monte Carlo", (11.5, 260)),
          "smdp-r-max": (3, "R-MAX", (10.8, 8_000)), "smdp-dqn": (2, "DQN", (7.4, 2_400)),
          "random-options": (4, "random", (2.0, 260))}
"""Agents of the figure: number of their colour, label, and its place in the upper panel."""


def draw(escapes: Mapping[tuple[str, str, int], FollowedRuns], theme: Theme) -> Figure:
    """Draw the median primitives to the first escape, a panel a rule; a line ends where fewer than half escape."""

    def draw_axes(panels: Sequence[Axes]) -> None:
        for axes, rule in zip(panels, RULES, strict=True):
            for agent, (number, label, place) in _LINES.items():
                own = {size: runs.median for size in SIZES if (runs := escapes.get((rule, agent, size))) is not None
                       and runs.median is not None}
                axes.plot(list(own), list(own.values()), "--" if number == 4 else "-", marker="o", markersize=4,
                          color=theme.lines[number], linewidth=2.2)
                if axes is panels[0]:
                    write_label(axes, *place, label, theme.lines[number])
            axes.set(xscale="log", yscale="log", ylabel="primitives")
            effect = "does nothing" if rule == "ignore" else "turns all buttons off"
            axes.set_title(f"a wrong press {effect}", loc="left", fontsize=10)
            axes.set_xticks(SIZES, list(map(str, SIZES)))
            axes.xaxis.set_minor_locator(NullLocator())
            mark_counts(axes.yaxis)
        panels[-1].set_xlabel("buttons in the room")

    return make_figure(theme, draw_axes, height=5.4, nrows=len(RULES), sharex=True, sharey=True)
