"""Planned runs of the scaling study: those that were run, and those whose failure with fewer buttons spared them.

An agent that never escaped with fewer buttons (same graph, rule and run) does not run with more. Left out, such runs
would make averages of the survivors alone; here they count as waiting in vain for the whole budget. A run that was not
begun because the study's time was up says nothing and is left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from studies.scaling.results import ScalingRun
from studies.statistics import compute_restricted_mean

__all__ = ["FollowedRuns", "Pick", "count_spared", "follow_runs"]

Pick = Callable[[ScalingRun], int | None]
"""Primitives until an event in a run; None without it."""


@dataclass(frozen=True)
class FollowedRuns:
    """Times of an event over planned runs, censored at the budget.

    Attributes:
        times: of each run, primitives.
        observed: whether the event came, run by run.
        budget: of a run, primitives.
    """

    times: tuple[int, ...]
    observed: tuple[bool, ...]
    budget: int

    @property
    def restricted_mean(self) -> float:
        """Mean primitives to the event, at most the budget: the area under the Kaplan-Meier curve."""
        return compute_restricted_mean(self.times, self.observed, self.budget)

    @property
    def median(self) -> float | None:
        """Time until the Kaplan-Meier curve falls to one half; None if it does not within the budget."""
        runs = zip(self.times, self.observed, strict=True)
        middle = sorted(time if seen else math.inf for time, seen in runs)[(len(self.times) - 1) // 2]
        return float(middle) if math.isfinite(middle) else None

    def __str__(self) -> str:
        return f"{sum(self.observed)} of {len(self.times)}; {self.restricted_mean:,.0f}"


def follow_runs(own: Sequence[ScalingRun], spared: int, budget: int, pick: Pick) -> FollowedRuns | None:
    """Times of an event over runs of one agent.

    Args:
        own: those that were run.
        spared: how many more were not, because the agent failed with fewer buttons.
        budget: of a run, primitives; the last option of a run may go beyond it.
        pick: the event.

    Returns:
        None where no run was planned.
    """
    at = [pick(run) for run in own]
    if not at and not spared:
        return None
    times = [budget if time is None else min(time, budget) for time in at] + [budget] * spared
    return FollowedRuns(tuple(times), tuple(time is not None for time in at) + (False,) * spared, budget)


def count_spared(results: Sequence[ScalingRun], rule: str, agent: str, buttons: int) -> int:
    """Runs that were not begun with so many buttons because the agent never escaped with fewer."""
    own = [run for run in results if (run.rule, run.agent) == (rule, agent)]
    tried = {(run.graph, run.run) for run in own if run.buttons == buttons}
    failed = {(run.graph, run.run) for run in own if run.buttons < buttons and run.first_escape is None}
    return len(failed - tried)
