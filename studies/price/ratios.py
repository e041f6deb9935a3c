"""Ratios of two learners' costs, replicate by replicate, where some are known from one side only.

A run that did not get there within its budget cost more than it had spent. So the ratio of a flat run's cost to that of
a run over options lies between two ends, which are one where both got there. Of these ratios the median is taken, and
its interval by signs: from the second smallest of ten lower ends to the second largest of ten upper ends, whatever the
ratios' distribution.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from scipy import stats  # pyright: ignore[reportMissingTypeStubs]

from hrl_escape.comparison.inference import correct_by_holm
from hrl_escape.comparison.statistics import LEAST_RUNS
from studies.price.runs import PriceRun

__all__ = ["COSTS", "RunCost", "CostRatio", "LogRange", "Growth", "compare_costs", "correct_prices", "find_median",
           "measure_growth"]

Knowledge: TypeAlias = Literal["measured", "bound", "unknown"]
LogRange: TypeAlias = tuple[float, float]
"""Lowest and highest possible value of a natural logarithm."""


class RunCost(NamedTuple):
    """A cost of a run.

    Attributes:
        name: in tables.
        event: that ends it, as the end of "until ...".
        unit: in sentences.
        read: of a run, the cost, and True if it got there; False if it had only spent this much.
    """

    name: str
    event: str
    unit: str
    read: Callable[[PriceRun], tuple[float, bool]]


def _wait_for_efficiency(run: PriceRun) -> tuple[float, bool]:
    """At least one escape, where the untrained policy was efficient by luck."""
    return (run.primitives, False) if run.efficient_at is None else (max(run.efficient_at, run.fewest), True)


def _wait_for_escape(run: PriceRun) -> tuple[float, bool]:
    return (run.primitives, False) if run.first_escape is None else (run.first_escape, True)


def _spend_seconds(run: PriceRun) -> tuple[float, bool]:
    return max(run.seconds, 0.01), run.efficient_at is not None


COSTS = (
    RunCost("primitives to efficiency", "it is efficient", "primitives", _wait_for_efficiency),
    RunCost("primitives to the first escape", "its first escape", "primitives", _wait_for_escape),
    RunCost("processor seconds to efficiency", "it is efficient", "processor seconds", _spend_seconds),
)


class Median(NamedTuple):
    """Median of ratios over replicates.

    Attributes:
        knowledge: `measured` if the interval has both ends; `bound` if the upper one is infinite; `unknown` with fewer
            than `LEAST_RUNS` replicates, or if the lower one is 0.
        factor: the median; of a bound, the median of the lower ends.
        low: lower end of the 95 % interval.
        high: its upper end.
        p: of a median of 1, two-sided, by the test of signs; corrected once it is one of a family.
    """

    knowledge: Knowledge
    factor: float = np.nan
    low: float = 0.0
    high: float = np.inf
    p: float = 1.0


class CostRatio(NamedTuple):
    """Times that flat learners pay what learners over options pay in rooms of one size.

    Attributes:
        buttons: of the rooms.
        logs: logarithm of the ratio, by replicate.
        median: over replicates.
    """

    buttons: int
    logs: Mapping[int, LogRange]
    median: Median


class Growth(NamedTuple):
    """Growth of the factor with each button, from the fewest to the most buttons of which it can be told.

    Attributes:
        smallest: buttons at the one end.
        largest: buttons at the other.
        median: over replicates, of the factor by which each button multiplies the ratio.
    """

    smallest: int
    largest: int
    median: Median


def compare_costs(flat: Sequence[PriceRun], options: Sequence[PriceRun], cost: RunCost) -> list[CostRatio]:
    """Ratios of two learners' costs in all sizes of rooms in which both were run, the fewest buttons first."""
    sizes = sorted({run.buttons for run in flat} & {run.buttons for run in options})
    ratios = []
    for size in sizes:
        paid, others = ({run.replicate: _find_ends(run, cost) for run in runs if run.buttons == size}
                        for runs in (flat, options))
        logs = {replicate: (paid[replicate][0] - others[replicate][1], paid[replicate][1] - others[replicate][0])
                for replicate in sorted(paid.keys() & others.keys())}
        ratios.append(CostRatio(size, logs, find_median(list(logs.values()))))
    return ratios


def _find_ends(run: PriceRun, cost: RunCost) -> LogRange:
    spent, has_arrived = cost.read(run)
    return float(np.log(spent)), float(np.log(spent)) if has_arrived else np.inf


def find_median(logs: Sequence[LogRange]) -> Median:
    """Median of numbers that are known up to two ends each, with an interval by signs of 95 % or more."""
    if len(logs) < LEAST_RUNS:
        return Median("unknown")
    lower, upper = (np.sort(np.array(ends, dtype=np.float64)) for ends in zip(*logs, strict=True))
    outside = _count_outside(len(logs))
    low, high = float(np.exp(lower[outside])), float(np.exp(upper[-1 - outside]))
    agreeing = max(int(np.sum(lower > 0)), int(np.sum(upper < 0)))
    p = min(1.0, 2 * float(stats.binom.cdf(len(logs) - agreeing, len(logs), 0.5)))
    if low == 0:
        return Median("unknown", high=high, p=p)
    return Median("measured" if np.isfinite(high) else "bound", float(np.exp(np.median(lower))), low, high, p)


def correct_prices(ratios: Sequence[Sequence[CostRatio]], growths: Sequence[Growth] = ()
                   ) -> tuple[list[list[CostRatio]], list[Growth]]:
    """Correct the p-values of ratios, cost by cost, and of their growths as one family (Holm)."""
    p = iter(correct_by_holm([*(ratio.median.p for own in ratios for ratio in own),
                              *(growth.median.p for growth in growths)]))
    return ([[ratio._replace(median=ratio.median._replace(p=next(p))) for ratio in own] for own in ratios],
            [growth._replace(median=growth.median._replace(p=next(p))) for growth in growths])


def _count_outside(count: int) -> int:
    """Numbers of so many that the interval leaves out at either end: a fair coin falls so rarely in 2.5 % at most."""
    return max(int(stats.binom.ppf(0.025, count, 0.5)) - 1, 0)


def measure_growth(ratios: Sequence[CostRatio]) -> Growth:
    """Growth of the factor with each button.

    It is measured from the smallest size to the largest one with a measured factor, along the line between the two in
    each replicate; where that is one size, to the next one, of which then only a bound is known.
    """
    measured = [ratio for ratio in ratios if ratio.median.knowledge == "measured"]
    ends = [measured[0], measured[-1]] if len(measured) > 1 else [
        *measured, *(ratio for ratio in ratios if measured and ratio.buttons > measured[0].buttons)][:2]
    if len(ends) < 2:
        return Growth(0, 0, Median("unknown"))
    first, last = ends
    apart = last.buttons - first.buttons
    slopes = [((last.logs[replicate][0] - first.logs[replicate][1]) / apart,
               (last.logs[replicate][1] - first.logs[replicate][0]) / apart)
              for replicate in sorted(first.logs.keys() & last.logs.keys())]
    return Growth(first.buttons, last.buttons, find_median(slopes))
