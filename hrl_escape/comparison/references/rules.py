"""References by rule: rounds of all buttons, and the planner that knows the dependency graph.

`smdp-index-order` presses buttons 1, 2, ..., n and then leaves, over and over: the score that needs no knowledge of a
room. `smdp-shuffled-round` does the same in an order drawn anew for each episode: where numbers say nothing of the
dependency graph, the two are equally good, but for chance. `planner` knows the dependency graph and follows the best
known plan: the score by which efficiency is measured.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.components.fixed_policy import FixedPolicy
from hrl_escape.comparison.episodes import StateRecorder


@dataclasses.dataclass(frozen=True)
class ReferenceSettings:
    """Settings that every agent has."""

    gamma: float = 0.99


class Reference(FixedPolicy):
    """Rule that reads the environment itself.

    Attributes:
        RULE: what it does, to follow its name and "which".
    """

    Settings: ClassVar[type] = ReferenceSettings
    RULE: ClassVar[str]

    def __init__(self, env: gymnasium.Env, recorder: StateRecorder) -> None:
        self.settings = ReferenceSettings()
        self._env: Any = env
        self._recorder = recorder


class IndexOrder(Reference):
    """Options in the order of their numbers, the exit last, then from the first again."""

    RULE = "presses all buttons in the order of their numbers"

    def __init__(self, env: gymnasium.Env, recorder: StateRecorder) -> None:
        super().__init__(env, recorder)
        names, options = (self._env.get_wrapper_attr(name) for name in ("action_names", "options"))
        self._order: Sequence[int] = range(len(names) - len(options), len(names))
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


class ShuffledRound(IndexOrder):
    """Options in an order that is drawn for the episode, the exit last, then from the first again."""

    RULE = "presses all buttons in an order drawn for the episode"

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Next option in order that may be taken; an episode begins with a new order."""
        if len(self._recorder.states) == 1:
            *buttons, leave = sorted(self._order)  # the exit has the last number
            self._order = [*rng.permutation(buttons).tolist(), leave]
        return self.act(observation, action_mask)


class PlanFollower(Reference):
    """Best known plan, made anew where noise has led away from it; stands where there is none."""

    RULE = "follows the best known plan"

    def __init__(self, env: gymnasium.Env, recorder: StateRecorder) -> None:
        super().__init__(env, recorder)
        self._policy: Any = None

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Next primitive of the plan."""
        del observation
        from hrl_escape.planning.best_known import Replanner  # brings the planners in

        begins = len(self._recorder.states) == 1
        if begins:
            self._policy = Replanner(self._env.unwrapped.instance)
        primitive = self._policy.choose(self._recorder.states[-1], begins)
        return int(np.flatnonzero(action_mask)[-1]) if primitive is None else primitive
