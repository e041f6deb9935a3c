"""Legs of plans against the straight-line bound that prunes the search for their order."""

from __future__ import annotations

from hrl_escape.env.instance import RoomInstance
from hrl_escape.planning.goals import make_goal
from hrl_escape.planning.lower_bounds import LegBounds
from hrl_escape.planning.plan import Plan


def assert_legs_cost_at_least_their_bounds(plan: Plan, instance: RoomInstance) -> None:
    bounds = LegBounds(instance)
    by_goal = {make_goal(op, instance): op for op in instance.puzzle.symbolic.make_symbolic_model().operators}
    last = None
    for part in plan.parts:
        then = by_goal.get(part.goal)
        bound = bounds.bound_leg(last, then) if last else bounds.bound_start(plan.states[0], then)
        assert bounds.bound_leg(last, then) <= bound <= part.stop - part.start
        last = then
