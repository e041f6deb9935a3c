"""Costs of plans by objective, and bounds of them that no plan undercuts."""

from __future__ import annotations

import math

import numpy as np

from hrl_escape.env.geometry import compute_distance, compute_distance_many, stack_footprints
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.planning.goals import Goal
from hrl_escape.planning.lower_bounds import LegBounds
from hrl_escape.planning.plan import Plan
from hrl_escape.planning.requests.request import PlanningRequest
from hrl_escape.planning.trajectories.limits import compute_duration, compute_rest_to_rest

__all__ = ["bound_cost", "compute_lacking_clearance", "compute_plan_cost"]

WANTED = 1.0
"""Clearance beyond which more is worth nothing, m."""
MEASURED_EVERY = 0.05
"""Distance of the places at which a plan's clearance is measured, m."""


def compute_plan_cost(plan: Plan, request: PlanningRequest) -> float:
    """Cost of a plan by a request's objective."""
    if request.objective == "primitives":
        return float(plan.cost)
    if request.objective == "length":
        return float(np.hypot(*np.diff(plan.path, axis=0).T).sum())
    if request.objective == "clearance":
        return compute_lacking_clearance(plan)
    robot = plan.instance.robot
    return compute_duration(plan.states, request.limits, math.radians(robot.turn_step_deg),
                            math.radians(robot.joint_step_deg))


def compute_lacking_clearance(plan: Plan) -> float:
    """Metres of the base's way, each weighted by the share of one metre of clearance that the body lacks there."""
    solids = stack_footprints([solid.footprint for solid in plan.instance.solids])
    total = 0.0
    for (x, y), (to_x, to_y) in zip(plan.path, plan.path[1:], strict=False):
        length = math.hypot(to_x - x, to_y - y)
        if length == 0.0:
            continue
        count = math.ceil(length / MEASURED_EVERY)
        shares = (np.arange(count) + 0.5) / count
        places = np.stack([x + shares * (to_x - x), y + shares * (to_y - y)], axis=1)
        clearance = compute_distance_many(places, solids) - plan.instance.robot.outer_radius
        total += length * float(np.clip(1.0 - clearance / WANTED, 0.0, 1.0).mean())
    return total


def bound_cost(instance: RoomInstance, state: RoomState, goals: tuple[Goal, ...], request: PlanningRequest,
               primitives: float) -> float:
    """Bound of the cost of every plan that reaches goals in order.

    Args:
        instance: the room.
        state: first state.
        goals: in order.
        request: says by which objective.
        primitives: bound of the number of primitives.
    """
    if request.objective == "primitives":
        return primitives
    if request.objective == "clearance":
        return 0.0
    bounds = LegBounds(instance)
    metres = 0.0
    for goal in goals:
        shape, reach = bounds.get_area(goal)
        metres = max(metres, compute_distance(state.x, state.y, shape) - reach)
    if request.objective == "length" or metres == 0.0:
        return metres
    return compute_rest_to_rest(metres, request.limits.speed, request.limits.acceleration)
