"""References beside the learners of a comparison: policies by rule, evaluated on the same episodes without training.

`smdp-index-order` presses buttons 1, 2, ..., n and then leaves, over and over: the score that needs no knowledge of a
room. `planner` knows the dependency graph and follows the best known plan: the score by which efficiency is measured.
"""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.components.fixed_policy import FixedPolicy
from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import EscapeError
from hrl_escape.experiments.episodes import StateRecorder

__all__ = ["INDEX_ORDER", "PLANNER", "REFERENCES", "make_reference"]

INDEX_ORDER, PLANNER = "smdp-index-order", "planner"
REFERENCES = (INDEX_ORDER, PLANNER)


@dataclasses.dataclass(frozen=True)
class ReferenceSettings:
    """Settings that every agent has."""

    gamma: float = 0.99


class Reference(FixedPolicy):
    """Rule that reads the environment itself."""

    Settings: ClassVar[type] = ReferenceSettings

    def __init__(self, env: gymnasium.Env, recorder: StateRecorder) -> None:
        self.settings = ReferenceSettings()
        self._env: Any = env
        self._recorder = recorder


class IndexOrder(Reference):
    """Options in the order of their numbers, the exit last, then from the first again."""

    def __init__(self, env: gymnasium.Env, recorder: StateRecorder) -> None:
        super().__init__(env, recorder)
        names, options = (self._env.get_wrapper_attr(name) for name in ("action_names", "options"))
        self._order = range(len(names) - len(options), len(names))
        self._next = 0

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Next option in order that may be taken; the first one where an episode begins."""
        del observation
        if len(self._recorder.states) == 1:
            self._next = 0
        for _ in self._order:
            action = self._order[self._next % len(self._order)]
            self._next += 1
            if action_mask[action]:
                return action
        return int(np.flatnonzero(action_mask)[0])


class PlanFollower(Reference):
    """Best known plan, made anew where noise has led away from it; stands where there is none."""

    def __init__(self, env: gymnasium.Env, recorder: StateRecorder) -> None:
        super().__init__(env, recorder)
        self._primitives: tuple[int, ...] = ()
        self._states: tuple[RoomState, ...] = ()

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Next primitive of the plan."""
        del observation
        from hrl_escape.planning.plan import strip

        here, begins = self._recorder.states[-1], len(self._recorder.states) == 1
        if begins or not self._primitives or strip(here) != strip(self._states[0]):
            self._plan(here, begins)
        if not self._primitives:
            return int(np.flatnonzero(action_mask)[-1])
        action, self._primitives, self._states = self._primitives[0], self._primitives[1:], self._states[1:]
        return action

    def _plan(self, state: RoomState, begins: bool) -> None:
        from hrl_escape.planning.best_known import find_best_known  # these bring the planners in
        from hrl_escape.planning.room_planner import get_planner

        instance = self._env.unwrapped.instance
        try:
            plan = find_best_known(instance, state).plan if begins else get_planner(instance).solve(state)
        except EscapeError:
            plan = None
        self._primitives, self._states = (plan.primitives, plan.states) if plan else ((), ())


def make_reference(name: str, env: gymnasium.Env, recorder: StateRecorder) -> Reference:
    """Make the reference of this name.

    Args:
        name: one of `REFERENCES`.
        env: its environment, with options for `smdp-index-order`.
        recorder: around the flat room.
    """
    return (IndexOrder if name == INDEX_ORDER else PlanFollower)(env, recorder)
