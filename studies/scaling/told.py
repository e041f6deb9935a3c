"""Knowledge given to structure learners: runs by label, and the cost of more or less than just what holds.

A learner is told the conditions of a press and how many parents a button may have. All labels meet the same rooms and
training seeds, so that each is compared with `HOLDS` seed by seed; all these comparisons are one family (Holm).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hrl_escape.benchmark.inference import ALPHA, correct_by_holm
from hrl_escape.benchmark.statistics import LEAST_RUNS
from hrl_escape.names import count_nouns, join_words
from studies.scaling.results import ScalingRun
from studies.scaling.rounds import BAR_AGENT, MAX_PARENTS, TOLD, TOLD_TASKS
from studies.statistics import (
    choose_holm_levels,
    compute_restricted_mean,
    compute_sign_flip_p,
    cut_signs,
    find_visible_shift,
    tell_power,
)

__all__ = ["HOLDS", "ToldCost", "advise_told", "compute_told_costs", "list_told_rows", "tell_told",
           "tell_too_few"]

HOLDS = f"all-on, {MAX_PARENTS}"
"""Label of the learner that is told just what holds in these rooms."""


class ToldCost(NamedTuple):
    """Primitives that being told otherwise costs, until a run is near the best and has the whole graph.

    Attributes:
        rule: of the rooms.
        label: of the learner.
        runs: pairs of runs with the same room and seed.
        more: mean difference from `HOLDS`; runs that do not get there count with the budget.
        agreeing: pairs that differ to the same side as the mean.
        p: two-sided, by the signs of the differences, corrected over the study; 1 with too few runs.
        low: lower end of its interval, of the corrected level, which leaves out 0 where the test shows a difference.
        high: upper end.
        differences: of the pairs.
    """

    rule: str
    label: str
    runs: int
    more: float
    agreeing: int
    p: float
    low: float = -np.inf
    high: float = np.inf
    differences: tuple[float, ...] = ()

    @property
    def is_shown(self) -> bool:
        """The runs show a difference."""
        return self.p < ALPHA


def compute_told_costs(results: Sequence[ScalingRun]) -> list[ToldCost]:
    """Costs of all labels but `HOLDS` that have a run beside one of it, room kind by room kind."""
    found, raw, differences = [], [], []
    for task in TOLD_TASKS:
        waits = {spec.label: {run.run: _wait_for_graph(run) for run in results
                              if (run.task, run.agent) == (task, spec.label)} for spec in TOLD}
        known = waits.pop(HOLDS)
        for label, own in waits.items():
            seeds = sorted(own.keys() & known.keys())
            if not seeds:
                continue
            more = np.array([own[seed] - known[seed] for seed in seeds], dtype=np.float64)
            agreeing = int(np.sum(more * more.mean() > 0))
            found.append(ToldCost(task.rule, label, len(seeds), float(more.mean()), agreeing, 1.0))
            p = 2 * min(compute_sign_flip_p(more, "above"), compute_sign_flip_p(more, "below"))
            raw.append(min(1.0, p) if len(seeds) >= LEAST_RUNS else 1.0)
            differences.append(more)
    ends = [cut_signs(more, level) for more, level in zip(differences, choose_holm_levels(raw), strict=True)]
    return [cost._replace(p=p, low=low, high=high, differences=tuple(more.tolist()))
            for cost, p, (low, high), more in zip(found, correct_by_holm(raw), ends, differences, strict=True)]


def _wait_for_graph(run: ScalingRun) -> int:
    """Primitives until it was near the best with the whole graph, which ends a run; the budget if it never was."""
    return min(run.primitives, run.budget) if run.near_best is not None and _has_graph(run) else run.budget


def _has_graph(run: ScalingRun) -> bool:
    """Return whether it ends with every edge that matters, and none too many."""
    return bool(run.structure) and run.structure[-1][1:] == (1.0, 1.0)


def tell_told(results: Sequence[ScalingRun]) -> list[str]:
    """For each rule, labels with which all runs have the whole graph, and what being told otherwise costs."""
    costs = compute_told_costs(results)
    sentences = []
    for task in TOLD_TASKS:
        runs = {spec.label: [run for run in results if (run.task, run.agent) == (task, spec.label)] for spec in TOLD}
        runs = {label: own for label, own in runs.items() if own}
        if not runs:
            continue
        fewest = min(map(len, runs.values()))
        words = (f"{_tell_graphs(runs)} {_tell_costs([cost for cost in costs if cost.rule == task.rule])}"
                 if fewest >= LEAST_RUNS else f"nothing is concluded from {count_nouns(fewest, 'run')} of a label.")
        sentences.append(f"Rule {task.rule}: {words}")
    power = tell_power([find_visible_shift(cost.differences, ALPHA / len(costs)) for cost in costs
                        if cost.runs >= LEAST_RUNS], "a difference of", "{:,.0f}".format)
    return [*sentences, *filter(None, [power])]


def _tell_graphs(runs: dict[str, list[ScalingRun]]) -> str:
    exact = {label: sum(map(_has_graph, own)) for label, own in runs.items()}
    whole = [f"`{label}`" for label, count in exact.items() if count == len(runs[label])]
    part = [f"`{label}` ({count} of {len(runs[label])})" for label, count in exact.items() if count < len(runs[label])]
    if not whole:
        return f"told nothing here all runs have the whole graph ({join_words(part)})."
    lacking = f"; not all do told {join_words(part, 'or')}" if part else ""
    return f"all runs have the whole graph told {join_words(whole, 'or')}{lacking}."


def _tell_costs(costs: Sequence[ToldCost]) -> str:
    """Sentence on the primitives that labels take beyond those of `HOLDS`, or save."""
    if not costs:
        return f"None was told `{HOLDS}`, which is what holds."
    parts = []
    for sign, word in ((1, "more"), (-1, "fewer")):
        shown = [cost for cost in costs if cost.is_shown and sign * cost.more > 0]
        if shown:
            parts.append(f"it takes {word} primitives told {join_words(map(_tell_cost, shown))}")
    if rest := [f"`{cost.label}`" for cost in costs if not cost.is_shown]:
        parts.append(f"no difference is shown told {join_words(rest, 'or')}")
    return f"Against `{HOLDS}`, which is what holds, until near the best with the whole graph {'; '.join(parts)}."


def _tell_cost(cost: ToldCost) -> str:
    low, high = sorted((abs(cost.low), abs(cost.high)))
    return f"`{cost.label}` ({abs(cost.more):,.0f}, {low:,.0f} to {high:,.0f}, in {cost.agreeing} of {cost.runs} pairs)"


def advise_told(results: Sequence[ScalingRun]) -> str:
    """Advice to a user: what to tell a learner of structure, by what being told otherwise costs."""
    costs = [cost for cost in compute_told_costs(results) if cost.runs >= LEAST_RUNS]
    few = tell_too_few(results)
    learner = f"`{BAR_AGENT.removeprefix('smdp-')}`"
    dearer, cheaper = ([f"`{cost.label}`" for cost in costs if cost.is_shown and cost.more * sign > 0]
                       for sign in (1, -1))
    if cheaper:
        said = f"Tell {learner} {join_words(dict.fromkeys(cheaper), 'or')}, which is shown to help beyond what holds."
    elif dearer:
        said = (f"Tell {learner} what holds and nothing else: told {join_words(dict.fromkeys(dearer), 'or')} it takes "
                "longer.")
    else:
        said = f"What {learner} is told is not shown to change how long it takes." if costs else ""
    return f"{said} {few}".strip()


def tell_too_few(results: Sequence[ScalingRun]) -> str:
    """A sentence where all labels of too few parents find the whole graph in fewer runs than any other; else empty."""
    shares: dict[str, list[tuple[int, int]]] = {}
    for task, spec in itertools.product(TOLD_TASKS, TOLD):
        own = [run for run in results if (run.task, run.agent) == (task, spec.label)]
        if len(own) >= LEAST_RUNS:
            shares.setdefault(spec.label, []).append((sum(map(_has_graph, own)), len(own)))
    few, enough = ({label: own for label, own in shares.items()
                    if (int(label.rsplit(", ")[1]) < MAX_PARENTS) == is_few} for is_few in (True, False))
    if not few or not enough:
        return ""
    best, least = (choose((pair for own in group.values() for pair in own), key=lambda pair: pair[0] / pair[1])
                   for choose, group in ((max, few), (min, enough)))
    if best[0] * least[1] >= least[0] * best[1]:
        return ""
    names = join_words([f"`{label}`" for label in few], "or")
    return (f"Too few parents are the worst to be told: with {names} it finds the whole graph in at most {best[0]} of "
            f"{best[1]} runs, with the others in at least {least[0]} of {least[1]}.")


def list_told_rows(results: Sequence[ScalingRun]) -> list[list[Any]]:
    """A row a rule and label that has runs: how many escape, are near the best and have the whole graph, and when."""
    rows = []
    for task, spec in itertools.product(TOLD_TASKS, TOLD):
        own = [run for run in results if (run.task, run.agent) == (task, spec.label)]
        if own:
            escapes = [run.budget if run.first_escape is None else min(run.first_escape, run.budget) for run in own]
            seen = [run.first_escape is not None for run in own]
            waits = [_wait_for_graph(run) for run in own]
            rows.append([task.rule, spec.label, len(own), sum(seen), sum(run.near_best is not None for run in own),
                         sum(map(_has_graph, own)), f"{compute_restricted_mean(escapes, seen, own[0].budget):,.0f}",
                         f"{sum(waits) / len(waits):,.0f}"])
    return rows
