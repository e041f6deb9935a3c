"""`RoomPlanner`: the programmatic API of all planning in one room.

It composes routes (`route_finder.py`) into plans: to one goal, or to all goals of the puzzle in the
cheapest order and then out (`operator_order.py`). Every plan is checked by the room's own kinematics.
"""

from __future__ import annotations

import dataclasses
import math
import threading
from collections import OrderedDict
from collections.abc import Sequence
from functools import cached_property
from typing import Any

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.primitives import BASE_ACTIONS
from hrl_escape.env.puzzles.base import Contacts, Operator
from hrl_escape.errors import PlanningFailed, PlanningReason, UnsupportedError
from hrl_escape.kernels import read_clock
from hrl_escape.planning.clock import Clock
from hrl_escape.planning.goals import ExitGoal, Goal, PressGoal, PushGoal, describe_goal, make_goal, parse_goal
from hrl_escape.planning.lower_bounds import LegBounds
from hrl_escape.planning.plan import Plan, PlanPart, join_parts
from hrl_escape.planning.props import get_prop_poses
from hrl_escape.planning.report import PlanningReport
from hrl_escape.planning.route_finder import Route, RouteFinder, check_method, get_pose
from hrl_escape.planning.symbolic.operator_order import ExtendLeg, Leg, TaskPlan, TaskSearch

__all__ = ["RoomPlanner", "get_planner"]

REAL_LEGS = 300
"""Most legs of a task whose legs are each planned from the true end of the one before."""


