"""A route, the settings of the search that finds it, and the part of a state that it depends on."""

from __future__ import annotations

import numbers
from typing import Any, NamedTuple, TypeAlias

from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import ConfigError

__all__ = ["Pose", "Route", "SearchSettings", "check_budget", "get_pose"]

Pose: TypeAlias = tuple[Any, ...]


def get_pose(state: RoomState) -> Pose:
    """Pose that a route depends on: base, arm, and touched targets; hashable."""
    return (*state.pose, state.touching)


class Route(NamedTuple):
    """Primitives to one goal, with the poses they lead through.

    Attributes:
        primitives: actions, in order.
        poses: the pose before each primitive and the last one.
        also_pressed: other targets that are pressed on the way because they cannot be avoided.
        expansions: search nodes expanded for it.
        method: search that found it: `fields`, or a path planner; `given` if none did.
        timed_out: the clock cut its search short; without it there may be a shorter one.
    """

    primitives: tuple[int, ...]
    poses: tuple[Pose, ...]
    also_pressed: tuple[int, ...]
    expansions: int
    method: str = "given"
    timed_out: bool = False


class SearchSettings(NamedTuple):
    """Settings of one search, beyond start and goal.

    Attributes:
        method: as in `RoomPlanner`.
        budget: search nodes that may be expanded.
        seed: of path planners.
        effort: further searches for a shorter plan, at most `len(EFFORTS)` of `primitive_search`; -1 for the first
            plan found, which may be some primitives longer.
    """

    method: str
    budget: int
    seed: int = 0
    effort: int = 0


def check_budget(budget: int) -> None:
    """Check a number of search nodes. Raises `ConfigError`."""
    if isinstance(budget, bool) or not isinstance(budget, numbers.Integral) or budget < 1:
        raise ConfigError("budget", budget, "a whole number of search nodes, at least 1")
