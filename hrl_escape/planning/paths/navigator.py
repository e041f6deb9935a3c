"""Collision-free paths for the base: the `Navigator` asks a planner of `planners.py` and checks its answer exactly.

A disc's path is one of places, as it may turn anywhere; a rectangle's one of poses, SE(2). Poses are tested with a
margin that covers all poses between two tested ones: between poses `s` apart, with headings scaled by half the diagonal
to metres, no point of the rectangle is farther than s / sqrt(2) from where it was tested.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.clock import Clock, OutOfTime
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Rules
from hrl_escape.errors import ConfigError, EscapeError, GoalError, PathPlannerError, UnsupportedError, show_value
from hrl_escape.floor.clearance import CollisionMap
from hrl_escape.kernels import read_clock
from hrl_escape.planning.areas import compute_goal_area, sample_places
from hrl_escape.planning.goals import FARTHEST, Goal, PressGoal, check_goal
from hrl_escape.planning.paths.planners import OMPL_PLANNERS, find_joint_path, path_planners
from hrl_escape.planning.paths.problem import (
    CHECKER_CALLS,
    DEFAULT_PLANNER,
    SPACING,
    CheckerBudget,
    PathPlanner,
    PathProblem,
    PathResult,
    PlannerFactory,
    Spent,
    Status,
    compute_spacing,
    step_aside,
)

MOST_GOALS = 24
POSE_PLACES = 400
"""Places of a goal where all headings of a rectangular base are tried."""


class Navigator:
    """Plans paths in one room, with any registered planner. Not thread-safe; pickling keeps the room only.

    Attributes:
        instance: the room.
    """

    def __init__(self, instance: RoomInstance, get_collision: Callable[[bool], CollisionMap] | None = None) -> None:
        self.instance = instance
        self._get_collision = get_collision
        self._maps: dict[bool, CollisionMap] = {}
        self._planners: dict[tuple[str, bool], PathPlanner] = {}

    def __reduce__(self) -> tuple[type, tuple]:
        return type(self), (self.instance,)

    def get_collision(self, door_shut: bool) -> CollisionMap:
        """The room's clearances with its exit door shut or open."""
        shut = door_shut and self.instance.door is not None
        if shut not in self._maps:
            self._maps[shut] = (self._get_collision(shut) if self._get_collision
                                else CollisionMap(self.instance, door_shut=shut))
        return self._maps[shut]

    def plan(self, start: tuple[float, float], goal: Goal | NDArray[np.float64], planner: str = DEFAULT_PLANNER, *,
             seed: int = 0, optimise: bool = False, budget: int = CHECKER_CALLS, clock: Clock | None = None,
             time_limit: float | None = None, door_shut: bool = True, heading: float = 0.0) -> PathResult:
        """Plan a path for the body's axis.

        Args:
            start: first place, m.
            goal: the goal (for a press, any place where the body touches the target), or alternative places (n, 2).
            planner: one of `list_planners()`.
            seed: the same seed gives the same path, in any process.
            optimise: search until the budget is spent and return the shortest path found, for planners that keep
                improving (`ANYTIME`); by default the first path will do.
            budget: checker calls, the reproducible limit.
            time_limit: limit of the whole call, s; it stops any planner from inside its checker. By default only
                the budget decides.
            clock: time limit of a call that this one is part of, instead of `time_limit`.
            door_shut: whether the exit door, if there is one, stands.
            heading: of a rectangular base at the start, rad; no matter for a disc.

        Raises:
            UnknownNameError: no planner of that name.
            GoalError: a press by hand, no such target, or a start or goal that is none.
            ConfigError: seed or budget is not an integer in its range.
            UnsupportedError: the goal is a push, or the planner knows no poses and the base is a rectangle.
            PathPlannerError: the planner failed, or returned no path.
        """
        factory = path_planners.get(planner)
        turns_anywhere = self.instance.robot.base.turns_anywhere
        if not turns_anywhere and planner not in OMPL_PLANNERS:
            raise UnsupportedError(f"path planner {planner!r} plans places of a disc; poses of a rectangular base are "
                                   f"planned by {', '.join(OMPL_PLANNERS)}")
        start = self._check_query(start, goal, seed, budget)
        began, clock = read_clock(), clock or Clock(time_limit)
        calls, path, bound = 0, np.zeros((0, 2)), 0.0
        try:
            collision = self.get_collision(door_shut)
            status, places = self._find_goals(collision, start, goal, clock)
            if len(places):
                bound = float(np.hypot(*(places - start).T).min())
            if status is None and not turns_anywhere:
                at = np.array([*start, heading])
                status, path, calls = self._solve_poses(collision, at, goal, places, planner, seed,
                                                        CheckerBudget(budget, clock))
            elif status is None:
                problem = partial(PathProblem, seed=seed, optimise=optimise, clock=clock, budget=budget)
                status, path, calls = self._solve(collision, start, places, planner, factory, problem)
            if status == "budget-exhausted" and clock.has_stopped:
                status = "timeout"
        except OutOfTime:
            status = "timeout"
        headings, path = path[:, 2:].ravel(), path[:, :2]
        cost = float(np.hypot(*np.diff(path, axis=0).T).sum()) if len(path) else math.inf
        return PathResult(status, path, cost, bound, planner, read_clock() - began, calls, headings)

    def _solve_poses(self, collision: CollisionMap, start: NDArray[np.float64], goal: Goal | NDArray[np.float64],
                     places: NDArray[np.float64], planner: str, seed: int, budget: CheckerBudget
                     ) -> tuple[Status, NDArray[np.float64], int]:
        """Status, poses (n, 3) and tested poses of a rectangular base's path to places of a goal."""
        x, y, heading = start.tolist()
        if not collision.does_fit(x, y, (math.cos(heading), math.sin(heading))):
            return "invalid-start", np.zeros((0, 2)), 0
        ends = self._list_poses(collision, goal, places)
        if not len(ends):
            return "invalid-goal", np.zeros((0, 2)), 0
        path = find_pose_path(collision, start, ends, planner, seed, budget)
        if path is not None:
            return "exact", path, budget.calls
        return "budget-exhausted" if budget.calls > budget.most else "not-found", np.zeros((0, 2)), budget.calls

    def _list_poses(self, collision: CollisionMap, goal: Goal | NDArray[np.float64], places: NDArray[np.float64]
                    ) -> NDArray[np.float64]:
        """Poses (n, 3) of a rectangular base that reach a goal: its places, at headings of the lattice."""
        rules, poses = Rules(self.instance), []
        for x, y in places.tolist():
            for steps in range(rules.headings):
                if collision.does_fit(x, y, rules.get_rotation(steps, 0.0)) and (
                        not isinstance(goal, PressGoal)
                        or rules.compute_touching(x, y, steps, 0.0, (), ()) >> goal.target & 1):
                    poses.append((x, y, rules.turn_step * steps))
        return np.array(poses).reshape(-1, 3)

    def _check_query(self, start: tuple[float, float], goal: Goal | NDArray[np.float64], seed: int, budget: int
                     ) -> tuple[float, float]:
        """Check a query and return its start as two numbers. Raises `GoalError`, `ConfigError`."""
        for name, value, least in (("seed", seed, 0), ("budget", budget, 1)):
            if isinstance(value, bool) or not isinstance(value, numbers.Integral) or not least <= value < 2**32:
                raise ConfigError(name, value, f"a whole number from {least} to {2**32 - 1}")
        try:
            x, y = (float(number) for number in start)
        except (TypeError, ValueError):
            x = y = math.nan
        if not max(abs(x), abs(y)) < FARTHEST:
            raise GoalError(f"a path begins at two finite numbers, not at {show_value(start)}")
        if not isinstance(goal, np.ndarray):
            check_goal(goal, self.instance)
        elif goal.dtype.kind not in "fiu" or goal.size % 2 or not (np.abs(goal) < FARTHEST).all():
            raise GoalError(f"places are finite numbers (n, 2), not {show_value(goal)}")
        return x, y

    def _find_goals(self, collision: CollisionMap, start: tuple[float, float],
                    goal: Goal | NDArray[np.float64], clock: Clock) -> tuple[Status | None, NDArray[np.float64]]:
        """Return the free places of the goal that can be connected with the start, or the status without any."""
        none = np.zeros((0, 2))
        proof = None
        if isinstance(goal, np.ndarray):
            places = goal.reshape(-1, 2).astype(np.float64)
            places = places[collision.are_free(places)]
        else:
            if isinstance(goal, PressGoal) and self.instance.dynamics.press_with == "hand":
                raise GoalError("for a press by hand give places of the base; Reacher.make_table finds them")
            area = compute_goal_area(goal, self.instance)
            proof = collision.find_proof(*start, *area)
            most = 64 if self.instance.robot.base.turns_anywhere else POSE_PLACES
            places = sample_places(area, collision, most, clock) if proof != "solid" else none
        if not collision.is_free(*start):
            return "invalid-start", none
        if not len(places):
            return "invalid-goal", none
        here = collision.get_parts(np.array(start))[0]
        places = places[collision.get_parts(places) == here]
        if not len(places) or proof is not None:
            return "no-path", none
        return None, _choose_goals(places, start) if self.instance.robot.base.turns_anywhere else places

    def _solve(self, collision: CollisionMap, start: tuple[float, float], places: NDArray[np.float64], name: str,
               factory: PlannerFactory, make_problem: Callable[..., PathProblem]
               ) -> tuple[Status, NDArray[np.float64], int]:
        none = np.zeros((0, 2))
        begin = _move_aside(collision, np.array(start))
        ends = [(place, aside) for place in places if (aside := _move_aside(collision, place)) is not None]
        if begin is None or not ends:
            return "not-found", none, 0
        problem = make_problem(collision, begin, np.array([aside for _, aside in ends]))
        key = (name, collision is self._maps.get(True))
        try:
            if key not in self._planners:
                self._planners[key] = factory(collision)
            answer = self._planners[key](problem)
        except Spent:
            return "budget-exhausted", none, problem.calls
        except EscapeError:
            raise
        except Exception as error:
            raise PathPlannerError(f"path planner {name!r} failed: {type(error).__name__}: {error}") from error
        if answer is None or not len(answer):
            return "not-found", none, problem.calls
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


