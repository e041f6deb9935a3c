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
        self._policy: Any = None

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Next primitive of the plan."""
        del observation
        from hrl_escape.planning.rollouts import Replanner  # brings the planners in

        begins = len(self._recorder.states) == 1
        if begins:
            self._policy = Replanner(self._env.unwrapped.instance)
        primitive = self._policy.choose(self._recorder.states[-1], begins)
        return int(np.flatnonzero(action_mask)[-1]) if primitive is None else primitive


def make_reference(name: str, env: gymnasium.Env, recorder: StateRecorder) -> Reference:
    """Make the reference of this name.

    Args:
        name: one of `REFERENCES`.
        env: its environment, with options for `smdp-index-order`.
        recorder: around the flat room.
    """
    return (IndexOrder if name == INDEX_ORDER else PlanFollower)(env, recorder)
