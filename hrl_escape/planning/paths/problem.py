"""Path problems and their results: the interface of every path planner.

A path planner is a function from a `PathProblem` to places to go through; a factory makes one
for a room. `planners.py` knows the planners by name, `navigator.py` checks every answer.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hrl_escape.clock import NO_LIMIT, Clock
from hrl_escape.env.robot import Robot
from hrl_escape.floor.clearance import CollisionMap

CHECKER_CALLS = 200_000
"""Default budget of a query: the limit that is the same on any machine."""
DEFAULT_PLANNER = "RRTConnect"
"""Name of the path planner that is used by default."""
SPACING = 0.1
"""Largest distance between tested places of a motion, m."""
_DIRECTIONS = 16

Status: TypeAlias = Literal["exact", "approximate", "not-found", "budget-exhausted", "timeout", "no-path",
                            "invalid-start", "invalid-goal"]


@dataclasses.dataclass(frozen=True)
class PathResult:
    """A path for the body's axis, or the reason why there is none.

    Attributes:
        status: `exact`: collision-free from start to goal; `approximate`: collision-free, ends short of the
            goal; `not-found`: the planner gave up; `budget-exhausted`: the checker calls were used up;
            `timeout`: the clock ran out; `no-path`: there is proof that none exists; `invalid-start` or
            `invalid-goal`: the body does not fit there.
        path: places gone through in straight lines, start first, shape (n, 2), m; empty without a path.
        headings: of a rectangular base at these places, turning evenly between them, shape (n,), rad; empty for a
            disc, which may turn anywhere.
        cost: its length, m; infinity without a path.
        bound: lower bound of any path's length, m: straight to the nearest place that reaches the goal.
        planner: name of the path planner.
        seconds: wall time without compilation.
        checker_calls: places tested; a motion tested exactly counts as ten, a round of a planner's own loop as one.
    """

    status: Status
    path: NDArray[np.float64]
    cost: float
    bound: float
    planner: str
    seconds: float
    checker_calls: int
    headings: NDArray[np.float64] = dataclasses.field(default_factory=lambda: np.zeros(0))


class Spent(Exception):
    """Checker calls or time are used up; goes through OMPL and stops it."""


class CheckerBudget:
    """Checker calls of one query, and its time limit: places tested, and rounds of a planner's own loop."""

    def __init__(self, most: int, clock: Clock = NO_LIMIT) -> None:
        self.most, self.clock, self.calls = most, clock, 0

    def spend(self, calls: int) -> None:
        """Charge calls; raises `Spent` once calls or time are used up."""
        self.calls += calls
        if self.calls > self.most or self.clock.is_up():
            raise Spent


class PathProblem(CheckerBudget):
    """Query of a path planner, with the tests of places that it may use.

    Attributes:
        start: first place, shape (2,), m.
        goals: alternative last places, shape (n, 2), m; the nearest to the start comes first.
        low: corner of the floor, shape (2,), m.
        high: opposite corner, shape (2,), m.
        spacing: a motion is free if places on it at most this far apart are free, m.
        seed: for all randomness.
        optimise: search for a shorter path until the budget is spent, instead of stopping at the first.
    """

    def __init__(self, collision: CollisionMap, start: NDArray[np.float64], goals: NDArray[np.float64], *,
                 seed: int = 0, optimise: bool = False, budget: int = CHECKER_CALLS, clock: Clock = NO_LIMIT) -> None:
        """State a problem; see the attributes and `Navigator.plan`."""
        super().__init__(budget, clock)
        self.start, self.goals, self.seed, self.optimise = start, goals, seed, optimise
        self.low = collision.low
        self.high = collision.low + collision.resolution * np.array(collision.distance.shape)
        self.spacing, self._need = compute_spacing(collision)
        self._collision = collision

    def is_free(self, x: float, y: float) -> bool:
        """Return whether the body fits at a place, with the clearance that tests of motions at `spacing` need.

        Once calls or time are used up it raises an exception, which a planner must let through.
        """
        self.spend(1)
        return self._collision.is_clear(x, y, self._need)

    def is_move_free(self, x: float, y: float, to_x: float, to_y: float) -> bool:
        """Return exactly whether the body can go straight between two places; a rectangle, ahead or backwards."""
        self.spend(10)
        dx, dy = to_x - x, to_y - y
        length = math.hypot(dx, dy)
        rotation = (dx / length, dy / length) if length > 0.0 else (1.0, 0.0)
        return self._collision.is_move_free(x, y, to_x, to_y, rotation)


def compute_spacing(collision: CollisionMap) -> tuple[float, float]:
    """Spacing of tests on a motion, and the clearance they need so that everything between is free.

    Of two places `s` apart that are both `d` from a point, the middle is at least
    sqrt(d^2 - s^2 / 4) from it (parallelogram law).
    """
    spacing = min(SPACING, collision.radius / 5)
    return spacing, math.sqrt(collision.radius**2 + spacing**2 / 4)


def step_aside(place: tuple[float, float], angle: float, distances: Sequence[float],
               is_clear: Callable[[float, float], bool], is_move_free: Callable[[float, float, float, float], bool]
               ) -> tuple[float, float] | None:
    """Nearest place with the clearance that tests of motions need, straight from one that may touch a wall.

    Distances, m, are tried in this order, each in 16 directions, `angle` first, rad. `is_clear` says whether a place
    has that clearance, `is_move_free` whether the base can go straight between two.
    """
    x, y = place
    if is_clear(x, y):
        return place
    for distance in distances:
        for k in range(_DIRECTIONS):
            to_x = x + distance * math.cos(angle + k * math.tau / _DIRECTIONS)
            to_y = y + distance * math.sin(angle + k * math.tau / _DIRECTIONS)
            if is_clear(to_x, to_y) and is_move_free(x, y, to_x, to_y):
                return to_x, to_y
    return None


PathPlanner: TypeAlias = Callable[[PathProblem], "Sequence[Sequence[float]] | NDArray[np.float64] | None"]
"""Returns places to go through, start first, or None. A path that ends short of every goal is approximate."""

PlannerFactory: TypeAlias = Callable[[CollisionMap], PathPlanner]
"""Makes a planner for one room, which may keep what it works out for later queries."""


@dataclasses.dataclass(frozen=True, eq=False)
class MotionPath:
    """Path through coordinates of a robot, in straight lines."""

    names: tuple[str, ...]  # of the coordinates: joints, or `x`, `y`, `heading` and joints
    points: NDArray[np.float64]  # places to go through, shape (n, coordinates), m and rad
    scale: NDArray[np.float64]
    """Largest motion of a point of the robot for each unit of a coordinate, m, shape (coordinates,)."""
    margin: float  # largest deviation from the path without a collision, in metres of motion
    planner: str  # planner that found it
    checks: int = 0  # places that were tested
    seconds: float = 0.0  # wall time
    robot: Robot | None = dataclasses.field(default=None, repr=False)
    """The robot, whose joints' limits of speed and effort then hold."""

    def interpolate(self, step: float) -> NDArray[np.float64]:
        """Points along the path at most `step` apart in every coordinate, corners included; shape (m, coordinates)."""
        points = [self.points[:1]]
        for a, b in zip(self.points, self.points[1:], strict=False):
            count = max(1, math.ceil(float(np.abs(b - a).max()) / step))
            points.append(a + (b - a) * (np.arange(1, count + 1) / count)[:, None])
        return np.concatenate(points)
