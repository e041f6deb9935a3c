"""Path planners by name: OMPL's planners behind one search through a box of coordinates, and registered ones.

This is the only module that imports OMPL. Every query is planned from scratch, so it depends on no earlier one. The
coordinates are places in the plane, or places, headings and joint angles scaled to metres of motion.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.errors import MissingPackageError
from hrl_escape.planning.paths.problem import CheckerBudget, PathProblem, PlannerFactory, Spent
from hrl_escape.registry import Registry

try:
    from ompl import base, geometric, util
except ImportError as missing:
    raise MissingPackageError("ompl", "Planning of paths", missing) from missing

util.setLogLevel(util.LogLevel.LOG_NONE)

# Not AORRTC: in OMPL 2.0.1 it returns paths that do not begin at the start, and crashes when asked to continue. Not the
# roadmaps, PRM and PRM*: they wait for ever for a condition that Python decides.
OMPL_PLANNERS = ("BFMT", "BITstar", "BKPIECE1", "FMT", "InformedRRTstar", "KPIECE1", "LBKPIECE1", "RRT", "RRTConnect",
                 "RRTstar", "SORRTstar")
ANYTIME = ("BITstar", "InformedRRTstar", "RRTstar", "SORRTstar")
"""Planners whose paths become shorter the longer they search."""
_STRAIGHT_GOALS = 16  # nearest goals to which a straight line is tried
STAGES = (5_000, 10_000, 20_000, 40_000, 80_000, 160_000, 320_000)
"""Numbers of checker calls that end the stages of an anytime planner in the plane."""


def register_planner(name: str, factory: PlannerFactory) -> None:
    """Register a path planner under a name. Test it with `hrl_escape.checks.check_path_planner` first.

    Args:
        name: a new name.
        factory: called once for each room and door, with its `CollisionMap`; returns the planner. Equal problems must
            give equal paths, independent of earlier queries.

    Raises:
        ConfigError: another planner has that name, or the factory is not callable.
    """
    path_planners.register(name, factory)


def list_planners() -> tuple[str, ...]:
    """Return the names of all path planners: OMPL's, registered ones and planners of installed packages."""
    return tuple(sorted(path_planners))


def find_line_path(planner: str, problem: PathProblem) -> NDArray[np.float64] | None:
    """Find a path of lines that are tested as a whole, between places where the body fits at any heading.

    Returns:
        Places to go through, (n, 2), m, from the start to one of the goals, or None if the planner gave up.

    Raises:
        Spent: the budget was used up before there was a path.
    """
    path = _find_plane_path(planner, problem, lambda begin, end: problem.is_free(end[0], end[1]) and
                            problem.is_move_free(begin[0], begin[1], end[0], end[1]))
    return None if path is None or np.abs(problem.goals - path[-1]).max(axis=1).min() > 1e-9 else path


def _find_plane_path(planner: str, problem: PathProblem, is_move_free: Callable[[Any, Any], bool] | None = None
                     ) -> NDArray[np.float64] | None:
    """Return a path in the plane, (n, 2), m, or None: straight to the nearest goal in sight, otherwise OMPL's."""
    for goal in problem.goals:
        if problem.is_move_free(*problem.start.tolist(), *goal.tolist()):
            return np.stack([problem.start, goal])
    return _search(planner, problem.low, problem.high, problem.start, problem.goals,
                   lambda state: problem.is_free(state[0], state[1]), problem.spacing, problem, problem.seed, STAGES,
                   problem.optimise, is_move_free)


path_planners: Registry[PlannerFactory] = Registry("path planner", "a function of a CollisionMap", callable)
"""Factories of path planners by name."""
for _name in OMPL_PLANNERS:
    path_planners.register(_name, lambda collision, name=_name: partial(_find_plane_path, name))


def find_joint_path(low: NDArray[np.float64], high: NDArray[np.float64], start: NDArray[np.float64],
                    goals: NDArray[np.float64], is_free: Callable[[NDArray[np.float64]], bool], spacing: float,
                    budget: CheckerBudget, *, planner: str = "RRTConnect", seed: int = 0,
                    is_move_free: Callable[[NDArray[np.float64], NDArray[np.float64]], bool] | None = None,
                    certify: Callable[[NDArray[np.float64]], bool] = lambda path: True
                    ) -> NDArray[np.float64] | None:
    """Find a path from a start to any of some goals through coordinates scaled to metres of motion.

    Args:
        low: least coordinates, (n,).
        high: largest coordinates, (n,).
        start: first place, (n,).
        goals: places, (m, n); the path ends at one of them.
        is_free: tests one place.
        spacing: distance between tested places of a motion.
        budget: maximum number of tested places, and the time limit.
        planner: one of `OMPL_PLANNERS`.
        seed: equal seeds give equal paths.
        is_move_free: tests a whole straight motion from a free place to another. The search still tests places first,
            as that is faster. If `certify` refuses its path, a second search tests every motion whole.
        certify: tests all motions of a path (k, n).

    Returns:
        Places to go through in straight lines, (k, n), or None if the planner gave up or the budget is used up.

    Raises:
        OutOfTime: the time limit passed before there was a path.
    """
    axes, stages = range(len(low)), (budget.most / 4, budget.most / 2)

    def read(state: Any) -> NDArray[np.float64]:
        return np.array([state[k] for k in axes])

    def check(state: Any) -> bool:
        budget.spend(1)
        return bool(is_free(read(state)))

    def find(test: Callable[[Any, Any], bool] | None) -> NDArray[np.float64] | None:
        path = _search(planner, low, high, start, goals, check, spacing, budget, seed, stages, is_move_free=test)
        return path if path is not None and np.abs(goals - path[-1]).max(axis=1).min() <= 1e-9 else None

    try:
        if is_move_free is None:
            path = find(None)
        else:
            nearest = np.argsort(np.linalg.norm(goals - start, axis=1), kind="stable")[:_STRAIGHT_GOALS]
            for goal in goals[nearest]:
                if is_move_free(start, goal):
                    return np.stack([start, goal])
            path = find(None)
            if path is None or not certify(path):
                path = find(lambda begin, end: is_move_free(read(begin), read(end)))
    except Spent:
        path = None
    if path is not None:
        return path
    budget.clock.check()
    return None


