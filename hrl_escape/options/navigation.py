"""Collision-free paths for the base, planned by OMPL in the plane: the robot strafes, so headings come later.

A path planner is a function from a `PathProblem` to places to go through. Every planner of
OMPL that works in a plane is here by its own name, roadmaps are kept per room, and strangers
register theirs. What a planner returns is believed only after an exact check. The only
module that imports ompl.
"""

from __future__ import annotations

import heapq
import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ompl import base, geometric, util

from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import EscapeError, GoalError, PathPlannerError
from hrl_escape.options.collision import CollisionMap
from hrl_escape.options.goals import Goal, PressGoal
from hrl_escape.options.lattice.areas import compute_area, sample_places
from hrl_escape.options.paths import (
    CHECKER_CALLS,
    TIME_LIMIT,
    PathPlanner,
    PathProblem,
    PathResult,
    PlannerFactory,
    Spent,
    Status,
    compute_spacing,
    get_factory,
    list_planners,
    register_planner,
)

__all__ = ["DEFAULT_PLANNER", "Navigator", "PathPlanner", "PathProblem", "PathResult", "list_planners",
           "register_planner"]

DEFAULT_PLANNER = "RRTConnect"
REFINING_CALLS = (5_000, 20_000, 80_000, 320_000)
"""Checker calls after which planners that go on improving are asked whether they have a path."""
MOST_GOALS = 24
MILESTONES = (200, 800, 3200)
MOST_ROADMAPS = 16
NEIGHBOURS = 8

util.setLogLevel(util.LogLevel.LOG_NONE)

