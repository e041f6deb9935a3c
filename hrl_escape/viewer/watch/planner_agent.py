"""The room's planner as an agent: it chooses the next meta-action of the cheapest order and learns nothing."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.components.fixed_policy import FixedPolicy
from hrl_escape.options.meta_actions import list_goals
from hrl_escape.planning.goals import ExitGoal
from hrl_escape.planning.planner import RoomPlanner

__all__ = ["PlannerAgent"]


@dataclasses.dataclass(frozen=True)
class PlannerSettings:
    """Settings that every agent has."""

    gamma: float = 0.99


class PlannerAgent(FixedPolicy):
    """Agent that chooses what the room's planner would do next.

    Args:
        env: an `OptionsEnv` without primitives.
        planner: planner of the room.
    """

    Settings: ClassVar[type] = PlannerSettings

    def __init__(self, env: gymnasium.Env, planner: RoomPlanner) -> None:
        self.settings = PlannerSettings()
        self._room: Any = env.unwrapped
        self._planner = planner
        self._goals = [*list_goals(planner.instance), ExitGoal()]

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """The first goal of the cheapest order of those left.

        Raises:
            PlanningFailed: no order leads out.
        """
        del observation, action_mask
        return self._goals.index(self._planner.order_goals(self._room.get_state())[0])
