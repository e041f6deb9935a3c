"""`RoomPlanner`: the programmatic API to everything that plans in one room.

It joins the search for primitives (`tracking.py`, which uses fields, OMPL paths and reaching
postures) with task planning (`tasks.py`), checks every plan with the room's own kinematics
and remembers plans. A plan is a function of state and goal alone: remembering saves time
and changes nothing.
"""

from __future__ import annotations

import dataclasses
import math
import threading
import time
from collections import OrderedDict
from collections.abc import Sequence
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, TypeAlias

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.primitives import BASE_PRIMITIVES
from hrl_escape.env.puzzles.base import Contacts, Operator
from hrl_escape.errors import PlanningFailed, PlanningReason
from hrl_escape.options.bounds import LegBounds
from hrl_escape.options.fields import FieldMaker
from hrl_escape.options.goals import ExitGoal, Goal, PressGoal, describe_goal, is_reached, make_goal, parse_goal
from hrl_escape.options.option import OptionReport
from hrl_escape.options.plan import Plan, PlanPart, join_parts
from hrl_escape.options.tasks import Leg, TaskPlan, TaskSearch
from hrl_escape.options.tracking import PrimitiveSearch

__all__ = ["Pose", "RoomPlanner", "Route", "get_planner", "get_pose"]

WAIT = [primitive.name for primitive in BASE_PRIMITIVES].index("turn-left")
"""The primitive that is always possible and blocks nothing."""
REMEMBERED = 50_000
"""Routes that are kept; the least recently used go first."""
REAL_LEGS = 300
"""Task orders that need no more legs than this are costed leg by leg from where the last one really ended."""

Pose: TypeAlias = tuple[Any, ...]


def get_pose(state: RoomState) -> Pose:
    """What a route depends on: base, arm, and what is touched; hashable."""
    return (*state[:6], state.touching)


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


