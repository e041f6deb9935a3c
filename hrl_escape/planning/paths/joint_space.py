"""Collision-free paths through a box of coordinates by OMPL: joint angles, or the base's place and joint angles.

Knows no robot: coordinates come scaled to metres of motion, and the caller tests one place. A path is
shortened and returned only where all places along it, `spacing` apart, are free.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ompl import base, geometric, util

from hrl_escape.clock import NO_LIMIT, Clock
from hrl_escape.planning.paths.problem import Spent
from hrl_escape.planning.paths.single_query import ANYTIME, SINGLE_QUERY_PLANNERS

__all__ = ["find_joint_path"]


def find_joint_path(low: NDArray[np.float64], high: NDArray[np.float64], start: NDArray[np.float64],
                    goals: NDArray[np.float64], is_free: Callable[[NDArray[np.float64]], bool], spacing: float, *,
                    planner: str = "RRTConnect", seed: int = 0, budget: int = 100_000, clock: Clock = NO_LIMIT
                    ) -> tuple[NDArray[np.float64] | None, int]:
    """Find a path from a start to any of some goals.

    Args:
        low: least coordinates, shape (n,).
        high: largest coordinates, shape (n,).
        start: first place, shape (n,).
        goals: places of which any will do, shape (m, n).
        is_free: tests one place.
        spacing: distance between tested places of a motion.
        planner: one of OMPL's single-query planners.
        seed: the same seed gives the same path.
        budget: places that may be tested.
        clock: time limit.

    Returns:
        Places to go through in straight lines, shape (k, n), or None; and the number of places tested.

    Raises:
        OutOfTime: the clock has run out before there was a path.
    """
    assert planner in SINGLE_QUERY_PLANNERS
    dimensions, calls = len(low), 0
    space = base.RealVectorStateSpace(dimensions)
    bounds = base.RealVectorBounds(dimensions)
    for k in range(dimensions):
        bounds.setLow(k, float(low[k]))
        bounds.setHigh(k, float(high[k]))
    space.setBounds(bounds)
    information: Any = base.SpaceInformation(space)

    def check(state: Any) -> bool:
        nonlocal calls
        calls += 1
        if calls > budget or clock.is_up():
            raise Spent
        return bool(is_free(np.array([state[k] for k in range(dimensions)])))

    information.setStateValidityChecker(check)
    information.setStateValidityCheckingResolution(spacing / space.getMaximumExtent())
    information.setup()
    util.RNG.setSeed(seed + 1)
    _, scratch = _get_scratch(dimensions)

    def write(place: NDArray[np.float64], add: Callable[[Any], None]) -> None:
        for k in range(dimensions):
            scratch[k] = float(place[k])
        add(scratch)

    definition: Any = base.ProblemDefinition(information)
    wanted = base.GoalStates(information)
    for goal in goals:
        write(goal, wanted.addState)
    write(start, definition.addStartState)
    definition.setGoal(wanted)
    search = getattr(geometric, planner)(information)
    search.setProblemDefinition(definition)
    search.setup()

    def stop(most: float) -> bool:
        return calls > most

    try:
        for most in (budget / 4, budget / 2, math.inf) if planner in ANYTIME else (math.inf,):
            search.solve(base.PlannerTerminationCondition(partial(stop, most)))
            if definition.hasExactSolution():
                geometric.PathSimplifier(information).simplifyMax(definition.getSolutionPath())
                break
    except Spent:
        if not definition.hasExactSolution():
            clock.check()
    if not definition.hasExactSolution():
        return None, calls
    states = definition.getSolutionPath().getStates()
    return np.array([[state[k] for k in range(dimensions)] for state in states]), calls


@lru_cache
def _get_scratch(dimensions: int) -> tuple[Any, Any]:
    """Space and state of a dimension, allocated once: the bindings never free a state."""
    space = base.RealVectorStateSpace(dimensions)
    return space, space.allocState()
