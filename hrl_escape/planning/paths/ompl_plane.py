"""The plane of a path problem as OMPL sees it: its space, its validity checker and its states."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ompl import base, util

from hrl_escape.planning.paths.problem import PathProblem

__all__ = ["add_states", "find_straight_path", "make_information", "set_seed"]

util.setLogLevel(util.LogLevel.LOG_NONE)


def make_information(problem: PathProblem) -> Any:
    """Make OMPL's plane and its checker; not by `SimpleSetup`, whose planners are never freed."""
    space = base.RealVectorStateSpace(2)
    bounds = base.RealVectorBounds(2)
    for k in range(2):
        bounds.setLow(k, float(problem.low[k]))
        bounds.setHigh(k, float(problem.high[k]))
    space.setBounds(bounds)
    information = base.SpaceInformation(space)

    def check(state: Any) -> bool:
        return problem.is_free(state[0], state[1])

    information.setStateValidityChecker(check)
    information.setStateValidityCheckingResolution(problem.spacing / space.getMaximumExtent())
    information.setup()
    return information


def set_seed(problem: PathProblem) -> None:
    """Seed OMPL's random numbers for one query."""
    util.RNG.setSeed(problem.seed + 1)


_PLANE = base.RealVectorStateSpace(2)
_STATE: Any = _PLANE.allocState()  # a single state: the bindings never free one


def add_states(places: NDArray[np.float64], add: Callable[[Any], None]) -> None:
    """Call a function that copies its state with each place."""
    for x, y in places.tolist():
        _STATE[0], _STATE[1] = x, y
        add(_STATE)


def find_straight_path(problem: PathProblem) -> NDArray[np.float64] | None:
    """Straight path to the nearest goal in sight; None if there is none."""
    for goal in problem.goals:
        if problem.is_move_free(*problem.start.tolist(), *goal.tolist()):
            return np.stack([problem.start, goal])
    return None
