"""Statistics that only the studies need: waiting times, tests by signs, false discoveries, levels, slopes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats  # pyright: ignore[reportMissingTypeStubs]

from hrl_escape.benchmark.inference import ALPHA, LEVEL, compare_pairs, correct_by_holm
from hrl_escape.benchmark.statistics import LEAST_RUNS, Floats

__all__ = ["Difference", "Mean", "choose_holm_levels", "compare_signs", "compare_strata", "compute_mean",
           "compute_median_interval",
           "compute_restricted_mean", "compute_sign_flip_p", "compute_slope",
           "cut_signs", "find_lasting", "list_subset_means"]

MOST_SIGNS = 14
"""Differences whose signs are all tried."""


def compute_median_interval(values: ArrayLike, level: float = 0.95) -> tuple[float, float, float]:
    """Median with its interval from order statistics, for any distribution; of ten numbers the second and ninth.

    Args:
        values: (n,); infinite where an event did not come.
        level: probability that the interval holds the median, at least (binomial).

    Returns:
        Median, lower and upper end; the ends are 0 and infinity where n is too small.
    """
    ordered = np.sort(np.asarray(values, dtype=np.float64))
    outside = int(stats.binom.ppf((1 - level) / 2, len(ordered), 0.5))
    low, high = (ordered[outside - 1], ordered[-outside]) if outside else (0.0, np.inf)
    return float(ordered[(len(ordered) - 1) // 2 : len(ordered) // 2 + 1].mean()), float(low), float(high)


def compute_restricted_mean(times: ArrayLike, observed: ArrayLike, horizon: float) -> float:
    """Mean time to an event up to a horizon: the area under the Kaplan-Meier curve.

    Args:
        times: (n,) of the event, or until which it was waited for.
        observed: (n,) the event came.
        horizon: where to stop; after the last time the curve stays as it is.
    """
    at, seen = np.asarray(times, dtype=np.float64), np.asarray(observed, dtype=bool)
    ends = np.unique(at)
    falls = [1 - np.sum(seen & (at == end)) / np.sum(at >= end) for end in ends]
    waiting = np.cumprod([1.0, *falls])
    inside = np.flatnonzero(ends < horizon)
    return float(np.sum(np.diff([0.0, *ends[inside], horizon]) * waiting[[0, *inside + 1]]))


def compute_sign_flip_p(differences: ArrayLike, side: Literal["above", "below"]) -> float:
    """One-sided p-value of a mean above (below) 0, by the signs that symmetric differences could as well have had.

    Exact up to 14 differences, beyond that from 2^14 draws (Fisher 1935). It holds for paired differences of any
    form, where Student's t does not: of ten differences of 0 and 1 alone, six are 0.0026 to the one and 1 / 64 to the
    other.

    Args:
        differences: (n,) between runs that could change places if nothing were to be found.
        side: of 0, where the mean is looked for.
    """
    values = np.asarray(differences, dtype=np.float64)
    sums = _list_signs(len(values)) @ (values if side == "above" else -values)
    return float(np.mean(sums >= sums[0] - 1e-9))


def list_subset_means(values: ArrayLike) -> Floats:
    """Means of all subsets but the empty one, ascending; of more than 14 numbers, of drawn subsets.

    Differences that are symmetric about their centre put it between any two neighbours with equal probability (the
    typical values of Hartigan 1969), so that these means hold every interval of the centre, and their share below a
    number is the p-value that `compute_sign_flip_p` gives. Infinite numbers are ends that are not known.

    Args:
        values: (n,).

    Returns:
        A read-only array; arrays of recent values are cached.
    """
    return _list_subset_means(tuple(np.asarray(values, dtype=np.float64).tolist()))


@lru_cache(maxsize=64)
def _list_subset_means(values: tuple[float, ...]) -> Floats:
    numbers = np.array(values, dtype=np.float64)
    chosen = _list_signs(len(numbers)) > 0
    chosen = chosen[chosen.any(axis=1)]
    finite = np.isfinite(numbers)
    means = np.where(chosen[:, finite], numbers[finite], 0.0).sum(axis=1) / chosen.sum(axis=1)
    for end in (-np.inf, np.inf):
        means[chosen[:, numbers == end].any(axis=1)] = end
    means.sort()
    means.flags.writeable = False
    return means


def cut_signs(values: ArrayLike, level: float) -> tuple[float, float]:
    """Interval of a mean by flipped signs, which leaves out 0 just where their two-sided test does (Hartigan 1969).

    Args:
        values: (n,); infinite numbers are ends that are not known.
        level: probability that it holds the mean, at least.
    """
    means = list_subset_means(values)
    outside = int((1 - level) / 2 * (len(means) + 1))
    return (float(means[outside - 1]), float(means[-outside])) if outside else (-np.inf, np.inf)


@lru_cache(maxsize=8)
def _list_signs(count: int) -> Floats:
    """All signs of so many numbers, (2^count, count), or drawn ones of many; the first row is all plus."""
    if count <= MOST_SIGNS:
        return 1.0 - 2.0 * (np.arange(2**count)[:, np.newaxis] >> np.arange(count) & 1)
    signs = np.random.default_rng(2019).choice([-1.0, 1.0], size=(2**MOST_SIGNS, count))
    signs[0] = 1.0
    return signs


class Mean(NamedTuple):
    """Mean with its interval."""

    mean: float
    low: float
    high: float


def compute_mean(values: NDArray[np.float64], level: float = LEVEL, least_error: float = 0.0) -> Mean:
    """Mean with Student's interval; the standard error counts as at least so much."""
    mean, count = float(np.mean(values)), len(values)
    error = max(float(stats.sem(values)), least_error) if count > 1 else math.inf
    reach = error * float(stats.t.ppf((1 + level) / 2, max(count - 1, 1)))
    return Mean(mean, mean - reach, mean + reach)


