"""OMPL's single-query planners, each under its own name: every query is planned from nothing."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ompl import base, geometric

from hrl_escape.planning.paths.ompl_plane import add_states, find_straight_path, make_information, set_seed
from hrl_escape.planning.paths.problem import PathProblem, Spent

__all__ = ["ANYTIME", "SINGLE_QUERY_PLANNERS", "SingleQueryPlanner"]

# Not AORRTC: in OMPL 2.0.1 it returns paths that do not begin at the start, and crashes when asked to continue.
SINGLE_QUERY_PLANNERS = ("BFMT", "BITstar", "BKPIECE1", "FMT", "InformedRRTstar", "KPIECE1", "LBKPIECE1", "RRT",
                         "RRTConnect", "RRTstar", "SORRTstar")
ANYTIME = ("BITstar", "InformedRRTstar", "RRTstar", "SORRTstar")
"""Planners whose paths become shorter the longer they search."""
STAGES = (5_000, 10_000, 20_000, 40_000, 80_000, 160_000, 320_000)
"""Checker calls after which an anytime planner is asked for its path."""


class SingleQueryPlanner:
    """Single-query planner of OMPL; set up and seeded afresh each time, so that queries are independent.

    A planner of `ANYTIME` stops at the first stage that has a path, or, if the problem says `optimise`,
    goes on until the budget is spent and returns the shortest path of all stages. The others have the
    whole budget for their only path: BFMT, interrupted, cannot go on.
    """

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._stages = STAGES if kind in ANYTIME else ()

    def __call__(self, problem: PathProblem) -> NDArray[np.float64] | None:
        """Find a path, shape (n, 2), m, or None."""
        straight = find_straight_path(problem)
        if straight is not None:
            return straight
        set_seed(problem)
        information = make_information(problem)
        goals = base.GoalStates(information)
        add_states(problem.goals, goals.addState)
        definition: Any = base.ProblemDefinition(information)
        add_states(problem.start[None], definition.addStartState)
        definition.setGoal(goals)
        planner = getattr(geometric, self._kind)(information)
        planner.setProblemDefinition(definition)
        planner.setup()

        def stop(most: float) -> bool:
            problem.spend(1)  # some planners loop for ever without testing a place
            return problem.calls > most

        shortest: NDArray[np.float64] | None = None
        try:
            for calls in (*self._stages, math.inf):
                planner.solve(base.PlannerTerminationCondition(partial(stop, calls)))
                if definition.hasExactSolution():
                    shortest = _choose_shorter(shortest, _read_path(definition))
                    geometric.PathSimplifier(information).simplifyMax(definition.getSolutionPath())
                    shortest = _choose_shorter(shortest, _read_path(definition))
                    if not (problem.optimise and self._stages):
                        return shortest
        except Spent:
            if not definition.hasSolution():
                raise
            if definition.hasExactSolution():
                shortest = _choose_shorter(shortest, _read_path(definition))
        return _read_path(definition) if shortest is None else shortest


def _read_path(definition: Any) -> NDArray[np.float64] | None:
    path = definition.getSolutionPath()
    return None if path is None else np.array([(state[0], state[1]) for state in path.getStates()])


def _choose_shorter(one: NDArray[np.float64] | None, other: NDArray[np.float64] | None) -> NDArray[np.float64] | None:
    """The shorter of two paths."""
    known = [path for path in (one, other) if path is not None]
    return min(known, key=lambda path: float(np.hypot(*np.diff(path, axis=0).T).sum()), default=None)