def _move_aside(collision: CollisionMap, place: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Nearest place with the clearance that motion tests need, straight from a place that may touch a wall."""
    spacing, need = compute_spacing(collision)
    x, y = place.tolist()
    found = step_aside((x, y), 0.0, (need - collision.radius + 1e-6, 0.01, spacing / 2, spacing, 2 * spacing),
                       lambda x, y: collision.is_clear(x, y, need), collision.is_move_free)
    return None if found is None else np.array(found)


def _choose_goals(places: NDArray[np.float64], start: tuple[float, float]) -> NDArray[np.float64]:
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


_ASIDE = (1.0, 1.5, 2.0, 4.0)
"""Margins to leave a pose in contact before the search."""
_MOST_ENDS = 64


def find_pose_path(collision: CollisionMap, start: NDArray[np.float64], ends: NDArray[np.float64], planner: str,
                   seed: int, budget: CheckerBudget) -> NDArray[np.float64] | None:
    """Find a path of poses from a start to any of some ends.

    Args:
        collision: the room.
        start: x, y and heading, shape (3,), m and rad; the base fits there.
        ends: alternative last poses, shape (n, 3); the base fits there.
        planner: one of `OMPL_PLANNERS`.
        seed: the same seed gives the same path.
        budget: most poses to test, and the time limit.

    Returns:
        Poses to go through in straight lines while turning evenly, shape (k, 3), or None.

    Raises:
        OutOfTime: the clock has run out before there was a path.
        PathPlannerError: the path collides.
    """
    spacing = min(SPACING, collision.inner / 5)
    margin = spacing * math.sqrt(0.5)
    ends = ends[np.linspace(0, len(ends) - 1, min(len(ends), _MOST_ENDS)).astype(int)].copy()
    ends[:, 2] = start[2] + np.remainder(ends[:, 2] - start[2] + math.pi, math.tau) - math.pi
    begin = _turn_aside(collision, start, margin)
    pairs = [(end, aside) for end in ends if (aside := _turn_aside(collision, end, margin)) is not None]
    if begin is None or not pairs:
        return None
    goals = np.array([aside for _, aside in pairs])
    scale = np.array([1.0, 1.0, collision.radius])
    high = np.array([*-collision.low, start[2] + 1.5 * math.pi])
    low = np.array([*collision.low, start[2] - 1.5 * math.pi])

    def is_free(at: NDArray[np.float64]) -> bool:
        x, y, heading = (at / scale).tolist()
        return collision.does_fit(x, y, (math.cos(heading), math.sin(heading)), margin)

    path = find_joint_path(low * scale, high * scale, begin * scale, goals * scale, is_free, spacing, budget,
                           planner=planner, seed=seed)
    if path is None:
        return None
    path = path / scale
    reached = pairs[int(np.abs((goals - path[-1]) * scale).sum(axis=1).argmin())][0]
    path = np.concatenate([[start], path, [reached]])
    path = path[np.concatenate([[True], np.abs(np.diff(path, axis=0)).max(axis=1) > 1e-12])]
    _check(collision, path, scale, spacing / 4, planner)
    return path


def _turn_aside(collision: CollisionMap, pose: NDArray[np.float64], margin: float) -> NDArray[np.float64] | None:
    """Nearest pose with a margin, straight from one that may touch a wall."""
    x, y, heading = pose.tolist()
    rotation = math.cos(heading), math.sin(heading)
    place = step_aside((x, y), heading, [distance * margin + 1e-6 for distance in _ASIDE],
                       lambda x, y: collision.does_fit(x, y, rotation, margin),
                       lambda x, y, to_x, to_y: collision.is_move_free(x, y, to_x, to_y, rotation))
    return None if place is None else np.array([*place, heading])


def _check(collision: CollisionMap, path: NDArray[np.float64], scale: NDArray[np.float64], spacing: float, name: str
           ) -> None:
    """Check a path at poses a quarter as far apart as in the search. Raises `PathPlannerError`."""
    for a, b in zip(path[:-1], path[1:], strict=True):
        count = 1 + math.ceil(float(np.abs((b - a) * scale).sum()) / spacing)
        for x, y, heading in np.linspace(a, b, count).tolist():
            if not collision.does_fit(x, y, (math.cos(heading), math.sin(heading))):
                raise PathPlannerError(f"path planner {name!r} returned a path that collides between {a.tolist()} and "
                                       f"{b.tolist()}")
