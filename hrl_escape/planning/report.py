"""`PlanningReport`: planning time and counts of one run of an option."""

from __future__ import annotations

import dataclasses

__all__ = ["PlanningReport"]


@dataclasses.dataclass
class PlanningReport:
    """Planning done on behalf of one run of an option, from its start on.

    Attributes:
        planner_seconds: wall time spent planning.
        planner_calls: requests for plans, cached or new.
        cache_hits: requests answered from the cache.
        replans: plans made after the state had left the last plan.
        unavoidable: names of targets that the plan had to press on the way.
    """

    planner_seconds: float = 0.0
    planner_calls: int = 0
    cache_hits: int = 0
    replans: int = 0
    unavoidable: tuple[str, ...] = ()

    def add(self, other: PlanningReport) -> None:
        """Add the report of a nested option."""
        self.planner_seconds += other.planner_seconds
        self.planner_calls += other.planner_calls
        self.cache_hits += other.cache_hits
        self.replans += other.replans
        self.unavoidable += other.unavoidable

    def count_since(self, earlier: PlanningReport) -> PlanningReport:
        """Counts and seconds since an earlier report of the same run; `unavoidable` stays that of the whole run."""
        return PlanningReport(
            self.planner_seconds - earlier.planner_seconds, self.planner_calls - earlier.planner_calls,
            self.cache_hits - earlier.cache_hits, self.replans - earlier.replans, self.unavoidable)
