"""Routes: primitives from a state to one goal, cached and checked by replay.

A route is a function of state and goal alone, so caching does not change results.
"""

from __future__ import annotations

import copy
import dataclasses
import itertools
import math
import numbers
import threading
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

from hrl_escape.clock import Clock
from hrl_escape.env.config import CONTACT_SKIN
from hrl_escape.env.geometry import Footprint
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState, check_fields
from hrl_escape.env.poses import list_touched
from hrl_escape.env.puzzles.mixins import Mapped, get_mixin
from hrl_escape.errors import ActionError, ConfigError, EscapeError, PlanningFailed, PlanningReason, UnknownNameError
from hrl_escape.floor.cost_to_go import FieldMaker
from hrl_escape.kernels import read_clock
from hrl_escape.planning.goals import (
    ExitGoal,
    Goal,
    GripGoal,
    PoseGoal,
    PressGoal,
    check_goal,
    is_reached,
    list_grips,
    name_goal,
)
from hrl_escape.planning.paths.problem import DEFAULT_PLANNER
from hrl_escape.planning.plan import make_planned_room
from hrl_escape.planning.props import get_prop_poses, list_obstacles, meets
from hrl_escape.planning.route import PlanningReport, Pose, Route, SearchSettings, check_budget, get_pose
from hrl_escape.planning.search.joint_search import JointSearch
from hrl_escape.planning.search.primitive_search import METHODS, PrimitiveSearch

if TYPE_CHECKING:
    from hrl_escape.planning.arm.reacher import Reacher

MOST_POSES = 20_000
"""Maximum number of poses of all cached routes, about 0.3 kB each. The least recently used routes are dropped first."""
_KEY = 3
"""Memory of a route's key, in poses."""

CAREFUL = 20_000
"""Search nodes for a route that avoids all blocks, before one that can move some."""

DoorKey: TypeAlias = tuple[int, tuple[int, ...]]
"""Bits of the shut inner doors, and numbers of the doors with a cell where a grip or push is possible."""
RouteKey: TypeAlias = tuple[Goal, SearchSettings, tuple[bool, DoorKey | None], Pose]  # is the exit open?


