"""`RoomPlanner`: the Python API of all planning in one room.

It combines routes to single goals (`routes.py`), orders of the puzzle's operators, and legs planned together
(`search/joint_search.py`) into plans. The room's kinematics check every plan.
"""

from __future__ import annotations

import dataclasses
import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import Any

from hrl_escape.clock import Clock, OutOfTime
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.puzzles.symbolic import Operator, SymbolicModel
from hrl_escape.errors import PlanningFailed, PlanningReason, UnsupportedError
from hrl_escape.kernels import read_clock
from hrl_escape.planning.goals import ExitGoal, Goal, PressGoal, PushGoal, make_goal, name_goal, parse_goal
from hrl_escape.planning.lower_bounds import LegBounds, bound_escape
from hrl_escape.planning.plan import Plan, PlanPart, join_parts
from hrl_escape.planning.props import get_prop_poses
from hrl_escape.planning.requests import PlanningRequest, PlanningResult, bound_cost, compute_plan_cost, iterate_routes
from hrl_escape.planning.route import PlanningReport, Route, SearchSettings, get_pose
from hrl_escape.planning.routes import Routes, check_method
from hrl_escape.planning.symbolic.operator_order import ExtendLeg, Leg, TaskPlan, TaskSearch

ESCAPES = 8
"""Number of operator orders that are planned in detail when a request asks for better plans."""
MOST_JOINTS = 4
"""Maximum number of joints of a pressing arm for joint searches. Tables then take a millisecond."""
MOST_FLOOR = 1_000.0
"""Largest floor for joint searches by hand, m^2. The field of each posture then takes 0.1 s."""
REAL_LEGS = 300
"""Maximum number of legs that are each planned from the end of the one before."""


