"""What is read off the runs of a study: shares, trends and times, each with a 95 % interval over runs.

Means over runs have bootstrap intervals; shares of runs have Wilson's, which stay honest where all runs or none did.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

import numpy as np
from scipy import stats

from hrl_escape.errors import ComparisonError
from hrl_escape.experiments.statistics import LATE, Floats, compute_final, compute_interval, compute_iqm, compute_slope
from hrl_escape.experiments.studies.raw import BINS, NEAR_BEST, RawRun
from hrl_escape.experiments.summary import Estimate

__all__ = [
    "Results",
    "compute_mean",
    "estimate",
    "estimate_final",
    "estimate_gain",
    "estimate_share_of_runs",
    "estimate_slope",
    "get_runs",
    "has_escaped_by",
    "has_settled",
    "share_of_training",
]

Results: TypeAlias = Mapping[str, Sequence[RawRun]]
"""Name of a grid -> its runs."""

LATE_BINS = slice(round(LATE * BINS), BINS)


def get_runs(results: Results, grid: str, agent: str) -> list[RawRun]:
    """The runs of an agent in a grid.

    Raises:
        ComparisonError: there are none.
    """
    runs = [run for run in results[grid] if run.agent == agent]
    if not runs:
        raise ComparisonError(f"{grid} has no run of {agent}")
    return runs


def compute_mean(groups: Sequence[Floats]) -> Floats:
    """Mean over all runs."""
    return np.mean(np.concatenate(groups, axis=-1), axis=-1)


def estimate(values: Sequence[float], statistic: Callable[..., Floats] = compute_mean) -> Estimate:
    """A statistic of one number a run, with its bootstrap interval; the same every time."""
    array = np.array(values, dtype=np.float64)
    low, high = compute_interval(statistic, [array], rng=np.random.default_rng(2019))
    return Estimate(float(statistic([array])), float(low), float(high))


def estimate_share_of_runs(hits: Sequence[bool]) -> Estimate:
    """Share of runs in which something happened, with Wilson's interval."""
    result = stats.binomtest(sum(hits), len(hits))
    interval = result.proportion_ci(method="wilson")
    return Estimate(float(result.statistic), float(interval.low), float(interval.high))


def estimate_final(runs: Sequence[RawRun]) -> Estimate:
    """Interquartile mean of the score of frozen weights in the last fifth."""
    return estimate([compute_final(run.at, run.scores, run.budget) for run in runs], compute_iqm)


def estimate_slope(runs: Sequence[RawRun], training: bool, since: float) -> Estimate:
    """Mean slope of the score, over one budget.

    Args:
        runs: of one agent.
        training: of training episodes, exploration included; otherwise of frozen weights.
        since: share of the budget from which on it is measured.
    """

    def compute(run: RawRun) -> float:
        x, y = (run.training_at, run.training_scores) if training else (run.at, run.scores)
        return run.budget * compute_slope(x, y, since * run.budget, np.inf)

    return estimate([compute(run) for run in runs])


def estimate_gain(first: Sequence[RawRun], second: Sequence[RawRun]) -> Estimate:
    """Difference of the mean scores of training episodes, all parts of a run weighing the same."""

    def compute(runs: Sequence[RawRun]) -> Floats:
        return np.array([np.nanmean(run.training_scores) for run in runs])

    def differ(x: Sequence[Floats], y: Sequence[Floats]) -> Floats:
        return compute_mean(x) - compute_mean(y)

    groups = [compute(first)], [compute(second)]
    low, high = compute_interval(differ, *groups, rng=np.random.default_rng(2019))
    return Estimate(float(differ(*groups)), float(low), float(high))


def share_of_training(run: RawRun, counts: Sequence[int], bins: slice = LATE_BINS) -> float:
    """Share of training episodes that are counted, among those that ended in some twentieths; 0 if none ended."""
    return sum(counts[bins]) / max(sum(run.episodes[bins]), 1)


def has_settled(run: RawRun) -> bool:
    """Every evaluation in the last fifth was optimal."""
    return bool(np.all(run.scores[run.at >= LATE * run.budget] >= NEAR_BEST))


def has_escaped_by(run: RawRun, primitives: float) -> bool:
    """A training episode had escaped by then."""
    return run.first_escape is not None and run.first_escape <= primitives
