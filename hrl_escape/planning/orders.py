"""`Orders`: orders of a puzzle's operators, with the cost of each leg by the room's own routes.

The search over orders is `symbolic/operator_order.py`; `planner.py` makes plans of the orders.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property
from typing import Any

from hrl_escape.clock import Clock
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.puzzles.symbolic import Operator
from hrl_escape.errors import PlanningFailed, PlanningReason
from hrl_escape.kernels import read_clock
from hrl_escape.planning.goals import ExitGoal, Goal, PushGoal, make_goal
from hrl_escape.planning.lower_bounds import LegBounds
from hrl_escape.planning.props import get_prop_poses
from hrl_escape.planning.route import PlanningReport, Route, SearchSettings, get_pose
from hrl_escape.planning.routes import Routes
from hrl_escape.planning.symbolic.operator_order import ExtendLeg, Leg, TaskPlan, TaskSearch

REAL_LEGS = 300
"""Most legs of a task whose legs are each planned from the true end of the one before."""


class Orders:
    """Search for the cheapest orders of the operators of a room's puzzle.

    Args:
        routes: routes of the room.

    Attributes:
        bounds: lower bounds of the room's legs.
    """

    def __init__(self, routes: Routes) -> None:
        self._routes, self._instance = routes, routes.instance
        self.bounds = LegBounds(self._instance)
        self._model = self._instance.symbolic_model

    def find_goals(self, state: RoomState, clock: Clock, settings: SearchSettings) -> tuple[Goal, ...]:
        """List the goals of an escape from here in the cheapest order; the last one is the exit.

        Raises:
            PlanningFailed: there is no escape; its reason says why.
        """
        began = read_clock()
        doors, puzzle = self._routes.rules.inner_doors, self._instance.puzzle
        known = puzzle.symbolic.plan(state.puzzle, -1 if doors is None else doors.find_at(state.x, state.y))
        if known is not None:
            return (*(make_goal(op, self._instance) for op in known), ExitGoal())
        tasks = self._find_order(state, TaskSearch(self._model, lower_bound=self.bounds.bound_leg), clock, settings)
        if tasks is None:
            raise self._explain_unsolved(state, clock, began)
        return (*(make_goal(op, self._instance) for op in tasks.operators), ExitGoal())

    def find_ancestors(self, state: RoomState, goal: Goal, report: PlanningReport | None = None) -> list[Goal]:
        """List the goals that a goal's preconditions need, in the cheapest order, and the goal itself last.

        Raises:
            PlanningFailed: the preconditions cannot be met.
        """
        self._routes.check_query(state, goal)
        facts = self._instance.puzzle.symbolic.get_facts(state.puzzle)
        ways = [op for op in self._model.operators if make_goal(op, self._instance) == goal]
        if not ways or any(op.preconditions <= facts for op in ways):
            return [goal]
        clock = Clock(self._routes.time_limit)
        found: list[tuple[float, int, TaskPlan]] = []
        for number, op in enumerate(ways):
            search = TaskSearch(self._model, op.preconditions, self.bounds.bound_leg)
            tasks = self._find_order(state, search, clock, self._routes.settings, goal, report)
            if tasks is not None:
                found.append((tasks.cost, number, tasks))
        if not found:
            raise self._routes.make_failure(PlanningReason.PRECONDITION_UNMET, state, goal)
        return [*(make_goal(op, self._instance) for op in min(found)[2].operators), goal]

    def list_orders(self, state: RoomState, count: int, clock: Clock, settings: SearchSettings, most_nodes: float
                    ) -> Iterator[list[Goal]]:
        """List several of the cheapest orders of an escape's goals, without the exit, by legs from true ends.

        The last orders press the target that opens the exit, after its ancestors, as one meta-action does.
        """
        facts = self._instance.puzzle.symbolic.get_facts(state.puzzle)
        search = TaskSearch(self._model, lower_bound=self.bounds.bound_leg, relevant_only=False)
        extend = self._make_extend(state, clock, settings, None, None, most_nodes)
        for task in search.find_orders(facts, state, extend, count, REAL_LEGS * count):
            yield [make_goal(op, self._instance) for op in task.operators]
        for op in search.operators:
            if op.add & self._model.goal:
                yield self.find_ancestors(state, make_goal(op, self._instance))

    def _find_order(self, state: RoomState, search: TaskSearch, clock: Clock, settings: SearchSettings,
                    last: Goal | None = None, report: PlanningReport | None = None) -> TaskPlan | None:
        """Find the cheapest order of a task; the last leg goes to `last`, or to the exit.

        Up to `REAL_LEGS` legs are each planned from the true end of the one before. Beyond that, costs are
        computed pair by pair, each from the place where the first operator ends if it comes first of all.
        """
        facts = self._instance.puzzle.symbolic.get_facts(state.puzzle)
        extend = self._make_extend(state, clock, settings, last, report)
        if len(search.list_legs(facts, REAL_LEGS + 1)) <= REAL_LEGS:
            return search.find_order(facts, state, extend)
        ends = {"": state}
        costs: dict[tuple[str, str], float | None] = {}

        def extend_pair(before: str, op: Operator | None) -> Leg | None:
            name = op.name if op else ""
            if (before, name) not in costs:
                begin = ends.get(before, state)
                if self._instance.ways or (op is None and last is None):
                    begin = begin._replace(puzzle=self._opened_puzzle if self._instance.ways else self.solved_puzzle)
                leg = extend(begin, op)
                costs[before, name] = leg and leg.cost
                if leg is not None and not before:
                    ends[name] = leg.place._replace(puzzle=state.puzzle)
            cost = costs[before, name]
            return None if cost is None else Leg(cost, name)

        for op in search.operators:
            extend_pair("", op)
        return search.find_order(facts, "", extend_pair)

    def _make_extend(self, state: RoomState, clock: Clock, settings: SearchSettings, last: Goal | None,
                     report: PlanningReport | None, most_nodes: float = math.inf) -> ExtendLeg:
        """Make the function that plans the next leg of a task from the true end of the one before.

        It finds no further legs once `most_nodes` search nodes are spent; those of cached routes count again.
        """
        puzzle, left = self._instance.puzzle, most_nodes

        def extend(here: RoomState, op: Operator | None) -> Leg | None:
            nonlocal left
            if left <= 0:
                return None
            goal = make_goal(op, self._instance) if op is not None else None
            if isinstance(goal, PushGoal):
                return self._guess_push(here, goal)
            try:
                if goal is not None:
                    route = self._routes.find_route(here, goal, report, clock, settings)
                elif last is not None:
                    route = self._routes.find_route(here, last, report, clock, settings)
                else:
                    route = self.find_exit(here, here is not state, clock, settings)
            except PlanningFailed as failure:
                if clock.has_stopped:
                    raise  # a time-out does not depend on the room, and another order would not help
                left -= failure.expansions
                return None
            left -= route.expansions
            end = self._routes.follow(here, route)
            return Leg(len(route.primitives), end, puzzle.symbolic.get_facts(end.puzzle))

        return extend

    def _guess_push(self, here: RoomState, goal: PushGoal) -> Leg:
        """Estimate the leg of a push, for ordering only: the way to the prop, plus twice the prop's own way."""
        poses = get_prop_poses(here, self._instance)
        (x, y, _), (to_x, to_y, _) = poses[goal.prop], poses[goal.destination]
        way = math.hypot(x - here.x, y - here.y) + 2.0 * math.hypot(to_x - x, to_y - y)
        return Leg(way / self._routes.rules.actions.stride, here._replace(x=to_x, y=to_y))

    @cached_property
    def solved_puzzle(self) -> Any:
        """State of the puzzle in which the exit is open."""
        puzzle = self._instance.puzzle
        state = puzzle.make_state()
        facts = puzzle.symbolic.get_facts(state)
        tasks = TaskSearch(self._model).find_order(facts, None, lambda place, op: Leg(1.0, None))
        for op in tasks.operators if tasks else ():
            state = puzzle.update(state, puzzle.symbolic.make_contacts(op))
        return state

    @cached_property
    def _opened_puzzle(self) -> Any:
        """State of the puzzle after all operators that can be carried out, with all doors between rooms open."""
        puzzle, state = self._instance.puzzle, self._instance.puzzle.make_state()
        for op in list(self._model.operators) * len(self._model.operators):
            if op.is_applicable(puzzle.symbolic.get_facts(state)):
                state = puzzle.update(state, puzzle.symbolic.make_contacts(op))
        return state

    def find_exit(self, here: RoomState, has_moved: bool, clock: Clock, settings: SearchSettings) -> Route:
        """Find the last leg; empty if the primitive that solved the puzzle has already ended the episode."""
        if not self._routes.rules.has_escaped(here):
            return self._routes.find_route(here, ExitGoal(), None, clock, settings)
        if has_moved:
            return Route((), (get_pose(here),), (), 0)
        # start inside an open exit: any primitive escapes
        route = self._routes.replay(here, (self._routes.rules.actions.wait,), ExitGoal())
        assert route is not None, "turning leaves the body's axis where it is"
        return route

    def _explain_unsolved(self, state: RoomState, clock: Clock, began: float) -> PlanningFailed:
        """Make the error for a missing order: an unreachable goal, or a puzzle that cannot be solved from here."""
        goals = [make_goal(op, self._instance) for op in TaskSearch(self._model).operators]
        for goal in goals:
            try:
                if not isinstance(goal, PushGoal):
                    self._routes.find_route(state, goal, clock=clock)
            except PlanningFailed as failure:
                return failure
        return self._routes.make_failure(
            PlanningReason.PRECONDITION_UNMET, state, None, seconds=read_clock() - began,
            planners=(self._routes.method,), advice="No order of the puzzle's operators opens the exit")
