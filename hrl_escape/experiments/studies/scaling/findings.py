"""Conclusions of the scaling study in sentences, each chosen and filled by rule from its runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy import stats  # pyright: ignore[reportMissingTypeStubs]

from hrl_escape.experiments.statistics import NEAR_BEST
from hrl_escape.experiments.studies.scaling.followed_runs import count_spared
from hrl_escape.experiments.studies.scaling.scaling_runs import ScalingRun
from hrl_escape.experiments.studies.scaling.study import (
    AGENTS,
    BAR,
    BAR_AGENT,
    RULES,
    SIZES,
    TOLD,
    TOLD_TASKS,
)
from hrl_escape.names import join_words

__all__ = ["compute_rank_correlations", "measure_told", "tell_difficulty", "tell_replication", "tell_sizes",
           "tell_told"]

_APART = 0.05
"""Difference of rank correlations from which on one measure of difficulty is said to be better."""
_MEASURES: dict[str, Callable[[ScalingRun], int]] = {
    "edges that matter": lambda run: run.edges, "depth": lambda run: run.depth, "buttons": lambda run: run.buttons,
}


def tell_sizes(results: Sequence[ScalingRun]) -> list[str]:
    """For each rule the most buttons with which all planned runs of an agent escape, agents of one size together."""
    sentences = []
    for rule in RULES:
        reach: dict[int, list[str]] = {}
        for agent in AGENTS:
            own = [run for run in results if (run.agent, run.rule) == (agent, rule)]
            if own:
                size, is_tried = _find_reach(own)
                name = f"`{agent.removeprefix('smdp-')}`"
                reach.setdefault(size, []).append(name if is_tried else f"{name} (not tried with more)")
        parts = [f"{f'up to {size}' if size else 'with no number of'} buttons for {join_words(names)}"
                 for size, names in sorted(reach.items(), reverse=True)]
        if parts:
            sentences.append(f"With the {rule} rule all planned runs escape {'; '.join(parts)}.")
    return sentences


def _find_reach(own: Sequence[ScalingRun]) -> tuple[int, bool]:
    """The most buttons with which all runs escape, and whether it was tried with more, where there are more."""
    most, is_tried = 0, True
    for size in SIZES:
        here = [run for run in own if run.buttons == size]
        is_spared = count_spared(own, own[0].rule, own[0].agent, size) > 0
        is_tried = bool(here) or is_spared
        if not here or is_spared or any(run.first_escape is None for run in here):
            break
        most = size
    return most, is_tried


def compute_rank_correlations(results: Sequence[ScalingRun], budget: int) -> dict[str, float]:
    """Measure of difficulty -> Spearman's correlation with the first escape, mean over agents and rules.

    Rooms that were tried count; runs without an escape wait for the whole budget.
    """
    found: dict[str, list[float]] = {measure: [] for measure in _MEASURES}
    for agent in AGENTS:
        for rule in RULES:
            own = [run for run in results if (run.agent, run.rule) == (agent, rule)]
            times = [budget if run.first_escape is None else run.first_escape for run in own]
            if len(own) < 5 or len(set(times)) < 2:
                continue
            for measure, read in _MEASURES.items():
                values = [read(run) for run in own]
                found[measure].append(_correlate_ranks(values, times) if len(set(values)) > 1 else 0.0)
    return {measure: float(np.mean(values)) for measure, values in found.items() if values}


def _correlate_ranks(first: Sequence[float], second: Sequence[float]) -> float:
    return float(np.corrcoef(stats.rankdata(first), stats.rankdata(second))[0, 1])


def tell_difficulty(results: Sequence[ScalingRun], budget: int) -> list[str]:
    """Measures that order rooms best by their difficulty."""
    found = compute_rank_correlations(results, budget)
    if not found:
        return []
    ranked = sorted(found.items(), key=lambda item: -item[1])
    numbers = ", ".join(f"{value:.2f} with {measure}" for measure, value in ranked)
    best = [measure for measure, value in ranked if value > ranked[0][1] - _APART]
    verdict = (f"{best[0]} order{'s' if best[0] == 'depth' else ''} rooms best by how long an escape takes"
               if len(best) == 1 else f"{join_words(best)} order rooms about equally well by how long an escape takes")
    return [f"{verdict[0].upper()}{verdict[1:]}: rank correlation with the first escape {numbers}, mean over agents "
            "and rules."]


def measure_told(results: Sequence[ScalingRun]) -> dict[tuple[str, str], tuple[int, int, int, int]]:
    """(rule, label) -> runs, those that escape, those near the best, and those that have the graph without a fault."""
    found = {}
    for task in TOLD_TASKS:
        for spec in TOLD:
            own = [run for run in results if (run.task, run.agent) == (task, spec.label)]
            if own:
                exact = sum(bool(run.structure) and run.structure[-1][1:] == (1.0, 1.0) for run in own)
                found[task.rule, spec.label] = (len(own), sum(run.first_escape is not None for run in own),
                                                sum(run.near_best is not None for run in own), exact)
    return found


def tell_told(results: Sequence[ScalingRun]) -> list[str]:
    """Labels with which all runs have the whole graph, rule by rule."""
    found = measure_told(results)
    sentences = []
    for task in TOLD_TASKS:
        here = {label: counts for (rule, label), counts in found.items() if rule == task.rule}
        if not here:
            continue
        whole = [f"`{label}`" for label, (runs, _, _, exact) in here.items() if exact == runs]
        part = [f"`{label}` ({exact} of {runs})" for label, (runs, _, _, exact) in here.items() if exact < runs]
        having = (f"all runs have the whole graph told {join_words(whole, 'or')}" if whole else
                  "told nothing here all runs have the whole graph")
        lacking = f"; not all do told {join_words(part, 'or')}" if part and whole else ""
        sentences.append(f"Rule {task.rule}: {having}{lacking}.")
    return sentences


def tell_replication(fresh: Sequence[ScalingRun], published: Sequence[ScalingRun]) -> list[str]:
    """A sentence for each room of the bar: fresh seeds and rooms beside the published runs."""
    sentences = []
    for task in BAR:
        own, known = ([run for run in runs if (run.task, run.agent) == (task, BAR_AGENT)]
                      for runs in (fresh, published))
        if not own or not known:
            continue
        seeds = sorted(run.run for run in own)
        before, now = (sum(run.near_best is not None for run in runs) / len(runs) for runs in (known, own))
        alike = "the same conclusion" if (now >= NEAR_BAR) == (before >= NEAR_BAR) else "another conclusion"
        exact = sum(bool(run.structure) and run.structure[-1][1:] == (1.0, 1.0) for run in own)
        sentences.append(
            f"{task.buttons} buttons, {task.graph}, {task.rule}: {alike}. {round(now * len(own))} of {len(own)} come "
            f"to {NEAR_BEST:.0%} of the best return, and {exact} have the whole graph without an edge too many (seeds "
            f"{seeds[0]} to {seeds[-1]}); first escape after {_tell_median(own)} primitives, "
            f"where the published runs take {_tell_median(known)} (medians).")
    return sentences


NEAR_BAR = 0.9
"""Share of runs near the best from which on the bar counts as met."""


def _tell_median(runs: Sequence[ScalingRun]) -> str:
    escapes = [run.first_escape for run in runs if run.first_escape is not None]
    return f"{np.median(escapes):,.0f}" if escapes else "no number of"
