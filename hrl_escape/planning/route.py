"""Routes to one goal, search settings, the pose that a route depends on, and the planning report."""

from __future__ import annotations

import dataclasses
import numbers
from typing import Any, NamedTuple, TypeAlias

from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import ConfigError

EFFORTS = (2, 4, 8)
"""Heuristic offsets of further searches for a shorter plan, one per step of effort."""

Pose: TypeAlias = tuple[Any, ...]


def get_pose(state: RoomState) -> Pose:
    """Return the pose that a route depends on: base, arm, and touched targets; hashable."""
    return (*state.pose, state.touching)


class Route(NamedTuple):
    """Primitives to one goal, with the poses on the way."""

    primitives: tuple[int, ...]  # actions, in order
    poses: tuple[Pose, ...]  # the pose before each primitive and the last one
    also_pressed: tuple[int, ...]  # other targets that are pressed on the way because they cannot be avoided
    expansions: int  # search nodes expanded for it
    method: str = "given"  # search that found it: `fields`, or a path planner; `given` if none did
    timed_out: bool = False  # the time limit ended its search, so a shorter route can exist


class SearchSettings(NamedTuple):
    """Settings of one search, in addition to start and goal."""

    method: str  # as in `RoomPlanner`
    budget: int  # maximum number of expanded search nodes
    seed: int = 0  # of path planners
    effort: int = 0
    """Number of further searches for a shorter plan, at most `len(EFFORTS)`; -1 takes the first plan found, which can
    be some primitives longer."""


def check_budget(budget: int) -> None:
    """Check a number of search nodes. Raises `ConfigError`."""
    if isinstance(budget, bool) or not isinstance(budget, numbers.Integral) or budget < 1:
        raise ConfigError("budget", budget, "a whole number of search nodes, at least 1")


@dataclasses.dataclass(frozen=True)
class PlanningSummary:
    """Planning of one or several decisions. It depends on the clock and on the planner's cache.

    Attributes:
        planner_seconds: wall time spent planning, s.
        planner_calls: requests for plans, cached or new.
        cache_hits: requests answered from the cache.
        replans: plans made after the state had left the last plan.
    """

    planner_seconds: float = 0.0
    planner_calls: int = 0
    cache_hits: int = 0
    replans: int = 0

    @property
    def cache_hit_rate(self) -> float:
        """Return the share of requests answered from the cache, from 0 to 1; 0 without requests."""
        return self.cache_hits / max(self.planner_calls, 1)

    def __add__(self, other: PlanningSummary) -> PlanningSummary:
        return PlanningSummary(self.planner_seconds + other.planner_seconds, self.planner_calls + other.planner_calls,
                               self.cache_hits + other.cache_hits, self.replans + other.replans)

    def __sub__(self, earlier: PlanningSummary) -> PlanningSummary:
        return PlanningSummary(
            self.planner_seconds - earlier.planner_seconds, self.planner_calls - earlier.planner_calls,
            self.cache_hits - earlier.cache_hits, self.replans - earlier.replans)


@dataclasses.dataclass
class PlanningReport:
    """Planning of one run of an option.

    Attributes:
        planner_seconds: wall time spent planning, s.
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

    def summarise(self) -> PlanningSummary:
        """Return seconds and counts, without the names."""
        return PlanningSummary(self.planner_seconds, self.planner_calls, self.cache_hits, self.replans)

    def count_since(self, earlier: PlanningReport) -> PlanningReport:
        """Return counts and seconds since an earlier report of the same run; `unavoidable` covers the whole run."""
        return PlanningReport(
            self.planner_seconds - earlier.planner_seconds, self.planner_calls - earlier.planner_calls,
            self.cache_hits - earlier.cache_hits, self.replans - earlier.replans, self.unavoidable)
