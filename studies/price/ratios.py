"""Ratios of two learners' costs, replicate by replicate, where some are known from one side only.

A run that did not get there within its budget cost more than it had spent. So the ratio of a flat run's cost to that of
a run over options lies between two ends, which are one where both got there. Of these ratios the geometric mean is
taken; its interval and its test are by flipped signs, so both agree on whether the ratio differs from 1.
Rooms where untrained options are already efficient are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from hrl_escape.benchmark.inference import LEVEL, correct_by_holm
from hrl_escape.benchmark.statistics import LEAST_RUNS
from studies.price.runs import PriceRun
from studies.statistics import choose_holm_levels, find_lasting, list_subset_means
from studies.tables import format_short

__all__ = ["COSTS", "CostRatio", "LogRange", "RunCost", "compare_costs", "correct_prices", "find_middle",
           "is_ready", "measure_growth"]

Knowledge: TypeAlias = Literal["measured", "bound", "unknown"]
LogRange: TypeAlias = tuple[float, float]
"""Lowest and highest possible value of a natural logarithm."""


class RunCost(NamedTuple):
    """A cost of a run.

    Attributes:
        key: in numbers of the analysis.
        name: in tables.
        read: of a run, the cost, and True if it got there; False if it had only spent this much. None where the run's
            line does not hold it.
        is_of_learning: an untrained policy that is efficient already spoils it.
    """

    key: str
    name: str
    read: Callable[[PriceRun], tuple[float, bool] | None]
    is_of_learning: bool = True


def _wait_for_efficiency(run: PriceRun) -> tuple[float, bool]:
    return (run.primitives, False) if run.efficient_at is None else (max(run.efficient_at, run.fewest), True)


def _wait_for_escape(run: PriceRun) -> tuple[float, bool]:
    return (run.primitives, False) if run.first_escape is None else (max(run.first_escape, 1), True)


def _wait_for(least: float) -> Callable[[PriceRun], tuple[float, bool] | None]:
    """Wait for the first of two evaluations in a row of at least this efficiency."""
    def read(run: PriceRun) -> tuple[float, bool] | None:
        if not run.curve:
            return None
        at = find_lasting(run.curve, least)
        return (run.primitives, False) if at is None else (max(at, run.fewest), True)

    return read


def _spend_seconds(run: PriceRun) -> tuple[float, bool]:
    return max(run.seconds, 0.01), run.efficient_at is not None


COSTS = (
    RunCost("efficient", "primitives to an efficiency of 0.9", _wait_for_efficiency),
    RunCost("escape", "primitives to the first escape", _wait_for_escape, False),
    RunCost("most", "primitives to an efficiency of 0.7", _wait_for(0.7)),
    RunCost("half", "primitives to an efficiency of 0.5", _wait_for(0.5)),
    RunCost("seconds", "processor seconds to an efficiency of 0.9", _spend_seconds),
)


class Middle(NamedTuple):
    """Geometric mean of ratios over replicates.

    Attributes:
        knowledge: `measured` if the interval has both ends; `bound` if the upper one is infinite; `unknown` with fewer
            than `LEAST_RUNS` replicates, or if the lower one is 0.
        factor: the geometric mean; of a bound, the mean of the lower ends.
        low: lower end of its interval, of 95 % by itself and of a corrected level once it is one of a family.
        high: its upper end.
        p: of a mean of 1, two-sided, by flipped signs; corrected likewise.
    """

    knowledge: Knowledge
    factor: float = np.nan
    low: float = 0.0
    high: float = np.inf
    p: float = 1.0

    @property
    def mean(self) -> float:
        """The factor, as other estimates with an interval name theirs."""
        return self.factor

    def __str__(self) -> str:
        """Text of a table: `26 (19 to 36)`, `> 19 (mean at least 26)` of a bound, or `-`."""
        if self.knowledge == "unknown":
            return "-"
        if self.knowledge == "bound":
            return f"> {format_short(self.low)} (mean at least {format_short(self.factor)})"
        return f"{format_short(self.factor)} ({format_short(self.low)} to {format_short(self.high)})"


class CostRatio(NamedTuple):
    """Times that flat learners pay what learners over options pay in rooms of one size.

    Attributes:
        buttons: of the rooms.
        logs: logarithm of the ratio, by replicate.
        middle: over replicates.
        ready: replicates left out, because the untrained options are efficient there.
        is_short: the flat runs had a smaller budget here than in other sizes, so that nothing is concluded.
    """

    buttons: int
    logs: Mapping[int, LogRange]
    middle: Middle
    ready: int = 0
    is_short: bool = False


def compare_costs(flat: Sequence[PriceRun], options: Sequence[PriceRun], cost: RunCost) -> list[CostRatio]:
    """Ratios of two learners' costs in all sizes of rooms where both were run, the fewest buttons first."""
    sizes = sorted({run.buttons for run in flat} & {run.buttons for run in options})
    budgets = {size: max(run.budget for run in flat if run.buttons == size) for size in sizes}
    ratios = []
    for size in sizes:
        chosen = [run for run in options if run.buttons == size]
        ready = {run.replicate for run in chosen if cost.is_of_learning and is_ready(run)}
        paid, others = ({run.replicate: ends for run in runs if run.buttons == size and run.replicate not in ready
                         and (ends := _find_ends(run, cost)) is not None} for runs in (flat, chosen))
        logs = {replicate: (paid[replicate][0] - others[replicate][1], paid[replicate][1] - others[replicate][0])
                for replicate in sorted(paid.keys() & others.keys())}
        is_short = budgets[size] < max(budgets.values())
        ratios.append(CostRatio(size, logs, Middle("unknown") if is_short else find_middle(list(logs.values())),
                                len(ready & {run.replicate for run in flat if run.buttons == size}), is_short))
    return ratios


