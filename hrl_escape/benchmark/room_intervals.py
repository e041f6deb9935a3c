"""Intervals for unseen rooms: rooms and training seeds are both drawn at random.

An interval over seeds in one set of rooms covers other seeds in these rooms, and not other rooms. These intervals
follow the analysis of variance with random effects of rooms and seeds (Searle, Casella and McCulloch 1992), with
Satterthwaite's degrees of freedom. `tests/benchmark/test_room_intervals.py` measures their coverage by simulation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy import special  # pyright: ignore[reportMissingTypeStubs]

from hrl_escape.benchmark.inference import LEVEL, Estimate
from hrl_escape.benchmark.statistics import Floats


def compute_crossed_interval(scores: ArrayLike, level: float = LEVEL) -> Estimate:
    """Estimate the mean where every seed is tested in every room.

    The variance of the mean is (rooms' mean square + seeds' mean square - error's mean square) / number of scores, and
    at least what rooms or seeds alone explain.

    Args:
        scores: float64 (rooms, seeds).
        level: confidence of the interval.

    Returns:
        Mean and interval; infinite ends with one room. One seed gives an interval over rooms, for this seed.
    """
    table = np.asarray(scores, dtype=np.float64)
    rooms, seeds = table.shape
    mean = float(table.mean())
    if rooms < 2:
        return Estimate(mean, -math.inf, math.inf)
    if seeds < 2:
        return compute_nested_interval(list(table), level)
    by_room, by_seed = table.mean(axis=1), table.mean(axis=0)
    rest = table - by_room[:, None] - by_seed + mean
    error = float((rest**2).sum()) / ((rooms - 1) * (seeds - 1))
    squares = np.array([seeds * by_room.var(ddof=1), rooms * by_seed.var(ddof=1)])
    total = max(float(squares.sum()) - error, float(squares.max()))
    if total <= 0:
        return Estimate(mean, mean, mean)
    spread = np.array([*squares, error])
    freedom = total**2 / float(np.sum(spread**2 / [rooms - 1, seeds - 1, (rooms - 1) * (seeds - 1)]))
    return _make(mean, math.sqrt(total / table.size), freedom, level)


def compute_nested_interval(rooms: Sequence[Floats], level: float = LEVEL) -> Estimate:
    """Estimate the mean where every room, or every season, has runs of its own: an interval over their means.

    Args:
        rooms: scores (runs,) of each room; rooms have equal weights.
        level: confidence of the interval.

    Returns:
        Mean and interval; infinite ends with one room.
    """
    means = np.array([float(np.mean(room)) for room in rooms])
    mean = float(means.mean())
    if len(means) < 2:
        return Estimate(mean, -math.inf, math.inf)
    return _make(mean, float(means.std(ddof=1)) / math.sqrt(len(means)), len(means) - 1, level)


def _make(mean: float, error: float, freedom: float, level: float) -> Estimate:
    reach = float(special.stdtrit(freedom, (1 + level) / 2)) * error
    return Estimate(mean, mean - reach, mean + reach)