class RoomPlanner(RouteFinder):
    """Planner of one room; make it once and use it for every episode.

    Thread-safe by a lock. Pickling drops the remembered routes.

    Args:
        instance: the room. Under noise, slip or physics, plans are for the kinematic room without these.
        method: `fields` (cost-to-go fields); a path planner round whose path to search, such as `RRTConnect`
            (see `list_planners`), with `corridor` for the default one; or `auto`, which takes the corridor for places
            on floors of more than 3,000 m^2, and fields for everything else.
        budget: search nodes of a plan; the same budget finds the same plan anywhere.
        time_limit: limit of one whole call of `plan`, `solve`, `order_goals` or `find_ancestors`, s. None, the default,
            leaves the decision to the budget, so that plans do not depend on the machine.

    Attributes:
        instance: the room as given.
        rules: its kinematics without noise and slip, by which plans are checked.

    Raises:
        UnknownNameError: no such method.
    """

    def __init__(self, instance: RoomInstance, method: str = "auto", budget: int = 300_000,
                 time_limit: float | None = None) -> None:
        super().__init__(instance, method, budget, time_limit)
        self._bounds = LegBounds(instance)
        self._model = instance.puzzle.make_symbolic_model()

    # --- plans -------------------------------------------------------------------------

    def plan(self, state: RoomState, goal: Goal | str, method: str | None = None) -> Plan:
        """Plan the fewest primitives from a state to a goal.

        Args:
            state: first state, such as `env.unwrapped.get_state()`.
            goal: a goal, or its text: `button-2`, `exit`, `x,y` or `x,y,heading_deg`.
            method: method of this plan; None for the planner's own.

        Raises:
            PlanningFailed: there is no plan; its reason says why.
            StateError, GoalError: there is no such state or goal in this room.
            UnknownNameError: the text names nothing in this room.
        """
        began = read_clock()
        goal = parse_goal(goal, self.instance) if isinstance(goal, str) else goal
        check_method(self.method if method is None else method)
        self.check_query(state, goal)
        route = self.find_route(state, goal, method=method)
        return self._make_leg(state, goal, route, read_clock() - began)

    def solve(self, state: RoomState, method: str | None = None) -> Plan:
        """Plan the whole escape: the puzzle's operators in the cheapest order, then the exit.

        Args:
            state: first state.
            method: method of this plan; None for the planner's own.

        Raises:
            PlanningFailed: there is no plan; its reason says why.
            UnsupportedError: the puzzle needs pushes, whose effect no plan predicts; use `pursue`.
        """
        began, clock = read_clock(), Clock(self.time_limit)
        method = self.method if method is None else method
        check_method(method)
        self.check_query(state)
        plan = self._follow_order(state, self._order_goals(state, clock, method), clock, method)
        return dataclasses.replace(plan, seconds=read_clock() - began, timed_out=clock.has_stopped)

    def _follow_order(self, state: RoomState, goals: Sequence[Goal], clock: Clock, method: str | None = None) -> Plan:
        """Escape by goals in order, each planned from the true end of the one before."""
        method = self.method if method is None else method
        legs: list[Plan] = []
        here = state
        for goal in goals:
            if isinstance(goal, PushGoal):
                raise UnsupportedError(f"{describe_goal(goal, self.instance)} cannot be planned ahead: pushing takes "
                                       "physics. Use pursue(env), which runs in closed loop")
            is_exit = isinstance(goal, ExitGoal)
            route = self._find_exit(here, bool(legs), clock, method) if is_exit else self.find_route(
                here, goal, None, clock, method)
            if route.primitives:
                legs.append(self._make_leg(here, goal, route))
                here = legs[-1].states[-1]
        return self._join_legs(state, legs, ", ".join(dict.fromkeys(leg.planner for leg in legs)), 0.0)

    def list_escapes(self, state: RoomState, count: int) -> list[Plan]:
        """List escapes leg by leg in several of the cheapest orders, that of `solve` included; the shortest first.

        Raises:
            PlanningFailed: there is no escape; its reason says why.
            UnsupportedError: the puzzle needs pushes.
        """
        first, clock = self.solve(state), Clock(self.time_limit)
        facts = self.instance.puzzle.get_facts(state.puzzle)
        search = TaskSearch(self._model, lower_bound=self._bounds.bound_leg, relevant_only=False)
        tasks = search.find_orders(facts, state, self._make_extend(state, clock, self.method, None, None), count,
                                   REAL_LEGS * count)
        orders = [[*(make_goal(op, self.instance) for op in task.operators), ExitGoal()] for task in tasks]
        for op in search.operators:
            if op.add & self._model.goal:  # with all that its preconditions need, as one meta-action does it
                orders.append([*self.find_ancestors(state, make_goal(op, self.instance)), ExitGoal()])
        plans = {first.primitives: first}
        for goals in orders:
            try:
                plan = self._follow_order(state, goals, clock)
            except PlanningFailed:
                continue
            if self.has_escaped(plan.states[-1]):
                plans.setdefault(plan.primitives, plan)
        return sorted(plans.values(), key=lambda plan: plan.cost)[:count]

    def order_goals(self, state: RoomState) -> tuple[Goal, ...]:
        """List the goals of an escape from here in the cheapest order; the last one is the exit.

        Raises:
            PlanningFailed: there is no escape; its reason says why.
        """
        self.check_query(state)
        return self._order_goals(state, Clock(self.time_limit), self.method)

    def _order_goals(self, state: RoomState, clock: Clock, method: str) -> tuple[Goal, ...]:
        began = read_clock()
        tasks = self._find_order(state, TaskSearch(self._model, lower_bound=self._bounds.bound_leg), clock, method)
        if tasks is None:
            raise self._explain_unsolved(state, clock, began)
        return (*(make_goal(op, self.instance) for op in tasks.operators), ExitGoal())

    def make_plan(self, state: RoomState, primitives: Sequence[int], goals: Sequence[Goal], planner: str) -> Plan:
        """Make a plan of primitives that reach goals one after another; the last primitive may reach several.

        Raises:
            PlanningFailed: the primitives do not reach the goals.
        """
        self.check_query(state, *goals)
        legs: list[Plan] = []
        here, rest = state, self.check_primitives(primitives)
        for goal in goals:
            if isinstance(goal, ExitGoal) and not rest and self.has_escaped(here):
                break  # by the primitive of the last press
            route = self.replay(here, rest, goal)
            if route is None:
                raise self.make_failure(PlanningReason.UNREACHABLE_AT_RESOLUTION, here, goal, planners=(planner,))
            legs.append(self._make_leg(here, goal, route))
            here, rest = legs[-1].states[-1], rest[legs[-1].cost :]
        return self._join_legs(state, legs, planner, 0.0)

    def _join_legs(self, state: RoomState, legs: Sequence[Plan], planner: str, seconds: float) -> Plan:
        """Escape made of consecutive legs."""
        primitives = tuple(action for leg in legs for action in leg.primitives)
        states = (state, *(s for leg in legs for s in leg.states[1:]))
        return Plan(self.instance, "escape", primitives, states, join_parts(legs), planner,
                    sum(leg.expansions for leg in legs), seconds)

    def _make_leg(self, state: RoomState, goal: Goal, route: Route, seconds: float = 0.0) -> Plan:
        states = [state]
        for primitive in route.primitives:
            states.append(self.rules.step(states[-1], primitive).state)
        name = describe_goal(goal, self.instance)
        name = f"press-{name}" if isinstance(goal, PressGoal) else name
        others = tuple(self.instance.targets[i].name for i in route.also_pressed)
        part = PlanPart(name, goal, 0, len(route.primitives), others)
        return Plan(self.instance, name, route.primitives, tuple(states), (part,), route.method, route.expansions,
                    seconds, route.timed_out)

    # --- tasks ---------------------------------------------------------------------------

    def find_ancestors(self, state: RoomState, goal: Goal, report: PlanningReport | None = None) -> list[Goal]:
        """List the goals that a goal's preconditions need, in the cheapest order, and the goal itself last.

        Raises:
            PlanningFailed: the preconditions cannot be met.
        """
        self.check_query(state, goal)
        facts = self.instance.puzzle.get_facts(state.puzzle)
        ways = [op for op in self._model.operators if make_goal(op, self.instance) == goal]
        if not ways or any(op.preconditions <= facts for op in ways):
            return [goal]
        clock = Clock(self.time_limit)
        found: list[tuple[float, int, TaskPlan]] = []
        for number, op in enumerate(ways):
            search = TaskSearch(self._model, op.preconditions, self._bounds.bound_leg)
            tasks = self._find_order(state, search, clock, self.method, goal, report)
            if tasks is not None:
                found.append((tasks.cost, number, tasks))
        if not found:
            raise self.make_failure(PlanningReason.PRECONDITION_UNMET, state, goal)
        return [*(make_goal(op, self.instance) for op in min(found)[2].operators), goal]

    def _find_order(self, state: RoomState, search: TaskSearch, clock: Clock, method: str, last: Goal | None = None,
                    report: PlanningReport | None = None) -> TaskPlan | None:
        """Find the cheapest order of a task; the last leg goes to `last`, or to the exit.

        Up to `REAL_LEGS` legs are each planned from the true end of the one before. Beyond that, costs are
        computed pair by pair, each from the place where the first operator ends if it comes first of all.
        """
        facts = self.instance.puzzle.get_facts(state.puzzle)
        extend = self._make_extend(state, clock, method, last, report)
        if search.count_legs(facts, REAL_LEGS + 1) <= REAL_LEGS:
            return search.find_order(facts, state, extend)
        ends = {"": state}
        costs: dict[tuple[str, str], float | None] = {}

        def extend_pair(before: str, op: Operator | None) -> Leg | None:
            name = op.name if op else ""
            if (before, name) not in costs:
                begin = ends.get(before, state)
                leg = extend(begin._replace(puzzle=self.solved_puzzle) if op is None and last is None else begin, op)
                costs[before, name] = leg and leg.cost
                if leg is not None and not before:
                    ends[name] = leg.place._replace(puzzle=state.puzzle)
            cost = costs[before, name]
            return None if cost is None else Leg(cost, name)

        for op in search.operators:
            extend_pair("", op)
        return search.find_order(facts, "", extend_pair)

    def _make_extend(self, state: RoomState, clock: Clock, method: str, last: Goal | None,
                     report: PlanningReport | None) -> ExtendLeg:
        """Make the function that plans the next leg of a task from the true end of the one before."""
        puzzle = self.instance.puzzle

        def extend(here: RoomState, op: Operator | None) -> Leg | None:
            goal = make_goal(op, self.instance) if op is not None else None
            if isinstance(goal, PushGoal):
                return self._guess_push(here, goal)
            try:
                if goal is not None:
                    route = self.find_route(here, goal, report, clock, method)
                elif last is not None:
                    route = self.find_route(here, last, report, clock, method)
                else:
                    route = self._find_exit(here, here is not state, clock, method)
            except PlanningFailed as failure:
                if failure.reason is PlanningReason.TIMEOUT:
                    raise  # a time-out says nothing about the room, and another order would not help
                return None
            end = self.follow(here, route)
            return Leg(len(route.primitives), end, puzzle.get_facts(end.puzzle))

        return extend

    def _guess_push(self, here: RoomState, goal: PushGoal) -> Leg:
        """Rough leg of a push, for ordering only: the way to the prop, twice its own, and the robot at its end."""
        poses = get_prop_poses(here, self.instance)
        (x, y, _), (to_x, to_y, _) = poses[goal.prop], poses[goal.destination]
        way = math.hypot(x - here.x, y - here.y) + 2.0 * math.hypot(to_x - x, to_y - y)
        return Leg(way / self.instance.robot.move_step, here._replace(x=to_x, y=to_y))

    @cached_property
    def solved_puzzle(self) -> Any:
        """State of the puzzle in which the exit is open."""
        tasks = TaskSearch(self._model).find_order(
            self.instance.puzzle.get_facts(self.instance.puzzle.make_state()), None, lambda place, op: Leg(1.0, None))
        puzzle = self.instance.puzzle.make_state()
        for op in tasks.operators if tasks else ():
            target = self.instance.puzzle.target_names.index(op.target)
            puzzle = self.instance.puzzle.update(puzzle, Contacts((target,)))
        return puzzle

    def _find_exit(self, here: RoomState, has_moved: bool, clock: Clock, method: str) -> Route:
        """Last leg; empty if the primitive that solved the puzzle has already ended the episode."""
        if not self.has_escaped(here):
            return self.find_route(here, ExitGoal(), None, clock, method)
        if has_moved:
            return Route((), (get_pose(here),), (), 0)
        # start inside an open exit: any primitive escapes
        route = self.replay(here, (BASE_ACTIONS.wait,), ExitGoal())
        assert route is not None, "turning leaves the body's axis where it is"
        return route

    def _explain_unsolved(self, state: RoomState, clock: Clock, began: float) -> PlanningFailed:
        """Reason why there is no order: a goal that cannot be reached, or a puzzle that cannot be solved from here."""
        goals = [make_goal(op, self.instance) for op in TaskSearch(self._model).operators]
        for goal in goals:
            try:
                if not isinstance(goal, PushGoal):
                    self.find_route(state, goal, clock=clock)
            except PlanningFailed as failure:
                return failure
        return self.make_failure(PlanningReason.PRECONDITION_UNMET, state, None, seconds=read_clock() - began,
                                 planners=(self.method,), advice="No order of the puzzle's operators opens the exit")


_PLANNERS: OrderedDict[tuple[str, str], RoomPlanner] = OrderedDict()
_PLANNERS_LOCK = threading.Lock()
KEPT_PLANNERS = 8


def get_planner(instance: RoomInstance, method: str = "auto") -> RoomPlanner:
    """Return the planner that this process shares for a room and a method; it keeps the last eight."""
    check_method(method)
    key = (instance.id, method)
    with _PLANNERS_LOCK:
        planner = _PLANNERS.get(key)
        if planner is None:
            planner = _PLANNERS[key] = RoomPlanner(instance, method)
            if len(_PLANNERS) > KEPT_PLANNERS:
                _PLANNERS.popitem(last=False)
        _PLANNERS.move_to_end(key)
        return planner
