"""Statistics of runs: efficiency, interquartile mean, performance profile, and what sums up a learning curve.

Interquartile mean and profile are those of Agarwal et al. (2021), "Deep Reinforcement Learning at the Edge of the
Statistical Precipice". Scores come as one array a room, runs along the last axis; every statistic keeps leading
axes. Intervals and tests are in `inference.py`. Nothing here reads files.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats: TypeAlias = NDArray[np.float64]
Scores: TypeAlias = Sequence[Floats]
"""One float64 array (..., runs) a room; rooms may have different numbers of runs, at least one each."""

LEAST_RUNS = 10
"""Fewer runs than these are shown as numbers, and no sentence concludes from them."""
LATE = 0.8
"""A run is judged by its evaluations from this share of the budget on."""


def compute_score(returns: ArrayLike, worst: ArrayLike, best: ArrayLike) -> Floats:
    """Rescale returns: 0 is `worst` (never escaping), 1 is `best` (the best known). Not clipped."""
    low, high = np.asarray(worst, dtype=np.float64), np.asarray(best, dtype=np.float64)
    return (np.asarray(returns, dtype=np.float64) - low) / (high - low)


def compute_efficiency(escaped: ArrayLike, primitives: ArrayLike, fewest: ArrayLike) -> Floats:
    """Efficiency of episodes: escaped x fewest known primitives / primitives, 0 without escape. Not clipped."""
    ratio = np.asarray(fewest, dtype=np.float64) / np.maximum(np.asarray(primitives, dtype=np.float64), 1.0)
    return np.where(np.asarray(escaped, dtype=bool), ratio, 0.0)


def compute_mean_efficiency(escaped: ArrayLike, primitives: ArrayLike, fewest: ArrayLike, is_expected: bool) -> float:
    """Mean efficiency of an evaluation's episodes, at most 1.

    Each episode counts with 1 at most. Where `fewest` are expectations an episode beats them by luck, which has to make
    up for bad luck in others, so that the mean is capped and not each episode.
    """
    found = compute_efficiency(escaped, primitives, fewest)
    return float(min(found.mean(), 1.0) if is_expected else np.minimum(found, 1.0).mean())


def compute_iqm(scores: Scores, weights: Scores | None = None) -> Floats:
    """Interquartile mean, (...): the mean of the middle half of all runs of all rooms together.

    The lowest and the highest `floor(n / 4)` of n runs are left out (`scipy.stats.trim_mean`), so with fewer than four
    runs it is the mean. With weights, (..., runs) a room and adding up to 1 in each, it is the mean between the
    quartiles of the weighted runs.
    """
    pooled = np.concatenate(scores, axis=-1)
    if weights is None:
        from scipy import stats  # pyright: ignore[reportMissingTypeStubs]  # half a second that no training needs

        return np.asarray(stats.trim_mean(pooled, 0.25, axis=-1), dtype=np.float64)  # pyright: ignore[reportUnknownMemberType]
    shares = np.array([room.shape[-1] for room in scores]) / pooled.shape[-1]
    joint = np.concatenate([weight * share for weight, share in zip(weights, shares, strict=True)], axis=-1)
    order = np.broadcast_to(np.argsort(pooled, axis=-1), np.broadcast_shapes(pooled.shape, joint.shape))
    ends = np.cumsum(np.take_along_axis(np.broadcast_to(joint, order.shape), order, axis=-1), axis=-1)
    inside = np.diff(np.minimum(np.maximum(ends, 0.25), 0.75), axis=-1, prepend=0.25)
    return 2 * np.sum(inside * np.sort(pooled, axis=-1), axis=-1)


def compute_mean(scores: Scores, weights: Scores | None = None) -> Floats:
    """Mean of the rooms' means."""
    if weights is None:
        return np.mean([room.mean(axis=-1) for room in scores], axis=0)
    return np.mean([np.sum(room * weight, axis=-1) for room, weight in zip(scores, weights, strict=True)], axis=0)


def compute_profile(scores: Scores, thresholds: ArrayLike) -> Floats:
    """Performance profile, (..., thresholds): the share of runs above each threshold, rooms weighing the same."""
    levels = np.asarray(thresholds, dtype=np.float64)
    return np.mean([np.mean(room[..., np.newaxis, :] > levels[:, np.newaxis], axis=-1) for room in scores], axis=0)


def compute_area(x: ArrayLike, y: ArrayLike, end: float) -> float:
    """Mean height of a learning curve from 0 to `end` > 0: its area over `end`.

    It is linear between its points, (n,) with `x` ascending, and constant before the first and after the last.
    """
    at, values = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    grid = np.concatenate([[0.0], at[(at > 0) & (at < end)], [float(end)]])
    heights = np.interp(grid, at, values)
    return float(np.sum(np.diff(grid) * (heights[1:] + heights[:-1]) / 2) / end)


def compute_final(x: ArrayLike, y: ArrayLike, end: float) -> float:
    """Final value of a run: the mean of what was measured at `x` (n,) in the last fifth of the budget, `end`.

    A policy that is greedy in one room from one start does all or nothing; the mean over a few evaluations says whether
    it has settled, where the last one alone would leave that to luck.
    """
    return float(np.mean(np.asarray(y, dtype=np.float64)[np.asarray(x, dtype=np.float64) >= LATE * end]))


class Gap(NamedTuple):
    """Distance to the best known, in score: `options` + `learning` = 1 - score."""

    options: float  # part that no policy over the given actions can reach
    learning: float  # part that a policy over them can reach and the agent has not


def split_gap(score: float, reachable: float) -> Gap:
    """Split the distance to the best known, where any policy over the same actions may score `reachable`."""
    return Gap(1.0 - reachable, reachable - score)