class Navigator:
    """Plans paths in one room, with any registered planner. Not thread-safe; pickling keeps the room only.

    Attributes:
        instance: the room.
    """

    def __init__(self, instance: RoomInstance) -> None:
        self.instance = instance
        self._maps: dict[bool, CollisionMap] = {}
        self._planners: dict[tuple[str, bool], PathPlanner] = {}

    def __reduce__(self) -> tuple[type, tuple]:
        return type(self), (self.instance,)

    def get_collision(self, door_shut: bool) -> CollisionMap:
        """The room's clearances with its exit door shut or open."""
        shut = door_shut and self.instance.door is not None
        if shut not in self._maps:
            self._maps[shut] = CollisionMap(self.instance, door_shut=shut)
        return self._maps[shut]

    def plan(self, start: tuple[float, float], goal: Goal | NDArray[np.float64], planner: str | None = None, *,
             seed: int = 0, time_limit: float = TIME_LIMIT, budget: int = CHECKER_CALLS,
             door_shut: bool = True) -> PathResult:
        """Plan a path for the body's axis.

        Args:
            start: where to begin, m.
            goal: what to reach (a press means anywhere from which the body touches the target), or places
                (n, 2) of which any will do.
            planner: one of `list_planners()`; `DEFAULT_PLANNER` if None.
            seed: the same seed gives the same path, in any process.
            time_limit: wall-clock guard, s. It stops any planner from inside its checker.
            budget: checker calls, the reproducible limit.
            door_shut: whether the exit door, if there is one, stands.

        Raises:
            UnknownNameError: no planner of that name.
            GoalError: a press by hand, or no such target.
            UnsupportedError: the goal is a push.
            PathPlannerError: the planner failed, or returned no path.
        """
        planner = planner or DEFAULT_PLANNER
        factory = get_factory(planner)
        began = time.perf_counter()
        collision = self.get_collision(door_shut)
        status, places = self._find_goals(collision, start, goal)
        calls, path = 0, np.zeros((0, 2))
        if status is None:
            status, path, calls = self._solve(collision, start, places, planner, factory, seed, time_limit, budget)
        cost = float(np.hypot(*np.diff(path, axis=0).T).sum()) if len(path) else math.inf
        return PathResult(status, path, cost, planner, time.perf_counter() - began, calls)

    def _find_goals(self, collision: CollisionMap, start: tuple[float, float],
                    goal: Goal | NDArray[np.float64]) -> tuple[Status | None, NDArray[np.float64]]:
        """Free places that will do and may be connected with the start, or the status that says why not."""
        none = np.zeros((0, 2))
        proof = None
        if isinstance(goal, np.ndarray):
            places = goal.reshape(-1, 2).astype(np.float64)
            places = places[collision.are_free(places)]
        else:
            if isinstance(goal, PressGoal) and self.instance.dynamics.press_with == "hand":
                raise GoalError("where the hand presses, give places of the base: Reacher.make_table tells which")
            area = compute_area(goal, self.instance)
            proof = collision.find_proof(*start, *area)
            places = sample_places(area, collision) if proof != "solid" else none
        if not collision.is_free(*start):
            return "invalid-start", none
        if not len(places):
            return "invalid-goal", none
        here = collision.get_parts(np.array(start))[0]
        places = places[collision.get_parts(places) == here]
        return (None, _thin(places, start)) if len(places) and proof is None else ("no-path", none)

    def _solve(
        self, collision: CollisionMap, start: tuple[float, float], places: NDArray[np.float64], name: str,
        factory: PlannerFactory, seed: int, time_limit: float, budget: int,
    ) -> tuple[Status, NDArray[np.float64], int]:
        none = np.zeros((0, 2))
        begin = _step_aside(collision, np.array(start))
        ends = [(place, aside) for place in places if (aside := _step_aside(collision, place)) is not None]
        if begin is None or not ends:
            return "timeout", none, 0
        problem = PathProblem(collision, begin, np.array([aside for _, aside in ends]), seed=seed, budget=budget,
                              time_limit=time_limit)
        key = (name, collision is self._maps.get(True))
        try:
            if key not in self._planners:
                self._planners[key] = factory(collision)
            answer = self._planners[key](problem)
        except Spent:
            return "timeout", none, problem.calls
        except EscapeError:
            raise
        except Exception as error:
            raise PathPlannerError(f"path planner {name!r} failed: {type(error).__name__}: {error}") from error
        if answer is None or not len(answer):
            return "timeout", none, problem.calls
        path = _read_path(answer, name, begin)
        away = np.hypot(*(problem.goals - path[-1]).T)
        reached = int(away.argmin())
        is_exact = bool(away[reached] <= 1e-6)
        path = np.concatenate([[start], path, [ends[reached][0]]] if is_exact else [[start], path])
        path = path[np.concatenate([[True], np.hypot(*np.diff(path, axis=0).T) > 1e-12])]
        for a, b in zip(path[:-1].tolist(), path[1:].tolist(), strict=True):
            if not collision.is_move_free(*a, *b):
                raise PathPlannerError(f"path planner {name!r} returned a path that collides between {a} and {b}")
        return "exact" if is_exact else "approximate", path, problem.calls