class Orders:
    """Cheapest orders of the operators of a room's puzzle, with lower bounds of its legs."""

    def __init__(self, routes: Routes) -> None:
        self._routes, self._instance = routes, routes.instance
        self.bounds = LegBounds(self._instance)
        self._model = self._instance.symbolic_model

    def find_goals(self, state: RoomState, clock: Clock, settings: SearchSettings) -> tuple[Goal, ...]:
        """Return the goals of an escape from this state, the exit last; raises `PlanningFailed`.

        The order is the puzzle's own plan if it has one, otherwise the cheapest order.
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
        """Return the goals that a goal's preconditions require, in the cheapest order, and the goal.

        Raises `PlanningFailed`.
        """
        self._routes.check_query(state, goal)
        facts = self._instance.puzzle.symbolic.get_facts(state.puzzle)
        model = self._instance.find_model(state.puzzle)
        ways = [op for op in model.operators if make_goal(op, self._instance) == goal]
        if not ways or any(op.preconditions <= facts for op in ways):
            return [goal]
        clock = Clock(self._routes.time_limit)
        found: list[tuple[float, int, TaskPlan]] = []
        for number, op in enumerate(ways):
            search = self._make_search(model, op.preconditions)
            tasks = self._find_order(state, search, clock, self._routes.settings, goal, report)
            if tasks is not None:
                found.append((tasks.cost, number, tasks))
        if not found:
            raise self._routes.make_failure(PlanningReason.PRECONDITION_UNMET, state, goal)
        return [*(make_goal(op, self._instance) for op in min(found)[2].operators), goal]

    def _make_search(self, model: SymbolicModel, goal: frozenset[str] | None = None, relevant_only: bool = True
                     ) -> TaskSearch:
        """Make the search for a goal. Lower bounds of legs use the initial places of objects."""
        if model is not self._model:
            return TaskSearch(model, goal, relevant_only=relevant_only)
        return TaskSearch(model, goal, self.bounds.bound_leg, relevant_only)

    def list_orders(self, state: RoomState, count: int, clock: Clock, settings: SearchSettings, most_nodes: float
                    ) -> Iterator[list[Goal]]:
        """Return several of the cheapest orders of an escape's goals, without the exit.

        Legs are planned from the end of the one before. The last orders press the target that opens the exit after its
        ancestors, as one planned option does.
        """
        facts = self._instance.puzzle.symbolic.get_facts(state.puzzle)
        search = self._make_search(self._instance.find_model(state.puzzle), relevant_only=False)
        extend = self._make_extend(state, clock, settings, None, None, most_nodes)
        for task in search.find_orders(facts, state, extend, count, REAL_LEGS * count):
            yield [make_goal(op, self._instance) for op in task.operators]
        for op in search.operators:
            if op.add & self._model.goal:
                try:
                    goals = self.find_ancestors(state, make_goal(op, self._instance))
                except PlanningFailed:  # it is out of reach from here, and another operator opens the exit
                    continue
                yield goals

    def _find_order(self, state: RoomState, search: TaskSearch, clock: Clock, settings: SearchSettings,
                    last: Goal | None = None, report: PlanningReport | None = None) -> TaskPlan | None:
        """Find the cheapest order of a task. The last leg goes to `last`, or to the exit.

        Up to `REAL_LEGS` legs are planned from the end of the one before. Beyond that, costs are computed per pair,
        from where the first operator ends if it comes first in the plan.
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
        """Make the function that plans the next leg of a task from the end of the one before.

        It returns no more legs after `most_nodes` search nodes; nodes of cached routes count again.
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
            end = self._routes.follow(here, route.primitives)[-1]
            return Leg(len(route.primitives), end, puzzle.symbolic.get_facts(end.puzzle))

        return extend

    def _guess_push(self, here: RoomState, goal: PushGoal) -> Leg:
        """Estimate the leg of a push, for the order only: the way to the prop plus twice the way of the prop."""
        poses = get_prop_poses(here, self._instance)
        (x, y, _), (to_x, to_y, _) = poses[goal.prop], poses[goal.destination]
        way = math.hypot(x - here.x, y - here.y) + 2.0 * math.hypot(to_x - x, to_y - y)
        return Leg(way / self._routes.rules.actions.stride, here._replace(x=to_x, y=to_y))

    @cached_property
    def solved_puzzle(self) -> Any:
        """Return the puzzle state with an open exit."""
        puzzle = self._instance.puzzle
        state = puzzle.make_state()
        facts = puzzle.symbolic.get_facts(state)
        tasks = TaskSearch(self._model).find_order(facts, None, lambda place, op: Leg(1.0, None))
        for op in tasks.operators if tasks else ():
            state = puzzle.update(state, puzzle.symbolic.make_contacts(op))
        return state

    @cached_property
    def _opened_puzzle(self) -> Any:
        """Return the puzzle state after all possible operators, with all doors between rooms open."""
        puzzle, state = self._instance.puzzle, self._instance.puzzle.make_state()
        for op in list(self._model.operators) * len(self._model.operators):
            if op.is_applicable(puzzle.symbolic.get_facts(state)):
                state = puzzle.update(state, puzzle.symbolic.make_contacts(op))
        return state

    def find_exit(self, here: RoomState, has_moved: bool, clock: Clock, settings: SearchSettings) -> Route:
        """Plan the last leg; empty if the primitive that solved the puzzle has already ended the episode."""
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


class RoomPlanner:
    """Planner of one room. Make it once and use it for every episode.

    It is thread-safe by a lock. Pickling drops the cached routes.

    Args:
        instance: the room. Plans ignore noise, slip and physics, and assume the most probable outcomes of a random
            puzzle.
        method: `fields` (cost-to-go fields), a path planner such as `RRTConnect` (see `list_planners`), whose path
            limits the search, `corridor` for the default path planner, or `auto`. `auto` uses the corridor for places
            on floors above 3,000 m^2, and fields for everything else.
        budget: search nodes of a plan. Equal budgets give equal plans on every machine.
        time_limit: limit of one call of `plan`, `solve`, `order_goals` or `orders.find_ancestors`, s. With None, the
            default, plans do not depend on the machine.

    Attributes:
        instance: the room as given.
        rules: its kinematics without randomness, which check plans.
        routes: cached routes to single goals.

    Raises:
        UnknownNameError: no method has this name.
    """

    def __init__(self, instance: RoomInstance, method: str = "auto", budget: int = 300_000,
                 time_limit: float | None = None) -> None:
        self.routes = Routes(instance, method, budget, time_limit)
        self.instance, self.rules = instance, self.routes.rules

    @cached_property
    def orders(self) -> Orders:
        """Return the cheapest orders of the puzzle's operators."""
        return Orders(self.routes)

    def adapt(self, instance: RoomInstance) -> RoomPlanner:
        """Make the planner of an edited room. It plans as a new one would, and reuses what stays valid.

        Args:
            instance: the edited room, such as `Scene.instance`.
        """
        new = RoomPlanner(instance, self.routes.method, self.routes.budget, self.routes.time_limit)
        new.routes.take_over(self.routes)
        return new

    def prepare(self) -> None:
        """Compute the shared fields now, to make the first plans as fast as later ones."""
        with self.routes.lock:
            self.routes.search.prepare()

    # --- plans -------------------------------------------------------------------------

    def plan(self, state: RoomState, goal: Goal | str, method: str | None = None) -> Plan:
        """Plan the fewest primitives from a state to a goal.

        Args:
            state: first state, such as `env.unwrapped.get_state()`.
            goal: a goal, or its text: `press-button-2`, `go-to-exit`, `x,y` or `x,y,heading_deg`.
            method: method of this plan, or None for the planner's own.

        Returns:
            The plan, with its predicted states.

        Raises:
            PlanningFailed: no plan was found; see its reason.
            StateError, GoalError: the room has no such state or goal.
            UnknownNameError: the text names nothing in this room.
        """
        began = read_clock()
        goal = self._read_goal(goal)
        settings = self._choose_settings(method)
        self.routes.check_query(state, goal)
        route = self.routes.find_route(state, goal, settings=settings)
        return self._make_leg(state, goal, route, read_clock() - began)

    def answer(self, request: PlanningRequest, *, stop: threading.Event | None = None,
               on_improvement: Callable[[PlanningResult], None] | None = None) -> PlanningResult:
        """Answer a planning request. A failure is returned as a result.

        Args:
            request: what to plan.
            stop: event that cancels the call when another thread sets it. The result is then the best so far.
            on_improvement: called with the first plan and with every better one.

        Returns:
            The result, with status, plan, cost and lower bound.

        Raises:
            StateError, GoalError, UnknownNameError: the room has no such state, goal or method.
            UnsupportedError: the puzzle requires pushes, whose effect cannot be predicted.
        """
        began = read_clock()
        clock = Clock(self.routes.time_limit if request.time_limit is None else request.time_limit, stop)
        settings = self._choose_settings(request.method, request.budget, request.seed)
        given = request.goal if isinstance(request.goal, tuple) else () if request.goal is None else (request.goal,)
        goals = tuple(map(self._read_goal, given))
        self.routes.check_query(request.state, *goals)
        bound = float(self.orders.bounds.bound_goals(request.state, goals) if goals
                      else bound_escape(self.instance, request.state))
        bound = bound_cost(self.instance, request.state, goals or (ExitGoal(),), request, bound)
        result = PlanningResult(request, PlanningReason.BUDGET_EXHAUSTED, None, math.inf, bound, "", 0, 0.0)
        spent = 0
        try:
            for plan in self._iterate_plans(request, goals, settings, clock):
                cost, spent = compute_plan_cost(plan, request), spent + plan.expansions
                if cost < result.cost - 1e-9:
                    result = PlanningResult(request, "reached", plan, cost, min(bound, cost), plan.planner, spent,
                                            read_clock() - began, clock.has_stopped)
                    if on_improvement is not None:
                        on_improvement(result)
                if result.cost <= bound or spent >= settings.budget or clock.is_up():
                    break
        except PlanningFailed as failure:
            spent += failure.expansions
            if result.plan is None:
                result = dataclasses.replace(result, status=failure.reason, failure=failure)
        return dataclasses.replace(result, spent=spent, seconds=read_clock() - began, cut_short=clock.has_stopped)

    def _iterate_plans(self, request: PlanningRequest, goals: Sequence[Goal], settings: SearchSettings, clock: Clock
                       ) -> Iterator[Plan]:
        """Yield plans for a request: first the plan of `plan` or `solve`, then others while nodes are left."""
        state, is_thorough = request.state, request.improve or request.objective != "primitives"
        if not goals:
            left, plan = settings.budget, None
            for effort in (0, 1, 2) if is_thorough else (0,):
                plan = self._solve(state, settings._replace(effort=effort, budget=left), clock, left, plan)
                left -= plan.expansions
                yield plan
                if left <= 0:
                    return
            if is_thorough:
                yield from self.list_escapes(state, ESCAPES, clock, settings, left)
            return
        if len(goals) > 1:
            yield self.follow_goals(state, goals, clock, settings)
            return
        first = self.routes.find_route(state, goals[0], None, clock, settings)
        yield self._make_leg(state, goals[0], first)
        if is_thorough:
            rest = settings._replace(budget=settings.budget - first.expansions)
            for route in iterate_routes(self.routes, state, goals[0], request, rest, clock):
                yield self._make_leg(state, goals[0], route)

    def _read_goal(self, goal: Goal | str) -> Goal:
        return parse_goal(goal, self.instance) if isinstance(goal, str) else goal

    def _choose_settings(self, method: str | None, budget: int | None = None, seed: int = 0) -> SearchSettings:
        usual = self.routes.settings
        check_method(usual.method if method is None else method)
        return SearchSettings(method or usual.method, budget or usual.budget, seed)

    def solve(self, state: RoomState, method: str | None = None) -> Plan:
        """Plan the whole escape with few primitives: the puzzle's operators, then the exit.

        Legs are first planned one by one, in the cheapest order. One search over all orders then looks for a shorter
        escape. It is skipped under physics and for a pressing hand with five joints or more.

        Args:
            state: first state.
            method: method of this plan, or None for the planner's own.

        Returns:
            The plan, with one part per leg.

        Raises:
            PlanningFailed: no plan was found; see its reason.
            UnsupportedError: the puzzle requires pushes, whose effect cannot be predicted; use `pursue`.
        """
        settings = self._choose_settings(method)
        self.routes.check_query(state)
        return self._solve(state, settings, Clock(self.routes.time_limit))

    def _solve(self, state: RoomState, settings: SearchSettings, clock: Clock, most_nodes: int | None = None,
               known: Plan | None = None) -> Plan:
        """Plan the escape leg by leg, then look for a shorter one over all legs and orders at once.

        The budget of `settings` holds per leg, and both searches together end at `most_nodes`. The result must be
        shorter than the escape that is already known.
        """
        began = read_clock()
        plan = self._solve_by_legs(state, settings, clock)
        most_nodes, spent = settings.budget if most_nodes is None else most_nodes, plan.expansions
        plan = plan if known is None or plan.cost < known.cost else known
        if settings.method in ("auto", "fields"):
            plan, more = self._shorten_escape(state, plan, settings, clock, most_nodes - spent)
            spent += more
        return dataclasses.replace(plan, expansions=spent, seconds=read_clock() - began, timed_out=clock.has_stopped)

    def shorten_escape(self, state: RoomState, plan: Plan, budget: int) -> Plan:
        """Look for a shorter escape than a known one, over orders and ends of legs.

        Args:
            state: first state.
            plan: an escape from it.
            budget: search nodes. Equal budgets give equal plans on every machine.
        """
        clock, settings = Clock(self.routes.time_limit), self.routes.settings
        for effort in (0, 1, 2):
            plan, spent = self._shorten_escape(state, plan, settings._replace(effort=effort), clock, budget)
            budget -= spent
        return plan

    def _solve_by_legs(self, state: RoomState, settings: SearchSettings, clock: Clock) -> Plan:
        return self.follow_goals(state, self.orders.find_goals(state, clock, settings), clock, settings)

    def _shorten_escape(self, state: RoomState, plan: Plan, settings: SearchSettings, clock: Clock, most_nodes: int
                        ) -> tuple[Plan, int]:
        """Return the escape, or a shorter one found jointly, and the nodes spent on it.

        Props, and headings and joints off their lattices, are not supported.
        """
        order = [part.goal for part in plan.parts]
        is_off = state.heading_offset or any(state.joint_offsets)
        if is_off or not order or most_nodes <= 0 or not can_join(self.instance, order):
            return plan, 0
        with self.routes.lock:
            search = self.routes.joint_search
            try:
                found, spent = search.find_escape(state, order, plan.cost, clock=clock, effort=settings.effort,
                                                  budget=most_nodes)
            except OutOfTime:
                return plan, 0
        return (plan if found is None else self.make_plan(state, found, search.list_goals(state, found),
                                                          "joint search")), spent

    def order_goals(self, state: RoomState) -> tuple[Goal, ...]:
        """Return the goals of an escape from this state in the cheapest order, the exit last.

        Raises:
            PlanningFailed: no escape was found; see its reason.
        """
        self.routes.check_query(state)
        return self.orders.find_goals(state, Clock(self.routes.time_limit), self.routes.settings)

    def plan_onward(self, state: RoomState, order: Sequence[Goal]) -> Plan:
        """Plan the next leg of an escape after noise, within milliseconds.

        For presses with the body, the leg ends where the rest is short, and it can lead to another goal first if that
        order has become shorter. Otherwise it leads to the first goal.

        Args:
            state: present state.
            order: remaining goals in order, such as the result of `order_goals`.

        Raises:
            PlanningFailed: the first goal cannot be reached.
        """
        began = read_clock()
        self.routes.check_query(state, *order)
        by_body = self.instance.dynamics.press_with == "body"
        if self.routes.method in ("auto", "fields") and by_body and can_join(self.instance, order) and (
                not self.rules.has_escaped(state)):
            with self.routes.lock:
                search = self.routes.joint_search
                found = search.find_leg(state, order)
            if found is not None:
                plan = self.make_plan(state, found, search.list_goals(state, found)[:1], "joint search")
                return dataclasses.replace(plan, seconds=read_clock() - began)
        return self.plan(state, order[0])

    def follow_goals(self, state: RoomState, goals: Sequence[Goal], clock: Clock, settings: SearchSettings) -> Plan:
        """Plan to goals in order, each from the end of the leg before.

        Args:
            state: first state.
            goals: the goals.
            clock: time limit.
            settings: settings of each search.

        Raises:
            PlanningFailed: a goal cannot be reached.
            UnsupportedError: one of the goals is a push.
        """
        legs: list[Plan] = []
        here = state
        for goal in goals:
            if isinstance(goal, PushGoal):
                raise UnsupportedError(f"{name_goal(goal, self.instance)} cannot be planned ahead: pushing takes "
                                       "physics. Use pursue(env), which runs in closed loop")
            is_exit = isinstance(goal, ExitGoal)
            route = self.orders.find_exit(here, bool(legs), clock, settings) if is_exit else self.routes.find_route(
                here, goal, None, clock, settings)
            if route.primitives:
                legs.append(self._make_leg(here, goal, route))
                here = legs[-1].states[-1]
        return self._join_legs(state, legs, ", ".join(dict.fromkeys(leg.planner for leg in legs)))

    def list_escapes(self, state: RoomState, count: int, clock: Clock | None = None,
                     settings: SearchSettings | None = None, most_nodes: float = math.inf) -> list[Plan]:
        """Return escapes planned leg by leg, as options make them, the shortest first.

        They follow several of the cheapest orders.

        Args:
            state: first state.
            count: maximum number of escapes.
            clock: time limit of the calling function, or None for the planner's own.
            settings: settings of each search, or None for the planner's own.
            most_nodes: maximum number of search nodes.

        Raises:
            PlanningFailed: no escape was found; see its reason.
            UnsupportedError: the puzzle requires pushes.
        """
        clock, settings = clock or Clock(self.routes.time_limit), settings or self.routes.settings
        first = self._solve_by_legs(state, settings, clock)
        plans = {first.primitives: first}
        for goals in self.orders.list_orders(state, count, clock, settings, most_nodes):
            if most_nodes <= 0:
                break
            try:
                plan = self.follow_goals(state, [*goals, ExitGoal()], clock, settings)
            except PlanningFailed as failure:
                most_nodes -= failure.expansions
                continue
            most_nodes -= plan.expansions
            if self.rules.has_escaped(plan.states[-1]):
                plans.setdefault(plan.primitives, plan)
        return sorted(plans.values(), key=lambda plan: plan.cost)[:count]

    def make_plan(self, state: RoomState, primitives: Sequence[int], goals: Sequence[Goal], planner: str) -> Plan:
        """Make a plan from primitives that reach goals one after another. The last primitive can reach several.

        Raises:
            PlanningFailed: the primitives do not reach the goals.
        """
        self.routes.check_query(state, *goals)
        legs: list[Plan] = []
        here, rest = state, self.routes.check_primitives(primitives)
        for goal in goals:
            if isinstance(goal, ExitGoal) and not rest and self.rules.has_escaped(here):
                break  # reached by the primitive of the last press
            route = self.routes.replay(here, rest, goal)
            if route is None:
                raise self.routes.make_failure(PlanningReason.UNREACHABLE_AT_RESOLUTION, here, goal,
                                               planners=(planner,))
            legs.append(self._make_leg(here, goal, route))
            here, rest = legs[-1].states[-1], rest[legs[-1].cost :]
        return self._join_legs(state, legs, planner)

    def _join_legs(self, state: RoomState, legs: Sequence[Plan], planner: str) -> Plan:
        primitives = tuple(action for leg in legs for action in leg.primitives)
        states = (state, *(s for leg in legs for s in leg.states[1:]))
        escapes = bool(legs) and isinstance(legs[-1].parts[-1].goal, ExitGoal)
        name = "escape" if escapes else ", ".join(leg.name for leg in legs)
        return Plan(self.instance, name, primitives, states, join_parts(legs), planner,
                    sum(leg.expansions for leg in legs), 0.0)

    def _make_leg(self, state: RoomState, goal: Goal, route: Route, seconds: float = 0.0) -> Plan:
        states = self.routes.follow(state, route.primitives)
        name = name_goal(goal, self.instance)
        others = tuple(self.instance.targets[i].name for i in route.also_pressed)
        part = PlanPart(name, goal, 0, len(route.primitives), others)
        return Plan(self.instance, name, route.primitives, states, (part,), route.method, route.expansions,
                    seconds, route.timed_out)


def can_join(room: RoomInstance, order: Sequence[Goal]) -> bool:
    """Return whether these legs can be planned jointly: presses only, without rewards other than steps and exit."""
    is_plain = not (room.props or room.inner_doors or room.has_extra_reward)
    if room.dynamics.press_with == "hand":  # arms that collide, or with many joints, take long
        is_plain &= room.dynamics.kind == "kinematic" and room.robot.joints <= MOST_JOINTS
        is_plain &= 4 * room.reach_x * room.reach_y <= MOST_FLOOR
    return is_plain and all(isinstance(goal, (PressGoal, ExitGoal)) for goal in order)


_PLANNERS: OrderedDict[tuple[str, str], RoomPlanner] = OrderedDict()
_PLANNERS_LOCK = threading.Lock()
KEPT_PLANNERS = 32
"""Maximum number of planners kept in a process, about 4 MB each for a room of 20 m."""


def get_planner(instance: RoomInstance, method: str = "auto") -> RoomPlanner:
    """Return this process's shared planner for a room and a method. The last `KEPT_PLANNERS` are kept."""
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
