"""Statistics over few runs: interquartile mean, bootstrap intervals, probability of improvement, profiles.

The definitions are those of Agarwal et al. (2021), "Deep Reinforcement Learning at the Edge of the
Statistical Precipice", as in their library rliable. Scores come as one array a room, runs along the last
axis; every statistic keeps leading axes, so that a bootstrap is one call on resampled scores. Nothing here reads files.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats  # pyright: ignore[reportMissingTypeStubs]

__all__ = [
    "Gap",
    "Scores",
    "compute_area",
    "compute_final",
    "compute_improvement",
    "compute_interval",
    "compute_iqm",
    "compute_profile",
    "compute_score",
    "compute_slope",
    "split_gap",
]

Floats: TypeAlias = NDArray[np.float64]
Scores: TypeAlias = Sequence[Floats]
"""One float64 array (..., runs) a room; rooms may have different numbers of runs, at least one each."""

LATE = 0.8
"""A run is judged by its evaluations from this share of the budget on."""


def compute_score(returns: ArrayLike, worst: ArrayLike, best: ArrayLike) -> Floats:
    """Rescale returns: 0 is `worst` (never escaping), 1 is `best` (the best known). Not clipped."""
    low, high = np.asarray(worst, dtype=np.float64), np.asarray(best, dtype=np.float64)
    return (np.asarray(returns, dtype=np.float64) - low) / (high - low)


def compute_iqm(scores: Scores) -> Floats:
    """Interquartile mean: the mean of the middle half of all runs of all rooms together.

    The lowest and the highest `floor(n / 4)` of n runs are left out (`scipy.stats.trim_mean`), so with
    fewer than four runs it is the mean.

    Args:
        scores: (..., runs) a room.

    Returns:
        Array (...).
    """
    pooled = np.concatenate(scores, axis=-1)
    return np.asarray(stats.trim_mean(pooled, 0.25, axis=-1), dtype=np.float64)  # pyright: ignore[reportUnknownMemberType]


def compute_improvement(first: Scores, second: Scores) -> Floats:
    """Probability that a run of `first` scores above a run of `second` in the same room.

    P = mean over rooms of U / (n m), with the Mann-Whitney U = #{x > y} + #{x = y} / 2.

    Args:
        first: (..., n) a room.
        second: (..., m) a room, the same rooms.

    Returns:
        Array (...); 1/2 is no difference.
    """
    if len(first) != len(second):
        raise ValueError(f"{len(first)} rooms cannot be compared with {len(second)}")
    rooms = [_compute_room_improvement(x, y) for x, y in zip(first, second, strict=True)]
    return np.mean(rooms, axis=0)


def _compute_room_improvement(x: Floats, y: Floats) -> Floats:
    difference = x[..., :, np.newaxis] - y[..., np.newaxis, :]
    return np.mean(np.heaviside(difference, 0.5), axis=(-2, -1))


def compute_profile(scores: Scores, thresholds: ArrayLike) -> Floats:
    """Performance profile: the share of runs that score above each threshold, rooms weighing the same.

    Args:
        scores: (..., runs) a room.
        thresholds: (n,).

    Returns:
        Array (..., n).
    """
    levels = np.asarray(thresholds, dtype=np.float64)
    return np.mean([np.mean(room[..., np.newaxis, :] > levels[:, np.newaxis], axis=-1) for room in scores], axis=0)


def compute_interval(
    statistic: Callable[..., Floats],
    *groups: Scores,
    rng: np.random.Generator,
    resamples: int = 5_000,
    level: float = 0.95,
) -> tuple[Floats, Floats]:
    """Percentile interval of a statistic by stratified bootstrap: runs are drawn anew within each room.

    Args:
        statistic: of as many groups as are given; keeps leading axes, as the statistics here do.
        *groups: scores (runs,) a room; drawn independently of each other.
        rng: where the draws come from.
        resamples: number of draws.
        level: share of the bootstrap distribution between the two ends.

    Returns:
        Lower and upper end, each of the statistic's own shape.
    """
    drawn = [[_resample(room, resamples, rng) for room in group] for group in groups]
    ends = np.quantile(statistic(*drawn), [(1 - level) / 2, (1 + level) / 2], axis=0)
    return ends[0], ends[1]


def _resample(runs: Floats, resamples: int, rng: np.random.Generator) -> Floats:
    """Array (resamples, ..., runs): runs drawn with replacement, leading axes kept together."""
    chosen = runs[..., rng.integers(runs.shape[-1], size=(resamples, runs.shape[-1]))]
    return np.moveaxis(chosen, -2, 0)


def compute_area(x: ArrayLike, y: ArrayLike, end: float) -> float:
    """Mean height of a learning curve from 0 to `end`: its area over `end`.

    Args:
        x: (n,) where it was measured, ascending.
        y: (n,) the values; linear in between, constant before the first and after the last.
        end: where to stop, above 0.
    """
    at, values = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    grid = np.concatenate([[0.0], at[(at > 0) & (at < end)], [float(end)]])
    heights = np.interp(grid, at, values)
    return float(np.sum(np.diff(grid) * (heights[1:] + heights[:-1]) / 2) / end)


def compute_final(x: ArrayLike, y: ArrayLike, end: float) -> float:
    """What a run comes to: the mean of its evaluations in the last fifth of the budget.

    A policy that is greedy in one room from one start does all or nothing; the mean over a few
    evaluations says whether it has settled, where the last one alone would leave that to luck.

    Args:
        x: (n,) when each evaluation was made; the last at `end` or after.
        y: (n,) what was measured.
        end: the budget, in units of `x`.
    """
    return float(np.mean(np.asarray(y, dtype=np.float64)[np.asarray(x, dtype=np.float64) >= LATE * end]))


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


class Gap(NamedTuple):
    """What is missing to the best known return, in score: `options` + `learning` = 1 - score.

    Attributes:
        options: what no policy over the given actions can reach.
        learning: what a policy over them could reach and the agent has not.
    """

    options: float
    learning: float


def split_gap(score: float, reachable: float) -> Gap:
    """Split what is missing.

    Args:
        score: the agent's.
        reachable: the best known score of any policy over the same actions.
    """
    return Gap(1.0 - reachable, reachable - score)
