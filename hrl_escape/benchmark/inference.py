"""Inference from few runs: intervals for bounded scores, paired tests, and correction for multiple comparisons.

Intervals draw weights of the runs from a flat Dirichlet distribution over the runs and one more value: the lowest
possible score for the lower end, the highest for the upper end (Gaffke 2005). For the mean of zeros and ones this is
the interval of Clopper and Pearson; unlike a bootstrap it has a positive width for equal runs. Comparisons are paired
by room and training seed. `benchmarks/calibration.py` measures the error rates of intervals and tests.

All pairs of agents of a comparison are one family, because a verdict can refer to any pair.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import special  # pyright: ignore[reportMissingTypeStubs]

from hrl_escape.benchmark.statistics import LEAST_RUNS, Floats, Scores, compute_mean

LEVEL = 0.95
RESAMPLES = 2_000


class Statistic(Protocol):
    """Statistic of scores, (..., runs) for each room, with weights that add up to 1 in each room."""

    def __call__(self, scores: Scores, weights: Scores | None = None, /) -> Floats:
        """Compute the statistic; without weights all scores of a room have equal weights."""
        ...


class Estimate(NamedTuple):
    """Estimate with its 95 % interval; `f"{estimate:.2f}"` is `0.91 (0.87 to 0.94)`.

    The text omits an interval without width.
    """

    value: float
    low: float
    high: float

    def __format__(self, spec: str) -> str:
        value, low, high = (format(number, spec) for number in self)
        return value if low == high else f"{value} ({low} to {high})"


def compute_interval(statistic: Statistic, scores: Scores, bounds: tuple[float, float], rng: np.random.Generator,
                     resamples: int = RESAMPLES, level: float = LEVEL) -> tuple[Floats, Floats]:
    """Compute the interval of a monotone statistic of bounded scores, such as the mean or interquartile mean.

    Scores are (..., runs) for each room, `bounds` the lowest and highest possible. The ends have the shape of the
    statistic.
    """
    weights = [draw_weights(room.shape[-1], resamples, rng).reshape(resamples, *[1] * (room.ndim - 1), -1)
               for room in scores]
    return cut_interval(*compute_ends(statistic, scores, bounds, weights), level)


def compute_ends(statistic: Statistic, scores: Scores, bounds: tuple[float, float], weights: Scores
                 ) -> tuple[Floats, Floats]:
    """Draw a statistic (resamples, ...) with the lowest possible score added, and with the highest.

    The share of the first draws at or below a level is the p-value for a statistic above it; the share of the second
    draws at or above a level is the p-value for a statistic below it. Scores are (..., runs) for each room, weights
    from `draw_weights` (resamples, ..., runs + 1).
    """
    lower, upper = (statistic([np.concatenate([room, np.full((*room.shape[:-1], 1), bound)], axis=-1)
                               for room in scores], weights) for bound in bounds)
    return lower, upper


def cut_interval(lower: Floats, upper: Floats, level: float = LEVEL) -> tuple[Floats, Floats]:
    """Return the ends of an interval from the draws of `compute_ends`."""
    return np.quantile(lower, (1 - level) / 2, axis=0), np.quantile(upper, (1 + level) / 2, axis=0)


def draw_weights(count: int, resamples: int, rng: np.random.Generator) -> Floats:
    """Draw weights (resamples, count + 1) from a flat Dirichlet distribution: `count` values and the added one."""
    drawn = rng.standard_exponential((resamples, count + 1))
    drawn /= drawn.sum(axis=-1, keepdims=True)
    return drawn


def compute_wilson_interval(share: float, tries: int) -> tuple[float, float]:
    """Compute Wilson's 95 % interval of a share (Wilson 1927).

    Args:
        share: observed share; if a try is a share of episodes, the mean over tries.
        tries: number of independent tries, such as runs; episodes of one run are not independent.
    """
    z2 = float(special.ndtri((1 + LEVEL) / 2)) ** 2
    middle = (share + z2 / (2 * tries)) / (1 + z2 / tries)
    reach = math.sqrt(z2 * share * (1 - share) / tries + z2**2 / (4 * tries**2)) / (1 + z2 / tries)
    return max(0.0, middle - reach), min(1.0, middle + reach)


class PairedTest(NamedTuple):
    """Difference between two agents over the runs they share."""

    difference: float  # mean over rooms of the mean difference
    low: float  # lower end of its interval, 95 % by default
    high: float  # upper end
    p: float  # two-sided
    pairs: int  # (room, seed) pairs


def compare_pairs(differences: Sequence[NDArray[np.float64]], level: float = LEVEL) -> PairedTest:
    """Paired t test with rooms as strata of equal weight and Satterthwaite's degrees of freedom.

    If the differences in every room are equal, the interval has no width and the p-value is an upper bound. Two
    independent runs of one distribution differ by a given d other than 0 with probability at most 1/4 (x + d and x,
    each in half of all runs), so n pairs all differ by one d with probability at most 4^(1 - n).

    Args:
        differences: (seeds,) for each room, first agent minus second with the same seed.
        level: confidence of the interval.
    """
    count = sum(map(len, differences))
    rooms = [room for room in differences if len(room)]
    mean = float(np.mean([room.mean() for room in rooms])) if rooms else 0.0
    if min(map(len, rooms), default=0) < 2:
        return PairedTest(mean, -math.inf, math.inf, 1.0, count)
    variances = np.array([room.var(ddof=1) / len(room) for room in rooms])
    error = math.sqrt(variances.sum()) / len(rooms)
    if error <= 1e-12:
        lasting = [room for room in rooms if abs(room[0]) > 1e-12]
        p = 1.0 if abs(mean) <= 1e-12 else math.prod(4.0 ** (1 - len(room)) for room in lasting)
        return PairedTest(mean, mean, mean, p, count)
    freedom = variances.sum() ** 2 / np.sum(variances**2 / [len(room) - 1 for room in rooms])
    reach = float(special.stdtrit(freedom, (1 + level) / 2)) * error
    return PairedTest(mean, mean - reach, mean + reach, float(2 * special.stdtr(freedom, -abs(mean) / error)), count)


def correct_by_holm(p: Sequence[float]) -> list[float]:
    """Adjust the p-values of a family of comparisons by Holm's method (1979).

    The k-th smallest of n p-values is multiplied by n - k + 1, and adjusted values are monotone. A value below 0.05 is
    a false finding in at most 5 % of families.
    """
    adjusted, largest = [0.0] * len(p), 0.0
    for rank, index in enumerate(sorted(range(len(p)), key=lambda index: p[index])):
        largest = max(largest, min(1.0, (len(p) - rank) * p[index]))
        adjusted[index] = largest
    return adjusted


ALPHA = 0.05
"""Largest probability of a false finding in a comparison of equal agents."""
IMPROVEMENT_RESAMPLES = 1_000

Finals: TypeAlias = Mapping[tuple[str, int], float]
"""(room, training seed) -> final efficiency of a run, or another `Measure`."""


@dataclass(frozen=True)
class Pair:
    """Two agents compared."""

    improvement: Estimate  # share of pairs with the first above the second, ties half
    difference: Estimate  # of means, first minus second; its interval is not corrected
    p: float  # two-sided, corrected over the family; 1 if one of the agents is not in it
    count: int  # (room, seed) pairs

    def turn(self) -> Pair:
        """Return the comparison with first and second exchanged."""
        share, gain = self.improvement, self.difference
        return Pair(Estimate(1 - share.value, 1 - share.high, 1 - share.low),
                    Estimate(-gain.value, -gain.high, -gain.low), self.p, self.count)


ITSELF = Pair(Estimate(0.5, 0.5, 0.5), Estimate(0.0, 0.0, 0.0), 1.0, 0)


def is_better(pair: Pair) -> bool:
    """Return whether the first agent is significantly better, from at least `LEAST_RUNS` pairs of runs."""
    return pair.count >= LEAST_RUNS and pair.p < ALPHA and pair.difference.value > 0


def compare_agents(finals: Sequence[Finals], in_family: Sequence[bool], rng: np.random.Generator,
                   resamples: int = IMPROVEMENT_RESAMPLES, largest: float = 1.0) -> tuple[tuple[Pair, ...], ...]:
    """Compare all agents with each other.

    Args:
        finals: final values of each agent.
        in_family: false for references without claims.
        rng: of the intervals.
        resamples: of the intervals.
        largest: largest difference of two values.
    """
    couples = list(itertools.combinations(range(len(finals)), 2))
    found = {couple: _compare(finals[couple[0]], finals[couple[1]], rng, resamples, largest) for couple in couples}
    family = [couple for couple in couples if in_family[couple[0]] and in_family[couple[1]]]
    adjusted = dict(zip(family, correct_by_holm([found[couple].p for couple in family]), strict=True))
    pairs = {couple: Pair(pair.improvement, pair.difference, adjusted.get(couple, 1.0), pair.count)
             for couple, pair in found.items()}
    pairs |= {(second, first): pair.turn() for (first, second), pair in pairs.items()}
    everybody = range(len(finals))
    return tuple(tuple(pairs.get((first, second), ITSELF) for second in everybody) for first in everybody)


def _compare(first: Finals, second: Finals, rng: np.random.Generator, resamples: int, largest: float) -> Pair:
    differences = _subtract(first, second)
    test = compare_pairs(differences)
    if not differences:
        return Pair(Estimate(0.5, 0.0, 1.0), Estimate(0.0, -largest, largest), 1.0, 0)
    wins = [np.heaviside(room, 0.5) for room in differences]
    low, high = compute_interval(compute_mean, wins, (0.0, 1.0), rng, resamples)
    improvement = Estimate(float(compute_mean(wins)), float(low), float(high))
    difference = Estimate(test.difference, max(test.low, -largest), min(test.high, largest))
    return Pair(improvement, difference, test.p, test.pairs)


def _subtract(first: Finals, second: Finals) -> list[Floats]:
    """Return the differences (pairs,) for each room, over common pairs."""
    rooms: dict[str, list[float]] = {}
    for room, seed in first:
        if (room, seed) in second:
            rooms.setdefault(room, []).append(first[room, seed] - second[room, seed])
    return [np.round(values, 12) for values in rooms.values()]
