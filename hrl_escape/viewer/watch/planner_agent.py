"""The room's planner as an agent that follows one plan of the whole escape, leg by leg, and learns nothing.

Where moves err or slip, or blocks are pushed, no plan foresees the whole escape: there it takes the next goal of the
cheapest order.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable
from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.components.fixed_policy import FixedPolicy
from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import UnsupportedError
from hrl_escape.options.meta_actions import PlannedOption, list_goals, make_meta_options
from hrl_escape.options.option import Option
from hrl_escape.planning.goals import ExitGoal, Goal
from hrl_escape.planning.planner import RoomPlanner
from hrl_escape.planning.route import Route, get_pose

__all__ = ["EscapePlan", "PlannerAgent", "make_legs"]


class EscapePlan:
    """Legs of the planner's escapes, by the state that each begins in.

    Args:
        planner: planner of the room.
    """

    def __init__(self, planner: RoomPlanner) -> None:
        self.planner = planner
        dynamics = planner.instance.dynamics
        self._foresees = dynamics.kind == "kinematic" and not dynamics.is_random
        self._legs: dict[Hashable, tuple[Goal, tuple[int, ...]]] = {}

    def find(self, state: RoomState) -> tuple[Goal, tuple[int, ...]] | None:
        """Goal and primitives of the leg that begins here, of a plan made before; None without one."""
        return self._legs.get((get_pose(state), state.puzzle))

    def choose(self, state: RoomState) -> Goal:
        """The next goal from here, by a plan of the whole escape where that can be foreseen.

        Raises:
            PlanningFailed: there is no escape.
        """
        if self.find(state) is None and self._foresees:
            self._plan(state)
        leg = self.find(state)
        return self.planner.order_goals(state)[0] if leg is None else leg[0]

    def _plan(self, state: RoomState) -> None:
        try:
            plan = self.planner.solve(state)
        except UnsupportedError:  # pushes
            self._foresees = False
            return
        for part in plan.parts:
            begin = plan.states[part.start]
            self._legs[get_pose(begin), begin.puzzle] = part.goal, tuple(plan.primitives[part.start : part.stop])


class _Leg(PlannedOption):
    """A planned option that takes the leg of an escape where one begins, and plans for itself elsewhere."""

    def __init__(self, name: str, plan: EscapePlan, goal: Goal) -> None:
        super().__init__(name, plan.planner, goal)
        self._escape = plan

    def _find_route(self, state: RoomState) -> Route:
        leg = self._escape.find(state)
        route = None
        if leg is not None and leg[0] == self.goal:
            route = self._planner.routes.replay(state, leg[1], self.goal)
        return route or super()._find_route(state)


def make_legs(plan: EscapePlan) -> tuple[Option, ...]:
    """The room's meta-actions, which follow a plan of the whole escape where its legs begin."""
    made = list(make_meta_options(plan.planner.instance, "press", plan.planner))
    for number, option in enumerate(made):
        if type(option) is PlannedOption:
            made[number] = _Leg(option.name, plan, option.goal)
            made[number].about = option.about
    return tuple(made)


@dataclasses.dataclass(frozen=True)
class PlannerSettings:
    """Settings that every agent has."""

    gamma: float = 0.99


class PlannerAgent(FixedPolicy):
    """Agent that chooses what the room's planner would do next.

    Args:
        env: an `OptionsEnv` over the legs of the plan, without primitives.
        plan: the plan.
    """

    Settings: ClassVar[type] = PlannerSettings

    def __init__(self, env: gymnasium.Env, plan: EscapePlan) -> None:
        self.settings = PlannerSettings()
        self._room: Any = env.unwrapped
        self._plan = plan
        self._goals = [*list_goals(plan.planner.instance), ExitGoal()]

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """The leg of the plan that begins here.

        Raises:
            PlanningFailed: no order leads out.
        """
        del observation, action_mask
        return self._goals.index(self._plan.choose(self._room.get_state()))