class Routes:
    """Routes of one room; thread-safe by a lock, and picklable.

    `rules` are the room's kinematics without randomness, which check routes. Method, budget of search nodes and time
    limit, s, are as in `RoomPlanner`. `search` is for the room with open inner doors.
    """

    def __init__(self, instance: RoomInstance, method: str = "auto", budget: int = 300_000,
                 time_limit: float | None = None) -> None:
        if not isinstance(instance, RoomInstance):
            raise ConfigError("instance", instance, "a RoomInstance, as generate() and env.unwrapped.instance give")
        check_budget(budget)
        check_method(method)
        Clock(time_limit)  # raises for an invalid limit
        self.instance = instance
        self.method, self.budget, self.time_limit = method, budget, time_limit
        self._quiet = make_planned_room(instance)
        self.rules = Kinematics(self._quiet, is_still=True)
        self._radius = instance.robot.outer_radius + CONTACT_SKIN
        self._open()

    def _open(self) -> None:
        self.search = PrimitiveSearch(self._quiet, self.rules)
        self._joint: JointSearch | None = None
        self._doors = self._make_door_searches()
        self._routes: OrderedDict[RouteKey, Route | PlanningFailed] = OrderedDict()
        self._poses = 0
        self._reasons: dict[int, str] = {}
        self.lock = threading.RLock()

    def _make_door_searches(self) -> DoorSearches | None:
        return None if self.rules.inner_doors is None else DoorSearches(self.search)

    def __getstate__(self) -> dict[str, Any]:
        left_out = ("search", "_joint", "_doors", "_routes", "_poses", "_reasons", "lock")
        return {k: v for k, v in self.__dict__.items() if k not in left_out}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._open()

    def take_over(self, before: Routes) -> None:
        """Reuse the grids and fields of the room before an edit, as far as they stay valid."""
        with before.lock:
            self.search = before.search.adapt(self._quiet, self.rules)
            self._doors = self._make_door_searches()

    def get_field_maker(self) -> FieldMaker:
        """Return the grid of the cost-to-go fields with the exit door shut."""
        with self.lock:
            return self.search.get_maker(True)

    def get_reacher(self) -> Reacher:
        """Return the arm of this room's robot, which finds its postures."""
        with self.lock:
            return self.search.reacher

    @property
    def joint_search(self) -> JointSearch:
        """Return the search for legs planned together, made on first use; the caller holds the lock."""
        if self._joint is None and self.instance.dynamics.press_with == "hand":
            from hrl_escape.planning.search.hand_search import HandSearch  # loads Pinocchio

            self._joint = HandSearch(self.search)
        elif self._joint is None:
            self._joint = JointSearch(self.search)
        return self._joint

    @property
    def settings(self) -> SearchSettings:
        """Return the search settings of a query without any: the method and the budget of these routes."""
        return SearchSettings(self.method, self.budget)

    def check_query(self, state: RoomState, *goals: Goal) -> None:
        """Check a state, at any place of the body, and goals. Raises `StateError`, `GoalError`."""
        check_fields(self.rules, state)
        for goal in goals:
            check_goal(goal, self.instance)

    def check_primitives(self, primitives: Sequence[int]) -> tuple[int, ...]:
        """Check and return the primitives of a plan, indices of the room's actions. Raises `ActionError`."""
        count = len(self.rules.actions)
        if not isinstance(primitives, Sequence) or isinstance(primitives, (str, bytes)):
            raise ActionError(primitives, count)
        for primitive in primitives:
            is_whole = isinstance(primitive, numbers.Integral) and not isinstance(primitive, bool)
            if not (is_whole and 0 <= primitive < count):
                raise ActionError(primitive, count)
        return tuple(int(primitive) for primitive in primitives)

    @contextmanager
    def _explaining(self, state: RoomState, goal: Goal) -> Iterator[None]:
        """Replace an error by the one of `check_query` if the query is invalid. Valid queries have no extra cost."""
        try:
            yield
        except EscapeError:
            raise
        except Exception:
            self.check_query(state, goal)
            raise

    def can_start(self, state: RoomState, goal: Goal) -> bool:
        """Return whether planning to a goal is useful: it is not reached, and no shut door blocks it. Fast."""
        with self._explaining(state, goal):
            if isinstance(goal, ExitGoal) and self.instance.door and not self.is_solved(state):
                return False
            if self._doors is not None and not is_way_open(self.rules, state, goal):
                return False
            if isinstance(goal, GripGoal):
                facts = self.instance.puzzle.symbolic.get_facts(state.puzzle)
                grips = list_grips(goal, self.instance, self.instance.find_model(state.puzzle))
                return any(op.is_applicable(facts) for op in grips) and (
                    self._doors is None or self._doors.can_walk(state, goal))
            return isinstance(goal, PressGoal) or not is_reached(goal, state, state, self.rules)

    def find_route(self, state: RoomState, goal: Goal, report: PlanningReport | None = None,
                   clock: Clock | None = None, settings: SearchSettings | None = None) -> Route:
        """Return the route from a state to a goal, from the cache if possible.

        The report counts calls, cache hits and seconds. `clock` is the time limit of the calling function; the default
        is the planner's own limit. The default settings are the planner's own.

        Raises:
            PlanningFailed: no route was found; failures are cached, too.
            StateError, GoalError: an invalid state or goal.
        """
        began = read_clock()
        clock = clock or Clock(self.time_limit)
        settings = self.settings if settings is None else settings
        with self.lock:
            if clock.is_cancelled and clock.is_up():  # cancelled while another call held the lock
                raise self.make_failure(clock.reason, state, goal)
            with self._explaining(state, goal):
                key = self._make_key(state, goal, settings)
                found = self._routes.get(key)
            if found is None:
                self.check_query(state, goal)
            if report is not None:
                report.planner_calls += 1
                report.cache_hits += found is not None
            if found is None:
                found = self._search_round_props(state, goal, clock, settings)
                if not clock.has_stopped:  # a result cut short by a clock depends on the machine, so it is not cached
                    self._keep(key, found)
            else:
                self._routes.move_to_end(key)
        if report is not None:
            report.planner_seconds += read_clock() - began
        if isinstance(found, PlanningFailed):
            raise copy.copy(found)  # a copy, so that the cached error keeps no stack frames alive
        return found

    def find_route_around(self, state: RoomState, goal: Goal, keep_out: Sequence[Footprint], budget: int,
                          report: PlanningReport, *, refine: bool = True, clock: Clock | None = None) -> Route:
        """Return a route to a goal around movable objects such as blocks. It is not cached.

        The body must not meet the footprints `keep_out`. `refine` sets whether finer grids are searched before giving
        up. The other arguments are as in `find_route`.

        Raises:
            PlanningFailed: no route within the budget.
        """
        began = read_clock()
        report.planner_calls += 1
        with self.lock:
            settings = self.settings._replace(budget=budget)
            found = self._search_route(state, goal, clock or Clock(self.time_limit), settings, keep_out, refine)
        report.planner_seconds += read_clock() - began
        if isinstance(found, PlanningFailed):
            raise found
        return found

    def remember(self, state: RoomState, goal: Goal, primitives: Sequence[int]) -> bool:
        """Make given primitives the route to a goal from this state. Return False if they miss it or press a target."""
        self.check_query(state, goal)
        primitives = self.check_primitives(primitives)
        route = self.replay(state, primitives, goal)
        if route is None or len(route.primitives) < len(primitives) or route.also_pressed:
            return False
        with self.lock:
            self._keep(self._make_key(state, goal, self.settings), route)
        return True

    def _keep(self, key: RouteKey, found: Route | PlanningFailed) -> None:
        """Cache a route or failure, and drop the least recently used ones."""
        if key in self._routes:
            return
        self._routes[key] = found
        self._poses += _count_poses(found)
        while self._poses > MOST_POSES and len(self._routes) > 1:
            self._poses -= _count_poses(self._routes.popitem(last=False)[1])

    def _make_key(self, state: RoomState, goal: Goal, settings: SearchSettings) -> RouteKey:
        """Return the cache key of a route: everything that it depends on."""
        props = tuple(get_prop_poses(state, self.instance)) if self.instance.props else ()
        doors = None if self._doors is None else self._doors.make_key(state, goal)
        return goal, settings, (self.is_solved(state), doors), (*get_pose(state), props)

    def replay(self, state: RoomState, primitives: Sequence[int], goal: Goal,
               keep_out: Sequence[Footprint] | None = None) -> Route | None:
        """Return the route of given primitives from this state, cut where the goal is reached, or None.

        The body must not meet the footprints `keep_out`; by default, blocks that it must not move.
        """
        poses, pressed = [get_pose(state)], 0
        here = state
        if keep_out is None:
            keep_out = list_obstacles(state, self.instance)[-1]
        for count, primitive in enumerate(primitives, 1):
            step = self.rules.step(here, primitive)
            after = step.state
            if keep_out and meets(here.x, here.y, after.x, after.y, keep_out, self._radius):
                return None
            poses.append(get_pose(after))
            pressed |= step.events.pressed
            if is_reached(goal, here, after, self.rules):
                others = pressed & ~(1 << goal.target) if isinstance(goal, PressGoal) else pressed
                also = list_touched(others)
                return Route(tuple(primitives[:count]), tuple(poses), also, 0)
            here = after
        return None

    def make_failure(self, reason: PlanningReason, state: RoomState, goal: Goal | None, **details: Any
                     ) -> PlanningFailed:
        """Make the `PlanningFailed` of a goal (None: the escape) that could not be planned from a state."""
        pose = (state.x, state.y, self.rules.get_heading(state))
        name = "the escape" if goal is None else name_goal(goal, self.instance)
        return PlanningFailed(reason, name, pose, **details)

    def _search_round_props(self, state: RoomState, goal: Goal, clock: Clock, settings: SearchSettings
                            ) -> Route | PlanningFailed:
        """Return a route that avoids all blocks if possible, and otherwise those that must not be moved."""
        if isinstance(goal, GripGoal):
            return self._search_grip(state, goal, clock, settings)
        if not self.instance.props:
            return self._search_route(state, goal, clock, settings)
        *careful, least = list_obstacles(state, self.instance)
        for keep_out in careful:
            found = self._search_route(state, goal, clock, settings._replace(budget=CAREFUL), keep_out, False)
            if isinstance(found, Route):
                return found
        return self._search_route(state, goal, clock, settings, least)

    def _search_grip(self, state: RoomState, goal: GripGoal, clock: Clock, settings: SearchSettings
                     ) -> Route | PlanningFailed:
        """Return a route to the target, unless it is touched already, followed by the grip, release or use."""
        route: Route | PlanningFailed = Route((), (get_pose(state),), (), 0)
        if isinstance(self.instance.puzzle, Mapped):
            route = self._search_place(state, goal, clock, settings)
        elif not state.touching >> goal.target & 1:
            route = self._search_round_props(state, PressGoal(goal.target), clock, settings)
        if isinstance(route, PlanningFailed):
            return route
        end = self.follow(state, route.primitives)[-1]
        if (move := find_move(goal, end, self.rules)) is None:
            return self.make_failure(PlanningReason.PRECONDITION_UNMET, state, goal)
        poses = (*route.poses, get_pose(self.rules.step(end, move).state))
        return route._replace(primitives=(*route.primitives, move), poses=poses)

    def _search_place(self, state: RoomState, goal: GripGoal, clock: Clock, settings: SearchSettings
                      ) -> Route | PlanningFailed:
        """Return the shortest route to a place that faces a cell where the goal can be reached."""
        for places in list_places(goal, state, self.rules):
            found = (self._search_route(state, place, clock, settings) for place in places)
            if routes := [route for route in found if isinstance(route, Route)]:
                return min(routes, key=lambda route: len(route.primitives))
        return self.make_failure(PlanningReason.UNREACHABLE_AT_RESOLUTION, state, goal)

    def _search_route(self, state: RoomState, goal: Goal, clock: Clock, settings: SearchSettings,
                      keep_out: Sequence[Footprint] = (), refine: bool = True) -> Route | PlanningFailed:
        begin = state._replace(primitives=0, noise_key=0, z=0.0, pitch=0.0, roll=0.0, physics=None)
        began, method = read_clock(), settings.method
        way, planner = (method, DEFAULT_PLANNER) if method in METHODS else ("corridor", method)
        way = self.search.choose_method(goal, keep_out) if way == "auto" else way
        search = self.search if self._doors is None else self._doors.choose(state)
        result = search.search(
            begin, goal, method=way, planner=planner, avoid=not isinstance(self.instance.puzzle, Mapped),
            refine=refine, keep_out=keep_out, budget_expansions=settings.budget, clock=clock, seed=settings.seed,
            effort=settings.effort)
        if not result.is_reached:
            return self.make_failure(
                PlanningReason(result.status), state, goal, seconds=read_clock() - began, expansions=result.expansions,
                planners=(planner, "fields") if way == "corridor" else (way,),
                nearest="" if result.nearest is None else "({:.2f}, {:.2f})".format(*result.nearest),
                advice="" if clock.has_stopped else self._explain(goal),
            )
        if not result.primitives:  # already at the goal
            return Route((), (get_pose(begin),), (), 0, result.method)
        assert not keep_out or self.replay(begin, result.primitives, goal, keep_out), "a search keeps out of these"
        return Route(result.primitives, tuple(map(get_pose, result.states)), result.also_pressed, result.expansions,
                     result.method, result.timed_out)

    def _explain(self, goal: Goal) -> str:
        """Return the reason why the hand never touches a target, empty if none is known; cached by target."""
        if not isinstance(goal, PressGoal) or self.instance.dynamics.press_with != "hand":
            return ""
        if goal.target not in self._reasons:
            floor = self.search.get_collision(door_shut=False)
            self._reasons[goal.target] = self.search.reacher.explain_unreachable(goal.target, floor)
        return self._reasons[goal.target]

    def follow(self, state: RoomState, primitives: Sequence[int]) -> tuple[RoomState, ...]:
        """Return the states of primitives from this state, the first one included."""
        return tuple(itertools.accumulate(primitives, lambda here, primitive: self.rules.step(here, primitive).state,
                                          initial=state))

    def has_undone(self, before: RoomState, now: RoomState) -> bool:
        """Return whether a prop has been moved away from a place that the open exit needs."""
        return bool(self.instance.props) and self.is_solved(before) and not self.is_solved(now)

    def is_solved(self, state: RoomState) -> bool:
        """Return whether the exit is open."""
        return self.instance.puzzle.is_solved(state.puzzle)