def _step_aside(collision: CollisionMap, place: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """A place with the clearance that motion tests need, straight from a place that may touch a wall."""
    spacing, need = compute_spacing(collision)
    x, y = place.tolist()
    if collision.is_clear(x, y, need):
        return place
    for distance in (need - collision.radius + 1e-6, 0.01, spacing / 2, spacing, 2 * spacing):
        for k in range(16):
            aside_x = x + distance * math.cos(k * math.pi / 8)
            aside_y = y + distance * math.sin(k * math.pi / 8)
            if collision.is_clear(aside_x, aside_y, need) and collision.is_move_free(x, y, aside_x, aside_y):
                return np.array([aside_x, aside_y])
    return None


def _thin(places: NDArray[np.float64], start: tuple[float, float]) -> NDArray[np.float64]:
    """At most `MOST_GOALS` places, nearest first: a third of them the nearest, the rest spread over all."""
    places = places[np.argsort(np.hypot(*(places - start).T), kind="stable")]
    if len(places) <= MOST_GOALS:
        return places
    spread = np.linspace(MOST_GOALS // 3, len(places) - 1, MOST_GOALS - MOST_GOALS // 3).astype(int)
    return places[[*range(MOST_GOALS // 3), *spread]]


def _read_path(answer: Any, name: str, start: NDArray[np.float64]) -> NDArray[np.float64]:
    try:
        path = np.array(answer, dtype=np.float64).reshape(len(answer), 2)
    except (TypeError, ValueError):
        raise PathPlannerError(f"path planner {name!r} must return places (n, 2), not {answer!r}") from None
    if not np.isfinite(path).all() or np.hypot(*(path[0] - start)) > 1e-6:
        raise PathPlannerError(f"path planner {name!r} must return finite places that begin at the start {start}")
    return path


# --- OMPL ------------------------------------------------------------------------------------


def _make_information(problem: PathProblem) -> Any:
    """A plane with its checker; `SimpleSetup` would bring both, but a planner set up with it is never freed."""
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


_PLANE = base.RealVectorStateSpace(2)
_STATE: Any = _PLANE.allocState()  # the only one: the bindings never free what they allocate


def _add_states(places: NDArray[np.float64], add: Callable[[Any], None]) -> None:
    """Hand places over to something that copies them."""
    for x, y in places.tolist():
        _STATE[0], _STATE[1] = x, y
        add(_STATE)


def _look_straight(problem: PathProblem) -> NDArray[np.float64] | None:
    """The straight way to the nearest goal that is in sight."""
    for goal in problem.goals:
        if problem.is_move_free(*problem.start.tolist(), *goal.tolist()):
            return np.stack([problem.start, goal])
    return None


class _OmplPlanner:
    """A single-query planner of OMPL: a fresh set-up and seed a query, so that queries do not depend on each other."""

    def __init__(self, kind: str) -> None:
        self._kind = kind

    def __call__(self, problem: PathProblem) -> NDArray[np.float64] | None:
        straight = _look_straight(problem)
        if straight is not None:
            return straight
        util.RNG.setSeed(problem.seed + 1)
        information = _make_information(problem)
        goals = base.GoalStates(information)
        _add_states(problem.goals, goals.addState)
        definition: Any = base.ProblemDefinition(information)
        _add_states(problem.start[None], definition.addStartState)
        definition.setGoal(goals)
        planner = getattr(geometric, self._kind)(information)
        planner.setProblemDefinition(definition)
        planner.setup()

        def stop(most: int) -> bool:
            problem.spend(1)  # some planners go round for ever without testing a place
            return problem.calls > most

        try:
            for calls in REFINING_CALLS:
                planner.solve(base.PlannerTerminationCondition(partial(stop, calls)))
                if definition.hasExactSolution():
                    break
            if definition.hasExactSolution():
                geometric.PathSimplifier(information).simplifyMax(definition.getSolutionPath())
        except Spent:
            if not definition.hasSolution():
                raise
        path = definition.getSolutionPath()
        return None if path is None else np.array([(state[0], state[1]) for state in path.getStates()])


class _Roadmap:
    """OMPL's probabilistic roadmap (Kavraki et al. 1996), grown once for a room and searched by every query.

    A query looks at roadmaps of 200, 800 and 3200 milestones in turn, each grown from nothing with the
    seed, until one connects it; so what a query finds does not depend on the queries before it.
    """

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._stages: dict[tuple[int, int], tuple[NDArray[np.float64], list[list[tuple[float, int]]], int]] = {}

    def __call__(self, problem: PathProblem) -> NDArray[np.float64] | None:
        straight = _look_straight(problem)
        if straight is not None:
            return straight
        for milestones in MILESTONES:
            places, links, calls = self._grow(problem, milestones)
            problem.spend(calls)
            path = _search_roadmap(problem, places, links)
            if path is not None:
                return _shorten(problem, path)
        return None

    def _grow(self, problem: PathProblem, milestones: int) -> tuple[NDArray[np.float64], list, int]:
        key = (problem.seed, milestones)
        if key in self._stages:
            return self._stages[key]
        before = problem.calls
        util.RNG.setSeed(problem.seed + 1)
        information = _make_information(problem)
        roadmap = getattr(geometric, self._kind)(information)
        definition = base.ProblemDefinition(information)
        _add_states(problem.goals[:1], definition.addStartState)  # growing asks for one, and leaves it out
        roadmap.setProblemDefinition(definition)
        roadmap.setup()
        roadmap.growRoadmapPtc(base.PlannerTerminationCondition(lambda: roadmap.milestoneCount() >= milestones))
        data = base.PlannerData(information)
        roadmap.getPlannerData(data)
        states: list[Any] = [data.getVertex(i).getState() for i in range(data.numVertices())]
        places = np.array([(state[0], state[1]) for state in states])
        links: list[list[tuple[float, int]]] = [[] for _ in states]
        for i in range(len(states)):
            for j in data.getEdges(i):
                length = float(np.hypot(*(places[i] - places[j])))
                links[i].append((length, j))
                links[j].append((length, i))
        calls, problem.calls = problem.calls - before, before  # charged to every query alike by the caller
        if len(self._stages) >= MOST_ROADMAPS:
            del self._stages[next(iter(self._stages))]
        self._stages[key] = places, links, calls
        return self._stages[key]


def _search_roadmap(problem: PathProblem, places: NDArray[np.float64], links: list) -> NDArray[np.float64] | None:
    """Dijkstra from the goals' nearest milestones in sight to the start's."""
    def see(place: NDArray[np.float64]) -> list[tuple[float, int]]:
        away = np.hypot(*(places - place).T)
        near = np.argsort(away, kind="stable")[:NEIGHBOURS]
        return [(float(away[i]), int(i)) for i in near if problem.is_move_free(*place.tolist(), *places[i].tolist())]

    last = dict((i, length) for length, i in see(problem.start))
    if not last:
        return None
    best: dict[int, tuple[float, int]] = {}
    queue = [(length, i, -1 - k) for k, goal in enumerate(problem.goals) for length, i in see(goal)]
    heapq.heapify(queue)
    arrivals: list[tuple[float, int]] = []
    while queue:
        length, i, before = heapq.heappop(queue)
        if i in best:
            continue
        best[i] = (length, before)
        if i in last:
            heapq.heappush(arrivals, (length + last[i], i))
        if arrivals and length >= arrivals[0][0]:
            break
        for more, j in links[i]:
            if j not in best:
                heapq.heappush(queue, (length + more, j, i))
    if not arrivals:
        return None
    path, at = [problem.start], arrivals[0][1]
    while at >= 0:
        path.append(places[at])
        at = best[at][1]
    return np.array([*path, problem.goals[-1 - at]])


def _shorten(problem: PathProblem, path: NDArray[np.float64]) -> NDArray[np.float64]:
    """Leave out places from which a later one is in sight."""
    kept, at = [0], 0
    while at < len(path) - 1:
        at = next(j for j in range(len(path) - 1, at, -1)
                  if j == at + 1 or problem.is_move_free(*path[at].tolist(), *path[j].tolist()))
        kept.append(at)
    return path[kept]


# Not AORRTC: in OMPL 2.0.1 it returns paths that do not begin at the start, and crashes when it is asked to go on.
for _kind in ("BFMT", "BITstar", "BKPIECE1", "FMT", "InformedRRTstar", "KPIECE1", "LBKPIECE1", "RRT", "RRTConnect",
              "RRTstar", "SORRTstar"):
    register_planner(_kind, lambda collision, kind=_kind: _OmplPlanner(kind))
for _kind in ("PRM", "PRMstar"):
    register_planner(_kind, lambda collision, kind=_kind: _Roadmap(kind))
