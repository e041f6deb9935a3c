"""Inference over few runs: intervals that hold for bounded scores, paired tests, and Holm's correction.

Intervals draw weights of the runs instead of runs: a flat Dirichlet law over them and one more value, the lowest
possible for the lower end and the highest for the upper end (Gaffke 2005). For the mean of zeros and ones this is the
interval of Clopper and Pearson, so it holds where a bootstrap of eight equal runs has no width at all. Comparisons are
paired by room and training seed. `benchmarks/calibration.py` measures how often both are wrong.

All pairs of agents of a comparison make up one family, for a verdict may look at any two, and at the best of several.
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
    """Statistic of scores, (..., runs) a room, and of their weights, which add up to 1 in each room."""

    def __call__(self, scores: Scores, weights: Scores | None = None, /) -> Floats:
        """Compute it; without weights all scores of a room weigh the same."""
        ...


class Estimate(NamedTuple):
    """A number and its 95 % interval; `f"{estimate:.2f}"` is `0.91 (0.87 to 0.94)`.

    The text leaves an interval without width out: no runs that are all equal say how far others would be.
    """

    value: float
    low: float
    high: float

    def __format__(self, spec: str) -> str:
        value, low, high = (format(number, spec) for number in self)
        return value if low == high else f"{value} ({low} to {high})"


def compute_interval(statistic: Statistic, scores: Scores, bounds: tuple[float, float], rng: np.random.Generator,
                     resamples: int = RESAMPLES, level: float = LEVEL) -> tuple[Floats, Floats]:
    """Interval of a statistic of bounded scores that grows with them, such as their mean or interquartile mean.

    Scores are (..., runs) a room, `bounds` the lowest and highest possible. Both ends have the statistic's own shape.
    """
    weights = [draw_weights(room.shape[-1], resamples, rng).reshape(resamples, *[1] * (room.ndim - 1), -1)
               for room in scores]
    return cut_interval(*compute_ends(statistic, scores, bounds, weights), level)


def compute_ends(statistic: Statistic, scores: Scores, bounds: tuple[float, float], weights: Scores
                 ) -> tuple[Floats, Floats]:
    """Draws (resamples, ...) of a statistic with the lowest possible score added, and with the highest.

    The share of the first at or below a level is the p-value of a statistic above that level, the share of the second
    at or above it that of a statistic below. Scores are (..., runs) a room, weights, from `draw_weights`,
    (resamples, ..., runs + 1).
    """
    lower, upper = (statistic([np.concatenate([room, np.full((*room.shape[:-1], 1), bound)], axis=-1)
                               for room in scores], weights) for bound in bounds)
    return lower, upper


def cut_interval(lower: Floats, upper: Floats, level: float = LEVEL) -> tuple[Floats, Floats]:
    """Ends of the interval of this confidence, from what `compute_ends` drew."""
    return np.quantile(lower, (1 - level) / 2, axis=0), np.quantile(upper, (1 + level) / 2, axis=0)


def draw_weights(count: int, resamples: int, rng: np.random.Generator) -> Floats:
    """Weights (resamples, count + 1) by a flat Dirichlet law: of `count` values, and of the one that is added."""
    drawn = rng.standard_exponential((resamples, count + 1))
    drawn /= drawn.sum(axis=-1, keepdims=True)
    return drawn


def compute_wilson_interval(share: float, tries: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share (Wilson 1927).

    Args:
        share: observed; where a try is itself a share of episodes, the mean of these.
        tries: independent ones. Episodes of one run are not independent, runs are.
    """
    z2 = float(special.ndtri((1 + LEVEL) / 2)) ** 2
    middle = (share + z2 / (2 * tries)) / (1 + z2 / tries)
    reach = math.sqrt(z2 * share * (1 - share) / tries + z2**2 / (4 * tries**2)) / (1 + z2 / tries)
    return max(0.0, middle - reach), min(1.0, middle + reach)


class PairedTest(NamedTuple):
    """Difference between two agents over the runs they share."""

    difference: float  # mean over rooms of the mean difference
    low: float  # lower end of its interval, of 95 % unless another level was asked for
    high: float  # upper end
    p: float  # two-sided
    pairs: int  # (room, seed) pairs


def compare_pairs(differences: Sequence[NDArray[np.float64]], level: float = LEVEL) -> PairedTest:
    """Student's t test of paired differences, rooms as strata of equal weight (Satterthwaite's degrees of freedom).

    Where the differences of every room are equal there is no spread to divide by, and the interval has no width. The
    p-value is then a bound: two independent runs of one law differ by some given d other than 0 with a chance of 1/4
    at most (x + d and x, each in half of all runs), so that n of them all differ by one d with a chance of 4^(1 - n)
    at most. The test of signs would say 2^(1 - n), for any law that is symmetric: of five differences that are more
    than Student's t says of four and a zero.

    Differences are (seeds,) a room, first agent less second in the same room with the same seed.
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
    """Adjust the p-values of a family of comparisons, so that one below 0.05 is wrong in 5 % of families at most.

    Holm (1979): the k-th smallest of n is multiplied by n - k + 1, and none falls below a smaller one's.
    """
    adjusted, largest = [0.0] * len(p), 0.0
    for rank, index in enumerate(sorted(range(len(p)), key=lambda index: p[index])):
        largest = max(largest, min(1.0, (len(p) - rank) * p[index]))
        adjusted[index] = largest
    return adjusted


ALPHA = 0.05
"""Highest probability that a verdict calls some agent better though all are alike."""
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
    """True if the runs, at least `LEAST_RUNS` pairs of them, show that the first scores above the second."""
    return pair.count >= LEAST_RUNS and pair.p < ALPHA and pair.difference.value > 0


def compare_agents(finals: Sequence[Finals], in_family: Sequence[bool], rng: np.random.Generator,
                   resamples: int = IMPROVEMENT_RESAMPLES) -> tuple[tuple[Pair, ...], ...]:
    """Compare all agents with each other; `in_family` is False for a reference that nothing is claimed of."""
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