class Difference(NamedTuple):
    """Two agents compared by pairs of runs.

    Attributes:
        mean: of the differences.
        low: lower end of its interval, which leaves out 0 where the test shows a difference.
        high: upper end.
        p: two-sided, corrected over the family; 1 with fewer than `LEAST_RUNS` pairs.
    """

    mean: float
    low: float
    high: float
    p: float

    @property
    def sign(self) -> int:
        """1 where a positive difference is shown, -1 where a negative one is, else 0."""
        return int(np.sign(self.mean)) if self.p < ALPHA else 0


def compare_signs(differences: Mapping[str, ArrayLike]) -> dict[str, Difference]:
    """Test the means of paired differences by the signs that they could as well have had, as one family (Holm).

    Args:
        differences: name -> (n,) between runs that could change places if nothing were to be found.
    """
    gains = {name: np.asarray(own, dtype=np.float64) for name, own in differences.items()}
    means = {name: list_subset_means(own) for name, own in gains.items()}
    p = [min(1.0, 2 * (1 + min(np.sum(own <= 0), np.sum(own >= 0))) / (len(own) + 1))
         if len(gains[name]) >= LEAST_RUNS else 1.0 for name, own in means.items()]
    found = {}
    for (name, own), level, corrected in zip(means.items(), choose_holm_levels(p), correct_by_holm(p), strict=True):
        outside = int((1 - level) / 2 * (len(own) + 1))
        ends = (own[outside - 1], own[-outside]) if outside else (-math.inf, math.inf)
        found[name] = Difference(float(gains[name].mean()), float(ends[0]), float(ends[1]), corrected)
    return found


def compare_strata(couples: Sequence[Sequence[NDArray[np.float64]]]) -> list[Difference]:
    """Test the means of paired differences over strata of equal weight by Student's t, as one family (Holm).

    Args:
        couples: of each the differences (n,) in each stratum.
    """
    p = [compare_pairs(strata).p for strata in couples]
    found = []
    for strata, level, corrected in zip(couples, choose_holm_levels(p), correct_by_holm(p), strict=True):
        test = compare_pairs(strata, level)
        found.append(Difference(test.difference, test.low, test.high, corrected))
    return found


def find_lasting(curve: Iterable[tuple[int, float]], least: float) -> int | None:
    """Place of the first of two values in a row that are no less, beyond rounding; None without such a pair.

    Args:
        curve: places, ascending, and the values there.
        least: of both.
    """
    return next((at for (at, value), (_, after) in itertools.pairwise(curve) if min(value, after) >= least - 1e-9),
                None)


def compute_slope(x: ArrayLike, y: ArrayLike, start: float, end: float) -> float:
    """Least-squares slope of a learning curve between two points, in units of `y` per unit of `x`.

    Args:
        x: (n,) where it was measured.
        y: (n,) the values; NaN where nothing was measured.
        start: from where, included.
        end: to where, included.

    Returns:
        The slope; 0 with fewer than two measurements in between, which show no trend.
    """
    at, values = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    chosen = (at >= start) & (at <= end) & np.isfinite(values)
    away = at[chosen] - at[chosen].mean() if chosen.any() else np.zeros(0)
    spread = float(np.sum(away**2))
    return float(np.sum(away * values[chosen]) / spread) if spread > 0 else 0.0


def choose_holm_levels(p: Sequence[float], alpha: float = 1 - LEVEL) -> list[float]:
    """Confidence of intervals for a family of comparisons, so that each leaves out 0 just where Holm's test does.

    The k-th smallest p of n is held against alpha / (n - k + 1) until one is above that; this one's share of alpha is
    used for all that follow. An interval of 1 less the share then leaves out 0 if and only if its p-value corrected by
    `correct_by_holm` is below alpha.
    """
    levels, share, goes_on = [0.0] * len(p), alpha, True
    for rank, index in enumerate(sorted(range(len(p)), key=lambda index: p[index])):
        if goes_on:
            share = alpha / (len(p) - rank)
            goes_on = p[index] < share
        levels[index] = 1 - share
    return levels