class RoomPlanner:
    """Plans in one room; make it once and use it for every episode.

    It may be used from several threads (they wait for each other) and pickled (what it
    remembers stays behind).

    Args:
        instance: the room. Under noise, slip or physics, plans are for the kinematic room without these.
        method: `fields` (cost-to-go fields) or `corridor` (a corridor round an OMPL path).
        budget: search nodes a plan may expand; the same budget finds the same plan anywhere.
        time_limit: wall-clock guard for one plan, s.

    Attributes:
        instance: the room as given.
        rules: its kinematics without noise and slip, by which plans are checked.
    """

    _has_searched: ClassVar[bool] = False

    def __init__(self, instance: RoomInstance, method: str = "fields", budget: int = 300_000,
                 time_limit: float = 10.0) -> None:
        self.instance = instance
        self.method, self.budget, self.time_limit = method, budget, time_limit
        exact = dataclasses.replace(instance.dynamics, kind="kinematic", noise=0.0, slip=0.0)
        quiet = dataclasses.replace(instance, dynamics=exact)
        self.rules = Kinematics(quiet)
        self._bounds = LegBounds(instance)
        self._model = instance.puzzle.make_symbolic_model()
        self._open()

    def _open(self) -> None:
        self._search = PrimitiveSearch(self.rules.instance, self.rules)
        self._routes: OrderedDict[tuple[Goal, bool, Pose], Route | PlanningFailed] = OrderedDict()
        self._lock = threading.RLock()

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in self.__dict__.items() if k not in ("_search", "_routes", "_lock")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._open()

    # --- plans -------------------------------------------------------------------------

    def plan(self, state: RoomState, goal: Goal | str) -> Plan:
        """Plan the fewest primitives from a state to a goal.

        Args:
            state: where to begin, such as `env.unwrapped.get_state()`.
            goal: a goal, or its text: `button-2`, `exit`, `x,y` or `x,y,heading_deg`.

        Raises:
            PlanningFailed: no plan, and why.
            UnknownNameError: the text names nothing in this room.
        """
        began = time.perf_counter()
        goal = parse_goal(goal, self.instance) if isinstance(goal, str) else goal
        route = self.find_route(state, goal)
        return self._make_plan(state, goal, route, time.perf_counter() - began)

    def solve(self, state: RoomState) -> Plan:
        """Plan the whole escape: what the puzzle asks, in the cheapest order, then the exit.

        Raises:
            PlanningFailed: no plan, and why.
        """
        began = time.perf_counter()
        tasks = self._find_order(state, TaskSearch(self._model, lower_bound=self._bounds.bound_leg))
        if tasks is None:
            raise self._explain_unsolved(state, time.perf_counter() - began)
        legs: list[Plan] = []
        here = state
        for goal in (*(make_goal(op, self.instance) for op in tasks.operators), ExitGoal()):
            is_exit = isinstance(goal, ExitGoal)
            route = self._find_exit(here, bool(legs)) if is_exit else self.find_route(here, goal)
            if route.primitives:
                legs.append(self._make_plan(here, goal, route, 0.0))
                here = legs[-1].states[-1]
        primitives = tuple(action for leg in legs for action in leg.primitives)
        states = (state, *(s for leg in legs for s in leg.states[1:]))
        return Plan(self.instance, "escape", primitives, states, join_parts(legs), self.method,
                    sum(leg.expansions for leg in legs), time.perf_counter() - began)

    def _make_plan(self, state: RoomState, goal: Goal, route: Route, seconds: float) -> Plan:
        states = [state]
        for primitive in route.primitives:
            states.append(self.rules.step(states[-1], primitive).state)
        name = describe_goal(goal, self.instance)
        name = f"press-{name}" if isinstance(goal, PressGoal) else name
        others = tuple(self.instance.targets[i].name for i in route.also_pressed)
        part = PlanPart(name, goal, 0, len(route.primitives), others)
        return Plan(self.instance, name, route.primitives, tuple(states), (part,), self.method, route.expansions,
                    seconds)

    def get_fields(self, door_shut: bool) -> FieldMaker:
        """The grid on which costs to go are worked out, with the exit door shut or open."""
        with self._lock:
            return self._search.get_maker(door_shut)

    # --- routes: what options follow ------------------------------------------------------

    def can_start(self, state: RoomState, goal: Goal) -> bool:
        """Say cheaply whether planning to a goal makes sense here: not there yet, and no shut door before it."""
        if isinstance(goal, ExitGoal) and self.instance.door and not self._is_solved(state):
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
        key = (goal, self._is_solved(state), get_pose(state))
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

    def _search_route(self, state: RoomState, goal: Goal) -> Route | PlanningFailed:
        begin = state._replace(primitives=0, noise_key=0, z=0.0, pitch=0.0, roll=0.0, physics=None)
        began = time.perf_counter()
        limit = self.time_limit if RoomPlanner._has_searched else math.inf  # the first one may have to compile
        result = self._search.search(begin, goal, method=self.method, budget_expansions=self.budget, deadline=limit)
        RoomPlanner._has_searched = True
        if not result.is_reached:
            return self.make_failure(
                PlanningReason(result.status), state, goal, seconds=time.perf_counter() - began,
                planners=(self.method,), nearest=_describe_place(result.nearest),
            )
        route = self.replay(begin, result.primitives, goal)
        assert route is not None, "a search must return what its own replay reaches"
        return route._replace(expansions=result.expansions)

    # --- tasks ---------------------------------------------------------------------------

    def find_ancestors(self, state: RoomState, goal: Goal, report: OptionReport | None = None) -> list[Goal]:
        """What must be done before a goal counts, in the cheapest order, and the goal itself last.

        Raises:
            PlanningFailed: it cannot be done.
        """
        facts = self.instance.puzzle.get_facts(state.puzzle)
        ways = [op for op in self._model.operators if make_goal(op, self.instance) == goal]
        if not ways or any(op.preconditions <= facts for op in ways):
            return [goal]
        found: list[tuple[float, int, TaskPlan]] = []
        for number, op in enumerate(ways):
            search = TaskSearch(self._model, op.preconditions, self._bounds.bound_leg)
            tasks = self._find_order(state, search, goal, report)
            if tasks is not None:
                found.append((tasks.cost, number, tasks))
        if not found:
            raise self.make_failure(PlanningReason.PRECONDITION_UNMET, state, goal)
        return [*(make_goal(op, self.instance) for op in min(found)[2].operators), goal]

    def _find_order(self, state: RoomState, search: TaskSearch, last: Goal | None = None,
                    report: OptionReport | None = None) -> TaskPlan | None:
        """Order a task; the last leg goes to `last`, or to the exit.

        Few enough legs are planned from where the leg before really ended. More are priced pair
        by pair, each beginning where its operator ends when it is done first of all.
        """
        puzzle = self.instance.puzzle
        facts = puzzle.get_facts(state.puzzle)

        def extend(here: RoomState, op: Operator | None) -> Leg | None:
            try:
                if op is not None:
                    route = self.find_route(here, make_goal(op, self.instance), report)
                else:
                    route = self.find_route(here, last, report) if last else self._find_exit(here, here is not state)
            except PlanningFailed as failure:
                if failure.reason is PlanningReason.TIMEOUT:
                    raise  # the clock says nothing about the room: no other order is better for it
                return None
            end = self._follow(here, route)
            return Leg(len(route.primitives), end, puzzle.get_facts(end.puzzle))

        if search.count_legs(facts, REAL_LEGS + 1) <= REAL_LEGS:
            return search.find_order(facts, state, extend)
        ends = {"": state}
        costs: dict[tuple[str, str], float | None] = {}

        def extend_pair(before: str, op: Operator | None) -> Leg | None:
            name = op.name if op else ""
            if (before, name) not in costs:
                begin = ends.get(before, state)
                leg = extend(begin._replace(puzzle=self._solved_puzzle) if op is None and last is None else begin, op)
                costs[before, name] = leg and leg.cost
                if leg is not None and not before:
                    ends[name] = leg.place._replace(puzzle=state.puzzle)
            cost = costs[before, name]
            return None if cost is None else Leg(cost, name)

        for op in search.operators:
            extend_pair("", op)
        return search.find_order(facts, "", extend_pair)

    @cached_property
    def _solved_puzzle(self) -> Any:
        """Some state of the puzzle in which the exit is open."""
        tasks = TaskSearch(self._model).find_order(
            self.instance.puzzle.get_facts(self.instance.puzzle.make_state()), None, lambda place, op: Leg(1.0, None))
        puzzle = self.instance.puzzle.make_state()
        for op in tasks.operators if tasks else ():
            target = self.instance.puzzle.target_names.index(op.target)
            puzzle = self.instance.puzzle.update(puzzle, Contacts((target,)))
        return puzzle

    def _find_exit(self, here: RoomState, has_moved: bool) -> Route:
        """The last leg: nothing if the primitive that solved the puzzle has ended the episode already."""
        if not self._has_escaped(here):
            return self.find_route(here, ExitGoal())
        if has_moved:
            return Route((), (get_pose(here),), (), 0)
        route = self.replay(here, (WAIT,), ExitGoal())  # set down inside an open exit: any primitive escapes
        assert route is not None, "turning leaves the body's axis where it is"
        return route

    def _follow(self, state: RoomState, route: Route) -> RoomState:
        for primitive in route.primitives:
            state = self.rules.step(state, primitive).state
        return state

    def _is_solved(self, state: RoomState) -> bool:
        return self.instance.puzzle.is_solved(state.puzzle)

    def _has_escaped(self, state: RoomState) -> bool:
        return self._is_solved(state) and self.instance.exit.contains(state.x, state.y)

    def _explain_unsolved(self, state: RoomState, seconds: float) -> PlanningFailed:
        """Why there is no order: a part that cannot be reached, or a puzzle that cannot be solved from here."""
        for op in TaskSearch(self._model).operators:
            try:
                self.find_route(state, make_goal(op, self.instance))
            except PlanningFailed as failure:
                return failure
        return self.make_failure(PlanningReason.PRECONDITION_UNMET, state, None, seconds=seconds,
                                 planners=(self.method,), advice="No order of the puzzle's operators opens the exit")


def _describe_place(place: tuple[float, float] | None) -> str:
    return "" if place is None else f"({place[0]:.2f}, {place[1]:.2f})"


_PLANNERS: OrderedDict[str, RoomPlanner] = OrderedDict()
_PLANNERS_LOCK = threading.Lock()
KEPT_PLANNERS = 8


def get_planner(instance: RoomInstance) -> RoomPlanner:
    """The planner with default settings that this process shares for a room; the last eight rooms are kept."""
    with _PLANNERS_LOCK:
        planner = _PLANNERS.get(instance.id)
        if planner is None:
            planner = _PLANNERS[instance.id] = RoomPlanner(instance)
            if len(_PLANNERS) > KEPT_PLANNERS:
                _PLANNERS.popitem(last=False)
        _PLANNERS.move_to_end(instance.id)
        return planner
