"""What path planners are asked and what they answer, and the planners known by name.

A path planner is a function from a `PathProblem` to places to go through; a factory makes one
for a room. OMPL's are registered in `navigation.py`, which also checks every answer.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hrl_escape.errors import PathPlannerError, UnknownNameError
from hrl_escape.options.collision import CollisionMap

__all__ = ["CHECKER_CALLS", "TIME_LIMIT", "PathPlanner", "PathProblem", "PathResult", "PlannerFactory", "Spent",
           "Status", "compute_spacing", "get_factory", "list_planners", "register_planner"]

TIME_LIMIT = 60.0
"""Wall-clock guard, s, so late that it tells of a planner that hangs and not of a busy machine."""
CHECKER_CALLS = 200_000
"""What really limits planners: the same on any machine."""
SPACING = 0.1

Status: TypeAlias = Literal["exact", "approximate", "timeout", "no-path", "invalid-start", "invalid-goal"]


@dataclasses.dataclass(frozen=True)
class PathResult:
    """A path for the body's axis, or why there is none.

    Attributes:
        status: `exact`: collision-free from start to goal; `approximate`: collision-free, ends short of the
            goal; `timeout`: time or checker calls were used up; `no-path`: there is proof that none exists;
            `invalid-start` or `invalid-goal`: the body does not fit there.
        path: places gone through in straight lines, start first, shape (n, 2), m; empty without a path.
        cost: its length, m; infinity without a path.
        planner: who planned it.
        seconds: wall time.
        checker_calls: how many places were tested; a motion tested exactly counts as ten, and a round of a
            planner's own loop as one.
    """

    status: Status
    path: NDArray[np.float64]
    cost: float
    planner: str
    seconds: float
    checker_calls: int


class Spent(Exception):
    """Time or checker calls are used up; goes through OMPL and stops it."""


class PathProblem:
    """What a path planner is asked, and how it may test places.

    Attributes:
        start: where to begin, shape (2,), m.
        goals: places of which any will do, shape (n, 2), m; the nearest to the start comes first.
        low: corner of the floor, shape (2,), m.
        high: opposite corner, shape (2,), m.
        spacing: a motion is free if places on it at most this far apart are free, m.
        seed: for all randomness.
        calls: places tested so far.
    """

    def __init__(self, collision: CollisionMap, start: NDArray[np.float64], goals: NDArray[np.float64], *,
                 seed: int = 0, budget: int = CHECKER_CALLS, time_limit: float = TIME_LIMIT) -> None:
        """State a problem; see the attributes and `Navigator.plan`."""
        self.start, self.goals, self.seed, self.calls = start, goals, seed, 0
        self.low = collision.low
        self.high = collision.low + collision.resolution * np.array(collision.distance.shape)
        self.spacing, self._need = compute_spacing(collision)
        self._collision, self._budget = collision, budget
        self._give_up = time.perf_counter() + time_limit

    def is_free(self, x: float, y: float) -> bool:
        """Say whether the body fits at a place, with what it takes to test motions at `spacing`.

        Raises an exception that a planner must let through once time or calls are used up.
        """
        self.spend(1)
        return self._collision.is_clear(x, y, self._need)

    def is_move_free(self, x: float, y: float, to_x: float, to_y: float) -> bool:
        """Say exactly whether the body can go straight between two places."""
        self.spend(10)
        return self._collision.is_move_free(x, y, to_x, to_y)

    def spend(self, calls: int) -> None:
        """Count checker calls."""
        self.calls += calls
        if self.calls > self._budget or time.perf_counter() > self._give_up:
            raise Spent


def compute_spacing(collision: CollisionMap) -> tuple[float, float]:
    """Spacing of tests on a motion, and the clearance they need so that all between is free.

    Of two places `s` apart that are both `d` from a point, the middle is at least
    sqrt(d^2 - s^2 / 4) from it (parallelogram law).
    """
    spacing = min(SPACING, collision.radius / 5)
    return spacing, math.sqrt(collision.radius**2 + spacing**2 / 4)


PathPlanner: TypeAlias = Callable[[PathProblem], "Sequence[Sequence[float]] | NDArray[np.float64] | None"]
"""Returns places to go through, start first, or None. What ends short of every goal counts as approximate."""

PlannerFactory: TypeAlias = Callable[[CollisionMap], PathPlanner]
"""Makes a planner for one room; what it works out there it may keep for later queries."""

_FACTORIES: dict[str, PlannerFactory] = {}


def register_planner(name: str, factory: PlannerFactory) -> None:
    """Make a path planner known by a name; try it with `hrl_escape.checks.check_planner` first.

    Args:
        name: unused so far.
        factory: called once for each room and door, with its `CollisionMap`; returns the planner. The
            same problem must give the same path, whatever was asked before.

    Raises:
        PathPlannerError: another planner has that name.
    """
    if _FACTORIES.setdefault(name, factory) is not factory:
        raise PathPlannerError(f"a path planner named {name!r} is registered already; choose another name")


def list_planners() -> tuple[str, ...]:
    """Names of all path planners, OMPL's and registered ones."""
    return tuple(sorted(_FACTORIES))


def get_factory(name: str) -> PlannerFactory:
    """The factory registered under a name.

    Raises:
        UnknownNameError: there is none.
    """
    if name not in _FACTORIES:
        raise UnknownNameError("path planner", name, _FACTORIES)
    return _FACTORIES[name]
