"""`PlanningRequest` and `PlanningResult`: a planning call and its outcome as values.

`RoomPlanner.answer` turns one into the other. A result is a function of room and request alone,
on any machine, unless the request sets a time limit or another thread cancels the call.
"""

from __future__ import annotations

import dataclasses
import math
import numbers
from collections.abc import Sequence
from typing import Any, Literal, get_args

from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import ConfigError, PlanningFailed, PlanningReason
from hrl_escape.planning.clock import Clock
from hrl_escape.planning.goals import Goal
from hrl_escape.planning.plan import Plan
from hrl_escape.planning.route import check_budget
from hrl_escape.planning.trajectories.limits import MotionLimits

__all__ = ["Objective", "PlanningRequest", "PlanningResult"]

Objective = Literal["primitives", "length", "clearance", "time"]


@dataclasses.dataclass(frozen=True)
class PlanningRequest:
    """A planning call.

    Attributes:
        state: first state.
        goal: a goal or its text; several, to be reached in this order; or None for the whole escape.
        method: as in `RoomPlanner`; None for the planner's own.
        budget: search nodes that may be expanded; None for the planner's own.
        time_limit: limit of the call, s; None for none. With one, the result may depend on the machine.
        objective: cost to keep low. `primitives`: their number. `length`: metres that the base travels. `clearance`:
            these metres, each weighted by how much of one metre of clearance it lacks. `time`: seconds under `limits`.
        limits: speeds and accelerations, for the objective `time`.
        improve: go on after the first plan until the budget is spent or the lower bound is met. Objectives other than
            `primitives` always compare several plans.
        seed: of randomised path planners.
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
        Clock(self.time_limit)  # refuses what is no limit
        if isinstance(self.goal, Sequence) and not isinstance(self.goal, str) and not self.goal:
            raise ConfigError("request.goal", self.goal, "at least one goal, or None for the escape")


@dataclasses.dataclass(frozen=True)
class PlanningResult:
    """Outcome of a planning call.

    Attributes:
        request: what was asked.
        status: `"reached"`, or the reason for which there is no plan.
        plan: the best plan found; None without one.
        cost: its cost by the request's objective; infinity without a plan.
        lower_bound: no plan costs less.
        method: search that found the plan, such as `fields` or `RRTConnect`; empty without a plan.
        spent: search nodes expanded; those of remembered routes count again.
        seconds: wall time, without compilation.
        cut_short: the time limit, or a cancellation, ended the call; without it the plan may be better.
        failure: the error that says why there is no plan; None with a plan.
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
        """The request's seed."""
        return self.request.seed

    @property
    def gap(self) -> float:
        """Largest share by which the plan may cost more than the best one; infinity without a plan or a bound."""
        if self.cost <= self.lower_bound:
            return 0.0
        return self.cost / self.lower_bound - 1.0 if self.lower_bound > 0.0 else math.inf

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; numbers that are infinite become None."""
        return {
            "status": self.status if isinstance(self.status, str) and self.status == "reached" else str(
                PlanningReason(self.status).value),
            "objective": self.request.objective, "cost": self.cost if math.isfinite(self.cost) else None,
            "lower_bound": self.lower_bound, "method": self.method, "spent": self.spent, "seconds": self.seconds,
            "seed": self.seed, "cut_short": self.cut_short, "plan": self.plan and self.plan.to_dict(),
            "failure": None if self.failure is None else str(self.failure),
        }
