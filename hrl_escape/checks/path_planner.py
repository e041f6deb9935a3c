"""Check of path planners: exact, repeatable paths that join start and goal, and timely termination."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from hrl_escape.checks.claims import Claims
from hrl_escape.env.config import ObstaclesConfig
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ContractError, PathPlannerError

if TYPE_CHECKING:
    from hrl_escape.planning.paths.navigator import Navigator
    from hrl_escape.planning.paths.problem import PathResult

Position: TypeAlias = tuple[float, float]
PROMPT = 10.0
"""Time by which a planner has to stop after its limit, s; generous for a busy machine."""


def check_path_planner(name: str, queries: int = 8, seed: int = 0) -> None:
    """Check a registered path planner in three generated rooms.

    Args:
        name: registered name of the planner.
        queries: number of queries in each room.
        seed: of the queries.

    Raises:
        ContractError: a requirement is violated.
        UnknownNameError: no planner of that name.
    """
    from hrl_escape.planning.paths.navigator import Navigator  # loads OMPL, which the other checks do without

    config = get_preset("clutter")
    reached = 0
    for number, obstacles in enumerate((0, 15, 30)):
        instance = generate(dataclasses.replace(config, obstacles=ObstaclesConfig(count=obstacles)), number)
        reached += _PlannerCheck(name, (Navigator(instance), Navigator(instance))).run(queries, seed)
    if not reached:
        raise ContractError(f"path planner {name!r}", "it finds some path", f"none in {3 * queries} queries")


class _PlannerCheck(Claims):
    """Requirements of a path planner in one room."""

    def __init__(self, name: str, navigators: tuple[Navigator, Navigator]) -> None:
        super().__init__(f"path planner {name!r}")
        self.navigators = navigators
        self.planner, self.collision = name, navigators[0].get_collision(True)

    def run(self, queries: int, seed: int) -> int:
        """Query two navigators in opposite order; returns the number of exact paths."""
        places = self.draw_places(2 * queries, np.random.default_rng(seed))
        pairs = list(zip(places[::2], places[1::2], strict=True))
        first = [self.ask(0, *pair) for pair in pairs]
        again = [self.ask(1, *pair) for pair in reversed(pairs)][::-1]
        for (start, goal), one, other in zip(pairs, first, again, strict=True):
            self.require(np.array_equal(one.path, other.path),
                         "the same problem gives the same path, independently of earlier queries", (start, goal))
            self.require(one.status in ("exact", "approximate", "not-found", "budget-exhausted"),
                         "the status fits the problem", one)
            if one.status == "exact":
                self.require(tuple(one.path[0]) == start and math.dist(one.path[-1], goal) < 1e-6,
                             "an exact path joins start and goal", one)
        hurried = self.ask(0, *pairs[0], time_limit=0.0)
        self.require(hurried.status == "timeout" and hurried.seconds < PROMPT,
                     "it lets the checker's exception through when time is up", hurried)
        return sum(result.status == "exact" for result in first)

    def ask(self, number: int, start: Position, goal: Position, time_limit: float | None = None) -> PathResult:
        try:
            return self.navigators[number].plan(start, np.array([goal]), self.planner, time_limit=time_limit)
        except PathPlannerError as error:
            raise ContractError(self.name, "it returns places that begin at the start, with free motions between "
                                "them, or None", str(error)) from error

    def draw_places(self, number: int, rng: np.random.Generator) -> list[Position]:
        """Return free positions on one connected part of the floor."""
        collision = self.collision
        points = collision.low * (1 - 2 * rng.random((50 * number, 2)))
        points = points[collision.are_free(points)]
        parts = collision.get_parts(points)
        return [(x, y) for x, y in points[parts == np.bincount(parts).argmax()][:number].tolist()]
