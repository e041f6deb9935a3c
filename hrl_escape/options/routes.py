"""Routes: primitives from a state to one goal, found once, remembered, and checked by replay.

What options follow and plans are made of. A route is a function of state and goal alone:
remembering saves time and changes nothing. Where several goals are put in order is
`planner.py`; how one search works is `tracking.py`.
"""

from __future__ import annotations

import dataclasses
import math
import threading
import time
from collections import OrderedDict
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeAlias

from hrl_escape.env.geometry import Footprint
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.errors import PlanningFailed, PlanningReason, UnknownNameError
from hrl_escape.options.goals import ExitGoal, Goal, PressGoal, describe_goal, is_reached
from hrl_escape.options.lattice.fields import FieldMaker
from hrl_escape.options.option import OptionReport
from hrl_escape.options.tracking import METHODS, PrimitiveSearch

if TYPE_CHECKING:
    from hrl_escape.options.reaching import Reacher

__all__ = ["Pose", "Route", "RouteFinder", "get_pose", "get_prop_poses"]

REMEMBERED = 10_000
"""Routes that are kept; the least recently used go first."""

Pose: TypeAlias = tuple[Any, ...]


def get_pose(state: RoomState) -> Pose:
    """What a route depends on: base, arm, and what is touched; hashable."""
    return (*state[:6], state.touching)


def get_prop_poses(state: RoomState, instance: RoomInstance) -> list[tuple[float, float, float]]:
    """Where the props are: (x, y, yaw) each, m and rad."""
    if state.physics is None:
        return [(placed.x, placed.y, placed.yaw) for placed in instance.props]
    return [(p[0], p[1], 2.0 * math.atan2(p[5], p[6])) for p in state.physics.props]


class Route(NamedTuple):
    """Primitives to one goal, as planners and options remember them.

    Attributes:
        primitives: actions, in order.
        poses: the pose before each primitive and the last one.
        also_pressed: other targets that are pressed on the way because they must be.
        expansions: search nodes expanded for it.
    """

    primitives: tuple[int, ...]
    poses: tuple[Pose, ...]
    also_pressed: tuple[int, ...]
    expansions: int