def _count_poses(found: Route | PlanningFailed) -> int:
    """Return the memory of a cached route or failure, in poses."""
    return _KEY + (len(found.poses) if isinstance(found, Route) else _KEY)


def check_method(method: str) -> None:
    """Check that a method is known. Raises `UnknownNameError`."""
    if isinstance(method, str) and method in METHODS:
        return
    from hrl_escape.planning.paths.planners import list_planners  # loads OMPL, which fields do without

    if not isinstance(method, str) or method not in list_planners():
        raise UnknownNameError("planner", method, (*METHODS, *list_planners()))


# --- inner doors and maps --------------------------------------------------------------

MOST_SEARCHES = 16
"""Most sets of shut doors whose searches are kept."""
_MOST_CELLS = 12
"""Most cells tried for putting something down."""
COMPASS = {"east": (1, 0, 0.0), "north": (0, 1, math.pi / 2), "west": (-1, 0, math.pi), "south": (0, -1, -math.pi / 2)}
"""Steps along x and y to each side of a map, and the heading for it."""


class DoorSearches:
    """Searches of one room with inner doors, by those that are shut; `opened` is that with all of them open.

    The others are adapted from it: they take over grid and fields, and repair what the doors change.
    """

    def __init__(self, opened: PrimitiveSearch) -> None:
        assert opened.kinematics.inner_doors is not None
        self._opened, self._rules, self._room = opened, opened.kinematics, opened.instance
        self._doors = opened.kinematics.inner_doors
        self._searches: OrderedDict[int, PrimitiveSearch] = OrderedDict()

    def choose(self, state: RoomState) -> PrimitiveSearch:
        """Return the search of the room with its inner doors as in a state."""
        walls = self.find_walls(state)
        if not walls:
            return self._opened
        if walls not in self._searches:
            doors = (door for number, door in enumerate(self._room.inner_doors) if walls >> number & 1)
            room = dataclasses.replace(self._room, solids=(*self._room.solids, *doors))
            self._searches[walls] = self._opened.adapt(room, self._rules)
            if len(self._searches) > MOST_SEARCHES:
                self._searches.popitem(last=False)
        self._searches.move_to_end(walls)
        return self._searches[walls]

    def find_walls(self, state: RoomState) -> int:
        """Bits of the shut inner doors, except doors that contain the body."""
        return self._doors.find_blocking(state.x, state.y, state.puzzle)

    def can_walk(self, state: RoomState, goal: GripGoal) -> bool:
        """Return whether free cells lead to the cell behind the thing that the goal pushes.

        For goals other than pushes, the puzzle's own model accounts for what blocks the way.
        """
        doors, side = self._doors, goal.action.partition("push-")[2]
        if not side:
            return True
        behind = (list(COMPASS).index(side) + 2) % 4
        cells = list_cells(self._room, state, goal)
        wanted, shut = {self._beside[cell][behind] for cell in cells}, doors.get_shut(state.puzzle)
        queue = [doors.find_at(state.x, state.y)]
        reached = {-1, *queue}
        for number in queue:
            free = [cell for cell in self._beside[number] if cell not in reached and not shut >> cell & 1]
            reached.update(free)
            queue += free
        return bool(wanted.intersection(queue))

    @cached_property
    def _beside(self) -> list[list[int]]:
        """Numbers of the inner doors one move to each side of each, -1 for none."""
        step = self._rules.actions.stride
        return [[self._doors.find_at(cell.x + step * x, cell.y + step * y) for x, y, _ in COMPASS.values()]
                for cell in self._room.inner_doors]

    def make_key(self, state: RoomState, goal: Goal) -> DoorKey:
        """Return the cache key of a route: the state of the inner doors that can change it."""
        return self.find_walls(state), list_cells(self._room, state, goal) if isinstance(goal, GripGoal) else ()


