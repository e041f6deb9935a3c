"""`TaskMotionPlanner`: a room's task for planners without geometry, with costs and constraints from motion.

A task is exported as PDDL whose actions cost the primitives of their legs. Legs without a motion are left out. The
room's planner carries out the plan of an external planner. A leg that fails becomes a constraint, and the task is
solved again. Solving requires the extra `pddl`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any

from hrl_escape.clock import Clock
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.puzzles.symbolic import Operator, SymbolicModel
from hrl_escape.errors import PlanningFailed, PlanningReason, UnknownNameError, UnsupportedError
from hrl_escape.planning.goals import LEAVE, ExitGoal, Goal, PushGoal, make_goal
from hrl_escape.planning.plan import Plan
from hrl_escape.planning.planner import RoomPlanner
from hrl_escape.planning.symbolic.pddl import clean_name, make_domain, make_problem, read_problem, run_engine

START = "start"
DOMAIN, ESCAPED = "task-and-motion", "escaped"
_LEAVING = Operator(LEAVE, "exit", LEAVE, frozenset(), frozenset(), frozenset(), frozenset())
MOST_ROUNDS = 50
"""Maximum number of plans of the symbolic planner for one task."""


class TaskMotionPlanner:
    """Task of one room with the costs of its motion.

    Actions are named `press-button-2-from-press-button-1`, and `go-to-exit-from-press-button-2` for the exit. `start`
    is the place of the first state.

    Args:
        planner: the room's planner.

    Raises:
        UnsupportedError: the puzzle requires pushes, whose effect cannot be predicted.
    """

    def __init__(self, planner: RoomPlanner) -> None:
        self.planner = planner
        room = planner.instance
        self._model = room.symbolic_model
        if any(isinstance(make_goal(op, room), PushGoal) for op in self._model.operators):
            raise UnsupportedError(f"a {room.puzzle.kind} task cannot be planned ahead: pushing takes physics. "
                                   "Use pursue(env), which runs in closed loop")
        if any(op.when for op in self._model.operators):
            raise UnsupportedError(f"a {room.puzzle.kind} task has conditional effects, which are not written out: "
                                   "use export_pddl, or RoomPlanner.solve")
        self._operators = {clean_name(op.name): op for op in self._model.operators}

    # --- export of the task -----------------------------------------------------------------

    def compute_costs(self, state: RoomState, goals: Iterable[str] | None = None) -> dict[tuple[str, str], int]:
        """Return the primitives of each feasible leg, by (previous place, operator or `go-to-exit`).

        The previous place is `start` or an operator. The leg begins where this operator ends if it comes first,
        otherwise where it ends after the first operator that can reach it.

        Args:
            state: first state.
            goals: facts to make true; without them the task is the escape, with legs to the exit.
        """
        self.planner.routes.check_query(state)
        ends, costs, queue = {START: state}, {}, [START]
        while queue:
            before = queue.pop(0)
            for name, op in self._operators.items():
                if name == before:
                    continue
                found = self._try_leg(ends[before]._replace(puzzle=state.puzzle), make_goal(op, self.planner.instance))
                if found is None:
                    continue
                costs[before, name] = found[0]
                if name not in ends:
                    ends[name] = found[1]
                    queue.append(name)
            if goals is None:
                leaving = self._try_leg(ends[before]._replace(puzzle=self.planner.orders.solved_puzzle), ExitGoal())
                if leaving is not None:
                    costs[before, LEAVE] = max(1, leaving[0])
        return costs

    def _try_leg(self, begin: RoomState, goal: Goal) -> tuple[int, RoomState] | None:
        try:
            route = self.planner.routes.find_route(begin, goal)
        except PlanningFailed:
            return None
        return len(route.primitives), self.planner.routes.follow(begin, route.primitives)[-1]

    def export(self, state: RoomState, goals: Iterable[str] | None = None,
               forbidden: Iterable[tuple[str, str]] = ()) -> tuple[str, str]:
        """Write the task as PDDL with action costs.

        Args:
            state: first state.
            goals: facts to make true, such as `on(button-2)`, or None for the escape.
            forbidden: legs (previous place, operator or `go-to-exit`) to leave out.

        Returns:
            Domain and problem, as text.

        Raises:
            UnknownNameError: a goal is not a fact of the puzzle.
        """
        wanted = self._model.goal if goals is None else frozenset(goals)
        for fact in wanted:
            if fact not in self._model.propositions:
                raise UnknownNameError("fact", fact, self._model.propositions)
        barred, operators = set(forbidden), []
        for (before, name), cost in self.compute_costs(state, goals).items():
            if (before, name) in barred:
                continue
            here = frozenset({_name_place(before)})
            op, there = _LEAVING, frozenset({ESCAPED})
            if name != LEAVE:
                op, there = self._operators[name], frozenset({_name_place(name)})
            needs = wanted if name == LEAVE else op.preconditions
            operators.append(dataclasses.replace(
                op, name=f"{name}-from-{before}", preconditions=needs | here, add=op.add | there,
                delete=op.delete | here, cost=float(cost)))
        places = map(_name_place, (START, *self._operators))
        model = SymbolicModel((*self._model.propositions, *places, ESCAPED), tuple(operators),
                              frozenset({ESCAPED}) if goals is None else wanted)
        facts = self.planner.instance.puzzle.symbolic.get_facts(state.puzzle) | {_name_place(START)}
        return make_domain(model, DOMAIN), make_problem(model, facts, f"room-{self.planner.instance.id}", DOMAIN)

    def make_problem(self, state: RoomState, goals: Iterable[str] | None = None,
                     forbidden: Iterable[tuple[str, str]] = ()) -> Any:
        """Make a `Problem` of unified-planning; arguments as in `export`.

        Raises:
            MissingExtraError: unified-planning is not installed.
        """
        return read_problem(*self.export(state, goals, forbidden))

    # --- an external plan ------------------------------------------------------------

    def follow(self, state: RoomState, actions: Any) -> Plan:
        """Plan the motion of an external planner's plan, each leg from the end of the one before.

        Args:
            state: first state.
            actions: a sequential plan of unified-planning, or names of actions or operators, in order.

        Returns:
            The plan of primitives, checked by replay.

        Raises:
            PlanningFailed: a leg has no motion, or the preconditions of an operator do not hold at its turn.
            UnknownNameError: no action has this name.
        """
        names = _list_names(actions)
        goals = [self._find_goal(name) for name in names]
        facts = self.planner.instance.puzzle.symbolic.get_facts(state.puzzle)
        for name, goal in zip(names, goals, strict=True):
            if isinstance(goal, ExitGoal):
                continue
            op = self._operators[_get_operator(name)]
            if not op.is_applicable(facts):
                raise self.planner.routes.make_failure(PlanningReason.PRECONDITION_UNMET, state, goal,
                                                advice=f"{name} needs {', '.join(sorted(op.preconditions - facts))}")
            facts = op.apply(facts)
        routes = self.planner.routes
        return self.planner.follow_goals(state, goals, Clock(routes.time_limit), routes.settings)

    def _find_goal(self, name: str) -> Goal:
        operator = _get_operator(name)
        if operator == LEAVE:
            return ExitGoal()
        if operator not in self._operators:
            raise UnknownNameError("action", name, (*self._operators, LEAVE))
        return make_goal(self._operators[operator], self.planner.instance)

    def solve(self, state: RoomState, goals: Iterable[str] | None = None, *, engine: str = "fast-downward-opt",
              forbidden: Iterable[tuple[str, str]] = (), time_limit: float = 30.0) -> Plan:
        """Solve the task with a planner of unified-planning and plan the motion of its answer.

        Args:
            state: first state.
            goals: facts to make true, or None for the escape.
            engine: name of a planner of unified-planning; `fast-downward-opt` minimises the cost.
            forbidden: legs to leave out.
            time_limit: limit of each call of the engine, s.

        Raises:
            MissingExtraError: unified-planning is not installed.
            PlanningFailed: no solution has a feasible motion.
        """
        barred = set(forbidden)
        for _ in range(MOST_ROUNDS):
            plan, status = run_engine(self.make_problem(state, goals, barred), engine, time_limit)
            if plan is None:
                reason = PlanningReason.TIMEOUT if status == "TIMEOUT" else PlanningReason.PRECONDITION_UNMET
                raise self.planner.routes.make_failure(reason, state, None, planners=(engine,),
                                                       nearest=f"status {status}")
            names = _list_names(plan)
            here = state
            for before, name in zip([START, *map(_get_operator, names)], names, strict=False):
                try:
                    here = self.follow(here, [name]).states[-1]
                except PlanningFailed:
                    barred.add((before, _get_operator(name)))
                    break
            else:
                return self.follow(state, names)
        raise self.planner.routes.make_failure(PlanningReason.BUDGET_EXHAUSTED, state, None, planners=(engine,))


def _name_place(place: str) -> str:
    """Return the fact that the robot is where an operator ends, or at the start."""
    return f"at(place-{place})"


def _list_names(actions: Any) -> list[str]:
    """Return the names of the actions of a plan of unified-planning, or the names themselves."""
    return [a if isinstance(a, str) else a.action.name for a in getattr(actions, "actions", actions)]


def _get_operator(action: str) -> str:
    return action.partition("-from-")[0]
