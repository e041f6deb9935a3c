"""Statistics that only the studies need: waiting times, tests by signs, false discoveries, slopes."""

from __future__ import annotations

import itertools
import operator
from collections.abc import Sequence
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from hrl_escape.comparison.statistics import Floats

__all__ = ["compute_restricted_mean", "compute_sign_flip_p", "compute_slope", "compute_survival",
           "correct_by_benjamini_hochberg"]

MOST_SIGNS = 14
"""Differences whose signs are all tried."""


def compute_restricted_mean(times: ArrayLike, observed: ArrayLike, horizon: float) -> float:
    """Mean time to an event up to a horizon: the area under the Kaplan-Meier curve.

    Args:
        times: (n,) of the event, or until which it was waited for.
        observed: (n,) the event came.
        horizon: where to stop; after the last time the curve stays as it is.
    """
    ends, waiting = compute_survival(times, observed)
    inside = ends < horizon
    edges = np.concatenate([[0.0], ends[inside], [horizon]])
    return float(np.sum(np.diff(edges) * np.concatenate([[1.0], waiting[inside]])))


def compute_survival(times: ArrayLike, observed: ArrayLike) -> tuple[Floats, Floats]:
    """Kaplan-Meier curve: the share for which an event has not come.

    Args:
        times: (n,) of the event, or until which it was waited for.
        observed: (n,) the event came.

    Returns:
        The different times, ascending, and the share from each of them on.
    """
    at, seen = np.asarray(times, dtype=np.float64), np.asarray(observed, dtype=bool)
    ends = np.unique(at)
    falls = [1 - np.sum(seen & (at == end)) / np.sum(at >= end) for end in ends]
    return ends, np.array(list(itertools.accumulate(falls, operator.mul)), dtype=np.float64)


def compute_sign_flip_p(differences: ArrayLike, side: Literal["above", "below"]) -> float:
    """One-sided p-value of a mean above (below) 0, by the signs that symmetric differences could as well have had.

    Exact up to 14 differences, beyond that from 2^14 draws (Fisher 1935). It holds for paired differences of any
    form, where Student's t does not: of ten differences of 0 and 1 alone, six are 0.0026 to the one and 1 / 64 to the
    other.

    Args:
        differences: (n,) between runs that could change places if nothing were to be found.
        side: of 0 on which the mean is looked for.
    """
    values = np.asarray(differences, dtype=np.float64)
    sums = _list_signs(len(values)) @ (values if side == "above" else -values)
    return float(np.mean(sums >= sums[0] - 1e-9))


@lru_cache(maxsize=8)
def _list_signs(count: int) -> Floats:
    """All signs of so many numbers, (2^count, count), or drawn ones of many; those of the first row are plus."""
    if count <= MOST_SIGNS:
        return 1.0 - 2.0 * (np.arange(2**count)[:, np.newaxis] >> np.arange(count) & 1)
    signs = np.random.default_rng(2019).choice([-1.0, 1.0], size=(2**MOST_SIGNS, count))
    signs[0] = 1.0
    return signs


def correct_by_benjamini_hochberg(p: Sequence[float]) -> list[float]:
    """Adjust p-values so that of the answers below 0.05, 5 % are wrong at most on average (Benjamini, Hochberg)."""
    adjusted, least = [0.0] * len(p), 1.0
    for rank, index in reversed(list(enumerate(sorted(range(len(p)), key=lambda index: p[index]), start=1))):
        least = min(least, p[index] * len(p) / rank)
        adjusted[index] = least
    return adjusted


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