def _search(planner: str, low: NDArray[np.float64], high: NDArray[np.float64], start: NDArray[np.float64],
            goals: NDArray[np.float64], is_free: Callable[[Any], bool], spacing: float,
            budget: CheckerBudget, seed: int, stages: Sequence[float], optimise: bool = False,
            is_move_free: Callable[[Any, Any], bool] | None = None) -> NDArray[np.float64] | None:
    """Search by a planner of OMPL, set up and seeded afresh; its path may end short of every goal.

    A planner of `ANYTIME` stops at the first stage (checker calls) that has a path, or, to `optimise`, continues until
    the budget is spent and returns the shortest path of all stages. The others have the whole budget for their only
    path: BFMT, interrupted, cannot continue. `is_free` tests a state of OMPL and charges the budget; raises `Spent` if
    that ends before any path. Motions are tested by places on them, or whole by `is_move_free`.
    """
    information, (_, scratch) = _make_information(low, high, is_free, spacing, is_move_free), _get_scratch(len(low))

    def add(places: NDArray[np.float64], take: Callable[[Any], None]) -> None:
        for place in places.tolist():
            for k, coordinate in enumerate(place):
                scratch[k] = coordinate
            take(scratch)  # copies it

    util.RNG.setSeed(seed + 1)
    wanted = base.GoalStates(information)
    add(goals, wanted.addState)
    definition: Any = base.ProblemDefinition(information)
    add(start[None], definition.addStartState)
    definition.setGoal(wanted)
    search = getattr(geometric, planner)(information)
    search.setProblemDefinition(definition)
    search.setup()

    def stop(most: float) -> bool:
        budget.spend(1)  # some planners loop for ever without testing a place
        return budget.calls > most

    shortest: NDArray[np.float64] | None = None
    is_anytime = planner in ANYTIME
    try:
        for calls in (*(stages if is_anytime else ()), math.inf):
            search.solve(base.PlannerTerminationCondition(partial(stop, calls)))
            if definition.hasExactSolution():
                shortest = _choose_shorter(shortest, _read_path(definition, len(low)))
                geometric.PathSimplifier(information).simplifyMax(definition.getSolutionPath())
                shortest = _choose_shorter(shortest, _read_path(definition, len(low)))
                if not (optimise and is_anytime):
                    return shortest
    except Spent:
        if not definition.hasSolution():
            raise
        if definition.hasExactSolution():
            shortest = _choose_shorter(shortest, _read_path(definition, len(low)))
    return _read_path(definition, len(low)) if shortest is None else shortest


def _make_information(low: NDArray[np.float64], high: NDArray[np.float64], is_free: Callable[[Any], bool],
                      spacing: float, is_move_free: Callable[[Any, Any], bool] | None) -> Any:
    """Make OMPL's box of coordinates and its checker.

    `SimpleSetup` is not used, because its planners are never freed.
    """
    space = base.RealVectorStateSpace(len(low))
    bounds = base.RealVectorBounds(len(low))
    for k in range(len(low)):
        bounds.setLow(k, float(low[k]))
        bounds.setHigh(k, float(max(high[k], low[k] + 1e-9)))  # OMPL refuses a box without a size
    space.setBounds(bounds)
    information: Any = base.SpaceInformation(space)
    information.setStateValidityChecker(is_free)
    information.setStateValidityCheckingResolution(min(0.5, spacing / space.getMaximumExtent()))
    if is_move_free is not None:
        information.setMotionValidator(_WholeMotions(information, is_move_free))
    information.setup()
    return information


class _WholeMotions(base.MotionValidator):
    """Test of motions from one state to another whose first state has been tested."""

    def __init__(self, information: Any, is_move_free: Callable[[Any, Any], bool]) -> None:
        super().__init__(information)
        self._is_move_free = is_move_free

    def checkMotion(self, begin: Any, end: Any) -> bool:  # noqa: N802 (OMPL's name)
        return self._is_move_free(begin, end)


@lru_cache
def _get_scratch(dimensions: int) -> tuple[Any, Any]:
    """Return the space and state of a dimension, allocated once: the bindings never free a state."""
    space = base.RealVectorStateSpace(dimensions)
    return space, space.allocState()


def _read_path(definition: Any, dimensions: int) -> NDArray[np.float64] | None:
    path = definition.getSolutionPath()
    return None if path is None else np.array([[state[k] for k in range(dimensions)] for state in path.getStates()])


def _choose_shorter(one: NDArray[np.float64] | None, other: NDArray[np.float64] | None) -> NDArray[np.float64] | None:
    known = [path for path in (one, other) if path is not None]
    return min(known, key=lambda path: float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()), default=None)
