"""`PlanningRequest` and `PlanningResult`: a planning call and its outcome as values.

Without a time limit or a cancellation, a result is a function of room and request on every machine. After the first
plan, an anytime call compares more plans in a fixed order. For fewer primitives, later searches reduce the weight of
the heuristic. For other objectives, routes keep growing distances from solids, or follow paths of asymptotically
optimal path planners.
"""

from __future__ import annotations

import dataclasses
import math
import numbers
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from hrl_escape.clock import Clock
from hrl_escape.env.geometry import compute_distance, compute_distance_many, stack_footprints
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.robot import make_robot
from hrl_escape.errors import ConfigError, PlanningFailed, PlanningReason
from hrl_escape.planning.areas import grow_solids
from hrl_escape.planning.goals import Goal
from hrl_escape.planning.lower_bounds import LegBounds
from hrl_escape.planning.motion.limits import MotionLimits, compute_duration, compute_rest_to_rest
from hrl_escape.planning.plan import Plan
from hrl_escape.planning.props import list_obstacles
from hrl_escape.planning.route import EFFORTS, PlanningReport, Route, SearchSettings, check_budget

if TYPE_CHECKING:
    from hrl_escape.planning.routes import Routes

Objective = Literal["primitives", "length", "clearance", "time"]


@dataclasses.dataclass(frozen=True)
class PlanningRequest:
    """A planning call.

    Attributes:
        state: first state.
        goal: a goal or its text; several, to be reached in this order; or None for the whole escape.
        method: as in `RoomPlanner`, or None for the planner's own.
        budget: maximum number of expanded search nodes, or None for the planner's own.
        time_limit: limit of the call, s, or None. With a limit, the result can depend on the machine.
        objective: cost to minimise. `primitives`: their number. `length`: metres that the base travels. `clearance`:
            these metres, each weighted by how far it falls short of one metre of clearance. `time`: seconds under
            `limits`.
        limits: speeds, accelerations and jerks, for the objective `time`.
        improve: continue after the first plan until the budget is spent or the lower bound is met. Objectives other
            than `primitives` always compare several plans.
        seed: seed of randomised path planners.
    """

    state: RoomState
    goal: Goal | str | tuple[Goal | str, ...] | None = None
    method: str | None = None
    budget: int | None = None
    time_limit: float | None = None
    objective: Objective = "primitives"
    limits: MotionLimits = MotionLimits()
    improve: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        if self.objective not in get_args(Objective):
            raise ConfigError("request.objective", self.objective, f"one of {', '.join(get_args(Objective))}")
        if isinstance(self.seed, bool) or not isinstance(self.seed, numbers.Integral) or not 0 <= self.seed < 2**32:
            raise ConfigError("request.seed", self.seed, f"a whole number from 0 to {2**32 - 1}")
        if self.budget is not None:
            check_budget(self.budget)
        Clock(self.time_limit)  # raises for an invalid limit
        if isinstance(self.goal, Sequence) and not isinstance(self.goal, str) and not self.goal:
            raise ConfigError("request.goal", self.goal, "at least one goal, or None for the escape")