class RouteFinder:
    """Finds routes in one room; it may be used from several threads (they wait for each other) and pickled.

    Attributes:
        instance: the room as given.
        rules: its kinematics without noise and slip, by which routes are checked.
    """

    _has_searched: ClassVar[bool] = False

    def __init__(self, instance: RoomInstance, method: str = "fields", budget: int = 300_000,
                 time_limit: float = 60.0) -> None:
        _check_method(method)
        self.instance = instance
        self.method, self.budget, self.time_limit = method, budget, time_limit
        # pressing under physics takes force: being within the margin is not enough
        margin = 0.0 if instance.dynamics.kind == "physics" else instance.dynamics.press_margin
        quiet = dataclasses.replace(instance.dynamics, noise=0.0, slip=0.0, press_margin=margin)
        self._quiet = dataclasses.replace(instance, dynamics=quiet)
        self.rules = Kinematics(self._quiet)
        self._open()

    def _open(self) -> None:
        self._search = PrimitiveSearch(self._quiet, self.rules)
        self._routes: OrderedDict[tuple[Goal, bool, Pose], Route | PlanningFailed] = OrderedDict()
        self._reasons: dict[int, str] = {}
        self._lock = threading.RLock()

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in self.__dict__.items() if k not in ("_search", "_routes", "_reasons", "_lock")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._open()

    def prepare(self) -> None:
        """Work out now what all routes in this room share, so that the first ones are as quick as later ones."""
        with self._lock:
            self._search.prepare()

    def get_fields(self, door_shut: bool) -> FieldMaker:
        """The grid on which costs to go are worked out, with the exit door shut or open."""
        with self._lock:
            return self._search.get_maker(door_shut)

    def get_reacher(self) -> Reacher:
        """What finds postures of the arm in this room."""
        with self._lock:
            return self._search.reacher

    def can_start(self, state: RoomState, goal: Goal) -> bool:
        """Say cheaply whether planning to a goal makes sense here: not there yet, and no shut door before it."""
        if isinstance(goal, ExitGoal) and self.instance.door and not self.is_solved(state):
            return False
        return isinstance(goal, PressGoal) or not is_reached(goal, state, state, self.rules)

    def find_route(self, state: RoomState, goal: Goal, report: OptionReport | None = None) -> Route:
        """Find or remember the route from a state to a goal.

        Args:
            state: where to begin.
            goal: what to reach.
            report: where to count calls, cache hits and seconds.

        Raises:
            PlanningFailed: no route; a failure is remembered like a route.
        """
        began = time.perf_counter()
        key = (goal, self.is_solved(state), get_pose(state))
        with self._lock:
            found = self._routes.get(key)
            if report is not None:
                report.planner_calls += 1
                report.cache_hits += found is not None
            if found is None:
                found = self._search_route(state, goal)
                if not (isinstance(found, PlanningFailed) and found.reason is PlanningReason.TIMEOUT):
                    self._routes[key] = found  # a time-out says more about the machine than about the room
                    if len(self._routes) > REMEMBERED:
                        self._routes.popitem(last=False)
            else:
                self._routes.move_to_end(key)
        if report is not None:
            report.planner_seconds += time.perf_counter() - began
        if isinstance(found, PlanningFailed):
            raise found.with_traceback(None)
        return found

    def find_way_round(self, state: RoomState, goal: Goal, keep_out: Sequence[Footprint], budget: int,
                       report: OptionReport, *, refine: bool = True) -> Route:
        """Find the route to a goal that keeps clear of things which move, such as blocks; it is not remembered.

        Args:
            state: where to begin.
            goal: what to reach.
            keep_out: footprints that the body must not meet.
            budget: search nodes that may be expanded.
            report: where to count calls and seconds.
            refine: look on finer grids, too, before giving up.

        Raises:
            PlanningFailed: no route within the budget.
        """
        began = time.perf_counter()
        report.planner_calls += 1
        with self._lock:
            found = self._search_route(state, goal, keep_out, budget, refine)
        report.planner_seconds += time.perf_counter() - began
        if isinstance(found, PlanningFailed):
            raise found
        return found

    def remember(self, state: RoomState, goal: Goal, primitives: Sequence[int]) -> bool:
        """Let a known way be the route to a goal from here; false if it does not lead there or presses something."""
        route = self.replay(state, primitives, goal)
        if route is None or len(route.primitives) < len(primitives) or route.also_pressed:
            return False
        with self._lock:
            self._routes.setdefault((goal, self.is_solved(state), get_pose(state)), route)
        return True

    def replay(self, state: RoomState, primitives: Sequence[int], goal: Goal) -> Route | None:
        """The route that primitives make from here, cut where the goal is reached; None if it never is."""
        poses, pressed = [get_pose(state)], 0
        here = state
        for count, primitive in enumerate(primitives, 1):
            after = self.rules.step(here, primitive).state
            poses.append(get_pose(after))
            pressed |= after.touching & ~here.touching
            if is_reached(goal, here, after, self.rules):
                others = pressed & ~(1 << goal.target) if isinstance(goal, PressGoal) else pressed
                also = tuple(i for i in range(others.bit_length()) if others >> i & 1)
                return Route(tuple(primitives[:count]), tuple(poses), also, 0)
            here = after
        return None

    def make_failure(self, reason: PlanningReason, state: RoomState, goal: Goal | None, **details: Any
                     ) -> PlanningFailed:
        """Build the error for a goal (None: the escape) that could not be planned from a state."""
        pose = (state.x, state.y, self.rules.get_heading(state))
        name = "escape" if goal is None else describe_goal(goal, self.instance)
        return PlanningFailed(reason, name, pose, **details)

    def _search_route(self, state: RoomState, goal: Goal, keep_out: Sequence[Footprint] = (),
                      budget: int | None = None, refine: bool = True) -> Route | PlanningFailed:
        begin = state._replace(primitives=0, noise_key=0, z=0.0, pitch=0.0, roll=0.0, physics=None)
        began = time.perf_counter()
        limit = self.time_limit if RouteFinder._has_searched else math.inf  # the first one may have to compile
        method, planner = (self.method, None) if self.method in METHODS else ("corridor", self.method)
        result = self._search.search(begin, goal, method=method, planner=planner, refine=refine, keep_out=keep_out,
                                     budget_expansions=budget or self.budget, deadline=limit)
        RouteFinder._has_searched = True
        if not result.is_reached:
            return self.make_failure(
                PlanningReason(result.status), state, goal, seconds=time.perf_counter() - began,
                planners=(self.method,), nearest=_describe_place(result.nearest), advice=self._explain(goal),
            )
        if not result.primitives:  # it is there already
            return Route((), (get_pose(begin),), (), 0)
        route = self.replay(begin, result.primitives, goal)
        assert route is not None, "a search must return what its own replay reaches"
        return route._replace(expansions=result.expansions)

    def _explain(self, goal: Goal) -> str:
        """Why the hand never touches a target, if that is so; asked once a target, for it can take seconds."""
        if not isinstance(goal, PressGoal) or self.instance.dynamics.press_with != "hand":
            return ""
        if goal.target not in self._reasons:
            self._reasons[goal.target] = self._search.reacher.explain(goal.target) or ""
        return self._reasons[goal.target]

    def follow(self, state: RoomState, route: Route) -> RoomState:
        """The state that a route leads to from here."""
        for primitive in route.primitives:
            state = self.rules.step(state, primitive).state
        return state

    def is_solved(self, state: RoomState) -> bool:
        """The exit is open."""
        return self.instance.puzzle.is_solved(state.puzzle)

    def has_escaped(self, state: RoomState) -> bool:
        """The exit is open and the robot stands in it."""
        return self.is_solved(state) and self.instance.exit.contains(state.x, state.y)


def _check_method(method: str) -> None:
    if method in METHODS:
        return
    from hrl_escape.options.navigation import list_planners  # loads OMPL, which fields do without

    if method not in list_planners():
        raise UnknownNameError("planner", method, (*METHODS, *list_planners()))


def _describe_place(place: tuple[float, float] | None) -> str:
    return "" if place is None else f"({place[0]:.2f}, {place[1]:.2f})"
