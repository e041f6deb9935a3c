"""Measures of the runs of a study: shares, trends and gains, each with an interval over runs.

Scores and shares, which are bounded, have intervals that hold where all runs agree (`inference.compute_interval`);
slopes have Student's. Differences between two agents have the test and the interval of their signs, which hold where
runs do all or nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal, TypeAlias

import numpy as np

from hrl_escape.benchmark.inference import (
    LEVEL,
    Estimate,
    Statistic,
    compare_pairs,
    compute_ends,
    cut_interval,
    draw_weights,
)
from hrl_escape.benchmark.statistics import LATE, Floats, compute_mean
from hrl_escape.errors import ComparisonError
from studies.raw import BINS, OPTIMAL_SCORE, RawRun
from studies.statistics import compute_sign_flip_p, compute_slope, cut_signs

__all__ = [
    "Measurement",
    "Results",
    "Side",
    "get_runs",
    "has_settled",
    "measure_gain",
    "measure_slope",
    "share_of_training",
]

Side: TypeAlias = Literal["above", "below"]
DRAWS = 20_000

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


@dataclass(frozen=True)
class Measurement:
    """One number a run, with its interval and its tests against a level.

    Attributes:
        values: one a run.
        statistic: of them.
        kind: `bounded` from 0 to 1, with an interval and a test that hold for any such numbers; `slope`, with Student's
            for the mean; `difference` of two paired runs, with the interval and the test of signs.
    """

    values: tuple[float, ...]
    statistic: Statistic = compute_mean
    kind: Literal["bounded", "slope", "difference"] = "bounded"

    def estimate(self, level: float = LEVEL) -> Estimate:
        """Statistic with its interval of a level; the same every time."""
        array = np.array(self.values, dtype=np.float64)
        if self.kind == "difference":
            return Estimate(float(array.mean()), *cut_signs(array, level))
        if self.kind == "slope":
            test = compare_pairs([array], level)
            return Estimate(test.difference, test.low, test.high)
        low, high = cut_interval(*self._ends, level)
        return Estimate(float(self.statistic([array])), float(low), float(high))

    def compute_p(self, level: float, side: Side) -> float:
        """One-sided p-value: chance of runs as far above (below) the level where the statistic is not so."""
        array = np.array(self.values, dtype=np.float64)
        sign = 1.0 if side == "above" else -1.0
        if self.kind == "difference":
            return compute_sign_flip_p(array - level, side)
        if self.kind == "slope":
            test = compare_pairs([sign * (array - level)])
            return test.p / 2 if test.difference > 0 else 1 - test.p / 2
        drawn = self._ends[0 if side == "above" else 1]
        return float((1 + np.sum(sign * (drawn - level) <= 1e-12)) / (1 + DRAWS))

    @cached_property
    def _ends(self) -> tuple[Floats, Floats]:
        bounds = min(0.0, *self.values), max(1.0, *self.values)
        return compute_ends(self.statistic, [np.array(self.values, dtype=np.float64)], bounds,
                            [_draw_weights(len(self.values))])


@lru_cache(maxsize=4)
def _draw_weights(count: int) -> Floats:
    """Weights of so many runs, the same every time."""
    return draw_weights(count, DRAWS, np.random.default_rng(2019))


def measure_slope(runs: Sequence[RawRun], training: bool, since: float) -> Measurement:
    """Mean slope of the score, over one budget.

    Args:
        runs: of one agent.
        training: of training episodes, exploration included; otherwise of frozen weights.
        since: share of the budget before the measurement begins.
    """

    def compute(run: RawRun) -> float:
        x, y = (run.training_at, run.training_scores) if training else (run.at, run.scores)
        return run.budget * compute_slope(x, y, since * run.budget, np.inf)

    return Measurement(tuple(map(compute, runs)), kind="slope")


def measure_gain(first: Sequence[RawRun], second: Sequence[RawRun], read: Callable[[RawRun], float] | None = None
                 ) -> Measurement:
    """Mean difference between runs with the same seed.

    Args:
        first: runs of one agent.
        second: of another.
        read: from the first, by default as from the second: mean score of training episodes, parts of a run alike.
    """
    others = {run.seed: run for run in second}
    return Measurement(tuple((read or _get_training_score)(run) - _get_training_score(others[run.seed])
                             for run in first if run.seed in others), kind="difference")


def _get_training_score(run: RawRun) -> float:
    return float(np.nanmean(run.training_scores))


def share_of_training(run: RawRun, counts: Sequence[int], bins: slice = LATE_BINS) -> float:
    """Share of training episodes that are counted, among those that ended in some twentieths; 0 if none ended."""
    return sum(counts[bins]) / max(sum(run.episodes[bins]), 1)


def has_settled(run: RawRun) -> bool:
    """Every evaluation in the last fifth was optimal."""
    return bool(np.all(run.scores[run.at >= LATE * run.budget] >= OPTIMAL_SCORE))