def is_ready(run: PriceRun) -> bool:
    """True if the untrained policy was efficient already: in such rooms random options are enough."""
    return run.efficient_at == 0


def _find_ends(run: PriceRun, cost: RunCost) -> LogRange | None:
    read = cost.read(run)
    if read is None:
        return None
    spent, has_arrived = read
    return float(np.log(spent)), float(np.log(spent)) if has_arrived else np.inf


def find_middle(logs: Sequence[LogRange], level: float = LEVEL) -> Middle:
    """Geometric mean of numbers that are known up to two ends each, with its interval and test by flipped signs.

    Ends that are not known widen the interval on their own side, and never make a p-value smaller.
    """
    if len(logs) < LEAST_RUNS:
        return Middle("unknown")
    lower, upper = (np.array(ends, dtype=np.float64) for ends in zip(*logs, strict=True))
    below, above = list_subset_means(lower), list_subset_means(upper)
    outside = int((1 - level) / 2 * (len(below) + 1))  # p is at most 1 - level beyond so many of either
    low, high = ((float(np.exp(below[outside - 1])), float(np.exp(above[-outside]))) if outside else (0.0, np.inf))
    p = 2 * min(1 + int(np.sum(below <= 0)), 1 + int(np.sum(above >= 0))) / (len(below) + 1)
    found = Middle("measured" if np.isfinite(high) else "bound", float(np.exp(lower.mean())), low, high, min(1.0, p))
    return found if low > 0 else Middle("unknown", high=high, p=min(1.0, p))


def correct_prices(ratios: Sequence[Sequence[CostRatio]], growths: Sequence[Sequence[LogRange]] = ()
                   ) -> list[list[CostRatio]]:
    """Correct p-values and intervals of ratios, cost by cost, as one family with their growths (Holm).

    What has too few replicates, or was left out, is not a part of the family.
    """
    asked = [ratio for own in ratios for ratio in own if not ratio.is_short and len(ratio.logs) >= LEAST_RUNS]
    p = [ratio.middle.p for ratio in asked] + [find_middle(own).p for own in growths if len(own) >= LEAST_RUNS]
    found = {id(ratio): find_middle(list(ratio.logs.values()), level)._replace(p=corrected)
             for ratio, level, corrected in zip(asked, choose_holm_levels(p), correct_by_holm(p), strict=False)}
    return [[ratio._replace(middle=found.get(id(ratio), ratio.middle)) for ratio in own] for own in ratios]


def measure_growth(ratios: Sequence[CostRatio]) -> list[LogRange]:
    """Logarithms of the growth of the factor with each button, a replicate each; none where it is not known.

    It is measured from the smallest size to the largest one with a measured factor, along the line between the two in
    each replicate; where that is one size, to the next one, where then only a bound is known.
    """
    measured = [ratio for ratio in ratios if ratio.middle.knowledge == "measured"]
    ends = [measured[0], measured[-1]] if len(measured) > 1 else [
        *measured, *(ratio for ratio in ratios
                     if measured and not ratio.is_short and ratio.buttons > measured[0].buttons)][:2]
    if len(ends) < 2:
        return []
    first, last = ends
    apart = last.buttons - first.buttons
    return [((last.logs[replicate][0] - first.logs[replicate][1]) / apart,
             (last.logs[replicate][1] - first.logs[replicate][0]) / apart)
            for replicate in sorted(first.logs.keys() & last.logs.keys())]
