"""`RoomPlanner`: the programmatic API to everything that plans in one room.

It puts routes (`routes.py`) together: to one goal, or in the cheapest order to all that the
puzzle asks and out (`tasks.py`). Every plan is checked with the room's own kinematics.
"""

from __future__ import annotations

import math
import threading
import time
from collections import OrderedDict
from functools import cached_property
from typing import Any

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.primitives import BASE_PRIMITIVES
from hrl_escape.env.puzzles.base import Contacts, Operator
from hrl_escape.errors import PlanningFailed, PlanningReason, UnsupportedError
from hrl_escape.options.bounds import LegBounds
from hrl_escape.options.goals import ExitGoal, Goal, PressGoal, PushGoal, describe_goal, make_goal, parse_goal
from hrl_escape.options.option import OptionReport
from hrl_escape.options.plan import Plan, PlanPart, join_parts
from hrl_escape.options.routes import Route, RouteFinder, get_pose, get_prop_poses
from hrl_escape.options.tasks import Leg, TaskPlan, TaskSearch

__all__ = ["RoomPlanner", "get_planner"]

WAIT = [primitive.name for primitive in BASE_PRIMITIVES].index("turn-left")
"""The primitive that is always possible and blocks nothing."""
REAL_LEGS = 300
"""Task orders that need no more legs than this are costed leg by leg from where the last one really ended."""


class RoomPlanner(RouteFinder):
    """Plans in one room; make it once and use it for every episode.

    It may be used from several threads (they wait for each other) and pickled (what it
    remembers stays behind).

    Args:
        instance: the room. Under noise, slip or physics, plans are for the kinematic room without these.
        method: `fields` (cost-to-go fields), or the name of a path planner round whose path to search, such as
            `RRTConnect` (`navigation.list_planners`); `corridor` takes the default one.
        budget: search nodes a plan may expand; the same budget finds the same plan anywhere.
        time_limit: wall-clock guard for one plan, s.

    Attributes:
        instance: the room as given.
        rules: its kinematics without noise and slip, by which plans are checked.

    Raises:
        UnknownNameError: no such method.
    """

    def __init__(self, instance: RoomInstance, method: str = "fields", budget: int = 300_000,
                 time_limit: float = 60.0) -> None:
        super().__init__(instance, method, budget, time_limit)
        self._bounds = LegBounds(instance)
        self._model = instance.puzzle.make_symbolic_model()

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
            UnsupportedError: the puzzle asks for pushes, which no plan foresees; `pursue` looks as it goes.
        """
        began = time.perf_counter()
        legs: list[Plan] = []
        here = state
        for goal in self.order_goals(state):
            if isinstance(goal, PushGoal):
                raise UnsupportedError(f"{describe_goal(goal, self.instance)} cannot be planned ahead: pushing takes "
                                       "physics. Use pursue(env), which looks as it goes")
            is_exit = isinstance(goal, ExitGoal)
            route = self._find_exit(here, bool(legs)) if is_exit else self.find_route(here, goal)
            if route.primitives:
                legs.append(self._make_plan(here, goal, route, 0.0))
                here = legs[-1].states[-1]
        primitives = tuple(action for leg in legs for action in leg.primitives)
        states = (state, *(s for leg in legs for s in leg.states[1:]))
        return Plan(self.instance, "escape", primitives, states, join_parts(legs), self.method,
                    sum(leg.expansions for leg in legs), time.perf_counter() - began)

    def order_goals(self, state: RoomState) -> tuple[Goal, ...]:
        """What is to be done to escape from here, in the cheapest order; the last goal is the exit.

        Raises:
            PlanningFailed: it cannot be done, and why.
        """
        began = time.perf_counter()
        tasks = self._find_order(state, TaskSearch(self._model, lower_bound=self._bounds.bound_leg))
        if tasks is None:
            raise self._explain_unsolved(state, time.perf_counter() - began)
        return (*(make_goal(op, self.instance) for op in tasks.operators), ExitGoal())

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
            goal = make_goal(op, self.instance) if op is not None else None
            if isinstance(goal, PushGoal):
                return self._guess_push(here, goal)
            try:
                if goal is not None:
                    route = self.find_route(here, goal, report)
                else:
                    route = self.find_route(here, last, report) if last else self._find_exit(here, here is not state)
            except PlanningFailed as failure:
                if failure.reason is PlanningReason.TIMEOUT:
                    raise  # the clock says nothing about the room: no other order is better for it
                return None
            end = self.follow(here, route)
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

    def _guess_push(self, here: RoomState, goal: PushGoal) -> Leg:
        """What a push may cost, for ordering only: to the prop, and twice its way; the robot ends at its place."""
        poses = get_prop_poses(here, self.instance)
        (x, y, _), (to_x, to_y, _) = poses[goal.prop], poses[goal.destination]
        way = math.hypot(x - here.x, y - here.y) + 2.0 * math.hypot(to_x - x, to_y - y)
        return Leg(way / self.instance.robot.move_step, here._replace(x=to_x, y=to_y))

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
        if not self.has_escaped(here):
            return self.find_route(here, ExitGoal())
        if has_moved:
            return Route((), (get_pose(here),), (), 0)
        route = self.replay(here, (WAIT,), ExitGoal())  # set down inside an open exit: any primitive escapes
        assert route is not None, "turning leaves the body's axis where it is"
        return route

    def _explain_unsolved(self, state: RoomState, seconds: float) -> PlanningFailed:
        """Why there is no order: a part that cannot be reached, or a puzzle that cannot be solved from here."""
        goals = [make_goal(op, self.instance) for op in TaskSearch(self._model).operators]
        for goal in goals:
            try:
                if not isinstance(goal, PushGoal):
                    self.find_route(state, goal)
            except PlanningFailed as failure:
                return failure
        return self.make_failure(PlanningReason.PRECONDITION_UNMET, state, None, seconds=seconds,
                                 planners=(self.method,), advice="No order of the puzzle's operators opens the exit")


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
