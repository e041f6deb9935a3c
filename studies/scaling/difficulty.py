"""Measures of a room's difficulty, compared by how well they order rooms by their first escapes."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats  # pyright: ignore[reportMissingTypeStubs]

from hrl_escape.benchmark.inference import ALPHA, correct_by_holm
from hrl_escape.benchmark.statistics import Floats
from hrl_escape.names import join_words
from studies.scaling.results import ScalingRun

__all__ = ["compute_rank_correlations", "tell_difficulty"]

SWAPS = 1_000
FEWEST_RUNS = 5
"""Of an agent under a rule; with fewer its runs are left out."""
_MEASURES: dict[str, Callable[[ScalingRun], int]] = {
    "edges that matter": lambda run: run.edges, "depth": lambda run: run.depth, "buttons": lambda run: run.buttons,
}


def compute_rank_correlations(results: Sequence[ScalingRun]) -> dict[str, float]:
    """Measure of difficulty -> Spearman's correlation with the first escape, mean over agents and rules.

    Rooms that were tried count; runs without an escape wait for the whole budget.
    """
    groups = _group(results)
    return {measure: float(_correlate(groups, _rank(results, read))) for measure, read in _MEASURES.items() if groups}


def tell_difficulty(results: Sequence[ScalingRun], rng: np.random.Generator) -> list[str]:
    """Measures that are shown to order rooms better than others, and the correlations of all.

    If two measures were equally good, each room's ranks by the one and the other could as well change places; rooms
    that differ in the rule alone do so together. All pairs of measures are one family (Holm).

    Args:
        results: runs.
        rng: source of the draws.
    """
    found = compute_rank_correlations(results)
    if not found:
        return []
    numbers = join_words(f"{value:.2f} with {measure}" for measure, value in sorted(
        found.items(), key=lambda item: -item[1]))
    better = _find_better(results, found, rng)
    winners = list(dict.fromkeys(first for first, _ in better))
    if any(sum(first == winner for first, _ in better) == len(_MEASURES) - 1 for winner in winners):
        verdict = f"{_conjugate(winners[0])} rooms best by how long an escape takes"
    elif better:
        pairs = [f"{_conjugate(first)} rooms better than {second}" for first, second in better]
        verdict = f"{join_words(pairs)} by how long an escape takes"
    else:
        verdict = "No measure is shown to order rooms better than another by how long an escape takes"
    return [f"{verdict[0].upper()}{verdict[1:]}: rank correlation with the first escape {numbers}, mean over agents "
            "and rules."]


def _conjugate(measure: str) -> str:
    return f"{measure} order{'s' if measure == 'depth' else ''}"


def _find_better(results: Sequence[ScalingRun], found: dict[str, float], rng: np.random.Generator
                 ) -> list[tuple[str, str]]:
    """Pairs of measures of which the first is shown to be better, the best measures first."""
    groups, pairs, p = _group(results), [], []
    rooms = {key: number for number, key in enumerate(dict.fromkeys(map(_get_room, results)))}
    place = np.array([rooms[_get_room(run)] for run in results])
    swaps = rng.random((SWAPS, len(rooms))) < 0.5
    for first, second in itertools.combinations(sorted(_MEASURES, key=lambda measure: -found[measure]), 2):
        one, other = (_rank(results, _MEASURES[measure]) for measure in (first, second))
        drawn = [np.where(swaps[:, place], *sides) for sides in ((one, other), (other, one))]
        chance = np.abs(_correlate(groups, drawn[0]) - _correlate(groups, drawn[1]))
        pairs.append((first, second))
        p.append((1 + float(np.sum(chance >= found[first] - found[second] - 1e-12))) / (1 + SWAPS))
    return [pair for pair, corrected in zip(pairs, correct_by_holm(p), strict=True) if corrected < ALPHA]


def _get_room(run: ScalingRun) -> tuple[str, int, int]:
    return run.graph, run.buttons, run.run


def _group(results: Sequence[ScalingRun]) -> list[tuple[list[int], Floats]]:
    """For each agent and rule with enough runs of unequal length, their numbers and their first escapes."""
    groups = []
    for agent, rule in dict.fromkeys((run.agent, run.rule) for run in results):
        own = [number for number, run in enumerate(results) if (run.agent, run.rule) == (agent, rule)]
        waits = [results[number].budget if results[number].first_escape is None else results[number].first_escape
                 for number in own]
        if len(own) >= FEWEST_RUNS and len(set(waits)) > 1:
            groups.append((own, np.array(waits, dtype=np.float64)))
    return groups


def _rank(results: Sequence[ScalingRun], read: Callable[[ScalingRun], int]) -> Floats:
    """Ranks (runs,) by a measure."""
    return np.asarray(stats.rankdata([read(run) for run in results]), dtype=np.float64)


def _correlate(groups: Sequence[tuple[list[int], Floats]], values: ArrayLike) -> Floats:
    """Spearman's correlation of values (..., runs) with the first escape, mean over the groups; 0 of constants."""
    found = []
    for own, waits in groups:
        ranks, times = stats.rankdata(np.asarray(values)[..., own], axis=-1), stats.rankdata(waits)
        ranks, times = ranks - ranks.mean(axis=-1, keepdims=True), times - times.mean()
        scale = np.sqrt((ranks**2).sum(axis=-1) * (times**2).sum())
        found.append(np.where(scale > 0, (ranks * times).sum(axis=-1) / np.where(scale > 0, scale, 1.0), 0.0))
    return np.mean(found, axis=0)