def list_cells(room: RoomInstance, state: RoomState, goal: GripGoal) -> tuple[int, ...]:
    """Numbers of the inner doors whose cells allow a goal's action now, on a map."""
    return get_mixin(room.puzzle, Mapped).list_cells(state.puzzle, goal.action, goal.target)


def is_way_open(rules: Kinematics, state: RoomState, goal: Goal) -> bool:
    """Return whether the inner doors on the way to a target or the exit are open; true where the ways are unknown."""
    ways, doors = rules.instance.ways, rules.inner_doors
    number = goal.target if isinstance(goal, (PressGoal, GripGoal)) else len(rules.instance.targets)
    if doors is None or number >= len(ways) or not isinstance(goal, (PressGoal, GripGoal, ExitGoal)):
        return True
    shut = doors.get_shut(state.puzzle)
    return not any(shut >> door & 1 for door in ways[number])


def list_places(goal: GripGoal, state: RoomState, rules: Kinematics) -> Iterator[list[PoseGoal]]:
    """List the places where a grip, release, use or push is possible, cell by cell.

    A cell has four, or one behind a thing to push. What is held can be put down in several cells: the nearest come
    first.
    """
    room, step = rules.instance, rules.actions.stride
    cells = [room.inner_doors[number] for number in list_cells(room, state, goal)]
    cells.sort(key=lambda cell: math.hypot(cell.x - state.x, cell.y - state.y))
    side = goal.action.partition("push-")[2]
    any_heading = bool(side) and rules.headings == rules.actions.symmetry  # a move leads to that side from each place
    for cell in cells[:_MOST_CELLS]:
        yield [PoseGoal(cell.x - step * x, cell.y - step * y, None if any_heading else heading, step / 4,
                        rules.turn_step / 2 - 1e-6)
               for name, (x, y, heading) in COMPASS.items() if side in ("", name)]


def find_move(goal: GripGoal, state: RoomState, rules: Kinematics) -> int | None:
    """Primitive that reaches a goal from its place, or None if none does, such as at a wrong heading."""
    if not goal.action.startswith("push-"):
        return rules.actions.find(goal.action)
    moves = (move for move in rules.actions.translations
             if is_reached(goal, state, rules.step(state, move).state, rules))
    return next(moves, None)
