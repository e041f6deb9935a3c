"""Comparisons of agents pair by pair: the same rooms, training seeds and evaluation episodes, corrected as one family.

Every agent of a comparison meets the same (room, seed) pairs, so that two agents are compared by their differences
there. A verdict may look at any two agents, and at the best of several, so all pairs make up one family (Holm).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from hrl_escape.comparison.inference import Estimate, compare_pairs, compute_interval, correct_by_holm
from hrl_escape.comparison.statistics import Floats, compute_mean

ALPHA = 0.05
"""Highest probability that a verdict calls some agent better though all are alike."""
FEWEST_PAIRS = 5
"""With four, a clean separation of two agents that escape in half of their runs comes by chance too often."""
IMPROVEMENT_RESAMPLES = 1_000

Finals: TypeAlias = Mapping[tuple[str, int], float]
"""(room, training seed) -> final efficiency of a run."""


@dataclass(frozen=True)
class Pair:
    """Two agents compared."""

    improvement: Estimate  # share of pairs in which the first is above the second, ties half
    difference: Estimate  # of mean efficiency, first less second; the interval is not corrected for other comparisons
    p: float  # two-sided, corrected over the family; 1 where one of the two is not in it
    count: int  # (room, seed) pairs

    def turn(self) -> Pair:
        """Same comparison with first and second exchanged."""
        share, gain = self.improvement, self.difference
        return Pair(Estimate(1 - share.value, 1 - share.high, 1 - share.low),
                    Estimate(-gain.value, -gain.high, -gain.low), self.p, self.count)


ITSELF = Pair(Estimate(0.5, 0.5, 0.5), Estimate(0.0, 0.0, 0.0), 1.0, 0)


def is_better(pair: Pair) -> bool:
    """True if the runs show that the first scores above the second."""
    return pair.count >= FEWEST_PAIRS and pair.p < ALPHA and pair.difference.value > 0


def compare_agents(finals: Sequence[Finals], in_family: Sequence[bool], rng: np.random.Generator,
                   resamples: int = IMPROVEMENT_RESAMPLES) -> tuple[tuple[Pair, ...], ...]:
    """Compare all agents with each other.

    Args:
        finals: one an agent.
        in_family: one an agent; False for a reference that nothing is claimed of.
        rng: source of the draws for intervals.
        resamples: number of these draws.
    """
    couples = list(itertools.combinations(range(len(finals)), 2))
    found = {couple: _compare(finals[couple[0]], finals[couple[1]], rng, resamples) for couple in couples}
    family = [couple for couple in couples if in_family[couple[0]] and in_family[couple[1]]]
    adjusted = dict(zip(family, correct_by_holm([found[couple].p for couple in family]), strict=True))
    pairs = {couple: Pair(pair.improvement, pair.difference, adjusted.get(couple, 1.0), pair.count)
             for couple, pair in found.items()}
    pairs |= {(second, first): pair.turn() for (first, second), pair in pairs.items()}
    everybody = range(len(finals))
    return tuple(tuple(pairs.get((first, second), ITSELF) for second in everybody) for first in everybody)


def _compare(first: Finals, second: Finals, rng: np.random.Generator, resamples: int) -> Pair:
    differences = _subtract(first, second)
    test = compare_pairs(differences)
    if not differences:
        return Pair(Estimate(0.5, 0.0, 1.0), Estimate(0.0, -1.0, 1.0), 1.0, 0)
    wins = [np.heaviside(room, 0.5) for room in differences]
    low, high = compute_interval(compute_mean, wins, (0.0, 1.0), rng, resamples)
    improvement = Estimate(float(compute_mean(wins)), float(low), float(high))
    return Pair(improvement, Estimate(test.difference, max(test.low, -1.0), min(test.high, 1.0)), test.p, test.pairs)


def _subtract(first: Finals, second: Finals) -> list[Floats]:
    """Differences (pairs,) a room, over the pairs that both have."""
    rooms: dict[str, list[float]] = {}
    for room, seed in first:
        if (room, seed) in second:
            rooms.setdefault(room, []).append(first[room, seed] - second[room, seed])
    return [np.round(values, 12) for values in rooms.values()]
