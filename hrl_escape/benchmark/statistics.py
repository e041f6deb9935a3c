"""Statistics of runs: efficiency, interquartile mean, performance profile and summaries of learning curves.

Interquartile mean and profile follow Agarwal et al. (2021), "Deep Reinforcement Learning at the Edge of the Statistical
Precipice". Scores are one array for each room, with runs along the last axis. Statistics keep leading axes.
`inference.py` computes intervals and tests.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats: TypeAlias = NDArray[np.float64]
Scores: TypeAlias = Sequence[Floats]
"""One float64 array (..., runs) for each room; rooms can have different numbers of runs, at least one."""

LEAST_RUNS = 10
"""Smallest number of runs for a conclusion."""
LATE = 0.8
"""Share of the budget; later evaluations count for the final value."""


def compute_score(returns: ArrayLike, worst: ArrayLike, best: ArrayLike) -> Floats:
    """Rescale returns to 0 at `worst` (no escape) and 1 at `best` (best known), without clipping."""
    low, high = np.asarray(worst, dtype=np.float64), np.asarray(best, dtype=np.float64)
    return (np.asarray(returns, dtype=np.float64) - low) / (high - low)


def compute_efficiency(escaped: ArrayLike, primitives: ArrayLike, fewest: ArrayLike) -> Floats:
    """Compute the efficiency of episodes: success x fewest known primitives / primitives, without clipping."""
    ratio = np.asarray(fewest, dtype=np.float64) / np.maximum(np.asarray(primitives, dtype=np.float64), 1.0)
    return np.where(np.asarray(escaped, dtype=bool), ratio, 0.0)


def compute_mean_efficiency(escaped: ArrayLike, primitives: ArrayLike, fewest: ArrayLike, is_expected: bool) -> float:
    """Compute the mean efficiency of episodes, at most 1.

    Each episode is clipped at 1. If `fewest` are expectations, episodes above 1 compensate for those below, so only the
    mean is clipped.
    """
    found = compute_efficiency(escaped, primitives, fewest)
    return float(min(found.mean(), 1.0) if is_expected else np.minimum(found, 1.0).mean())


def compute_iqm(scores: Scores, weights: Scores | None = None) -> Floats:
    """Compute the interquartile mean, (...), over the runs of all rooms.

    The lowest and highest `floor(n / 4)` of n runs are trimmed (`scipy.stats.trim_mean`); below four runs it is the
    mean. With weights, (..., runs) for each room with sum 1, it is the mean between the weighted quartiles.
    """
    pooled = np.concatenate(scores, axis=-1)
    if weights is None:
        from scipy import stats  # pyright: ignore[reportMissingTypeStubs]  # takes half a second to import

        return np.asarray(stats.trim_mean(pooled, 0.25, axis=-1), dtype=np.float64)  # pyright: ignore[reportUnknownMemberType]
    shares = np.array([room.shape[-1] for room in scores]) / pooled.shape[-1]
    joint = np.concatenate([weight * share for weight, share in zip(weights, shares, strict=True)], axis=-1)
    order = np.broadcast_to(np.argsort(pooled, axis=-1), np.broadcast_shapes(pooled.shape, joint.shape))
    ends = np.cumsum(np.take_along_axis(np.broadcast_to(joint, order.shape), order, axis=-1), axis=-1)
    inside = np.diff(np.minimum(np.maximum(ends, 0.25), 0.75), axis=-1, prepend=0.25)
    return 2 * np.sum(inside * np.sort(pooled, axis=-1), axis=-1)


def compute_mean(scores: Scores, weights: Scores | None = None) -> Floats:
    """Compute the mean of the rooms' means."""
    if weights is None:
        return np.mean([room.mean(axis=-1) for room in scores], axis=0)
    return np.mean([np.sum(room * weight, axis=-1) for room, weight in zip(scores, weights, strict=True)], axis=0)


def compute_profile(scores: Scores, thresholds: ArrayLike) -> Floats:
    """Compute the performance profile, (..., thresholds): share of runs above each threshold, equal room weights."""
    levels = np.asarray(thresholds, dtype=np.float64)
    return np.mean([np.mean(room[..., np.newaxis, :] > levels[:, np.newaxis], axis=-1) for room in scores], axis=0)


def compute_area(x: ArrayLike, y: ArrayLike, end: float) -> float:
    """Compute the mean height of a learning curve from 0 to `end`: its area divided by `end`.

    The curve is linear between its points, (n,) with `x` ascending, and constant outside.
    """
    at, values = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    grid = np.concatenate([[0.0], at[(at > 0) & (at < end)], [float(end)]])
    heights = np.interp(grid, at, values)
    return float(np.sum(np.diff(grid) * (heights[1:] + heights[:-1]) / 2) / end)


def compute_final(x: ArrayLike, y: ArrayLike, end: float) -> float:
    """Compute the final value of a run: the mean over evaluations at `x` (n,) in the last fifth of the budget `end`.

    A greedy policy in one room with one start succeeds always or never, so a mean over several evaluations is more
    reliable than the last one.
    """
    return float(np.mean(np.asarray(y, dtype=np.float64)[np.asarray(x, dtype=np.float64) >= LATE * end]))


class Gap(NamedTuple):
    """Gap to the best known score: `options` + `learning` = 1 - score."""

    options: float  # part that is unreachable with the agent's actions
    learning: float  # reachable part that the agent has not learned


def split_gap(score: float, reachable: float) -> Gap:
    """Split the gap to the best known score; `reachable` is the best score with the agent's actions."""
    return Gap(1.0 - reachable, reachable - score)