@dataclasses.dataclass(frozen=True)
class PlanningResult:
    """Outcome of a planning call.

    Attributes:
        request: the request.
        status: `"reached"`, or the reason of a failure.
        plan: the best plan found, or None.
        cost: cost of the plan by the request's objective; infinity without a plan.
        lower_bound: lower bound of the cost of every plan.
        method: search that found the plan, such as `fields` or `RRTConnect`; empty without a plan.
        spent: search nodes expanded; nodes of cached routes count again.
        seconds: wall time without compilation, s.
        cut_short: whether a time limit or a cancellation ended the call.
        failure: the error that explains a missing plan, or None.
    """

    request: PlanningRequest
    status: Literal["reached"] | PlanningReason
    plan: Plan | None
    cost: float
    lower_bound: float
    method: str
    spent: int
    seconds: float
    cut_short: bool = False
    failure: PlanningFailed | None = None

    @property
    def seed(self) -> int:
        """Return the seed of the search, from the request."""
        return self.request.seed

    @property
    def gap(self) -> float:
        """Return an upper bound of the plan's excess cost, as a share of the best cost.

        It is infinity without a plan or a bound.
        """
        if self.cost <= self.lower_bound:
            return 0.0
        return self.cost / self.lower_bound - 1.0 if self.lower_bound > 0.0 else math.inf

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON. Infinite numbers become None."""
        return {
            "status": self.status.value if isinstance(self.status, PlanningReason) else self.status,
            "objective": self.request.objective, "cost": self.cost if math.isfinite(self.cost) else None,
            "lower_bound": self.lower_bound, "method": self.method, "spent": self.spent, "seconds": self.seconds,
            "seed": self.seed, "cut_short": self.cut_short, "plan": self.plan and self.plan.to_dict(),
            "failure": None if self.failure is None else str(self.failure),
        }


WANTED = 1.0
"""Clearance beyond which more has no value, m."""
MEASURED_EVERY = 0.05
"""Distance between places where the clearance of a plan is measured, m."""


def compute_plan_cost(plan: Plan, request: PlanningRequest) -> float:
    """Return the cost of a plan by a request's objective."""
    if request.objective == "primitives":
        return float(plan.cost)
    if request.objective == "length":
        return float(np.hypot(*np.diff(plan.path, axis=0).T).sum())
    if request.objective == "clearance":
        return compute_lacking_clearance(plan)
    config = plan.instance.robot
    return compute_duration(plan.states, request.limits, make_robot(config), math.radians(config.turn_step_deg))


def compute_lacking_clearance(plan: Plan) -> float:
    """Return the metres travelled by the base, weighted by the missing share of one metre of clearance."""
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
    """Return a lower bound of the cost of every plan that reaches goals in order.

    `primitives` is a lower bound of their number.
    """
    if request.objective == "primitives":
        return primitives
    if request.objective == "clearance":
        return 0.0
    bounds = LegBounds(instance)
    metres = 0.0
    for area in bounds.list_areas(state, goals):
        if area is not None:
            metres = max(metres, compute_distance(state.x, state.y, area[0]) - area[1])
    if request.objective == "length" or metres == 0.0:
        return metres
    return compute_rest_to_rest(metres, request.limits.speed, request.limits.acceleration, request.limits.jerk)


WAY_MARGINS = (0.1, 0.2, 0.35, 0.5, 0.75, 1.0)
"""Distances that routes keep from solids, m."""
PATH_PLANNERS = ("BITstar", "InformedRRTstar")
"""Path planners with short or improving paths."""


def iterate_routes(routes: Routes, state: RoomState, goal: Goal, request: PlanningRequest,
                   settings: SearchSettings, clock: Clock) -> Iterator[Route]:
    """Yield routes to one goal after the first one, until the nodes of `settings.budget` are spent.

    Failures are skipped.

    They come from searches with lower and lower heuristics, then with growing margins, then along paths of path
    planners.
    """
    def find(way: int | float | str) -> Route:
        """Return the route of one effort, with a margin or along the path of a planner."""
        rest = settings._replace(budget=left)
        if isinstance(way, float):
            keep_out = (*list_obstacles(state, routes.instance)[-1], *grow_solids(routes.instance, state, goal, way))
            return routes.find_route_around(state, goal, keep_out, left, PlanningReport(), refine=False, clock=clock)
        rest = rest._replace(method=way) if isinstance(way, str) else rest._replace(effort=way)
        return routes.find_route(state, goal, None, clock, rest)

    left = settings.budget
    others = () if request.objective == "primitives" else (*WAY_MARGINS, *PATH_PLANNERS)
    for way in (*range(1, len(EFFORTS) + 1), *others):
        try:
            route = find(way)
        except PlanningFailed as failure:
            left -= failure.expansions
        else:
            left -= route.expansions
            yield route
        if left <= 0 or clock.is_up():
            return
