"""References beside the learners of a comparison: policies by rule, evaluated on the same episodes without training.

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
from hrl_escape.comparison.episodes import StateRecorder, find_recorder
from hrl_escape.ladder.sequence import SequenceEnv

__all__ = ["INDEX_ORDER", "PLANNER", "REFERENCES", "SHUFFLED_ROUND", "make_reference"]

INDEX_ORDER, SHUFFLED_ROUND, PLANNER = "smdp-index-order", "smdp-shuffled-round", "planner"
REFERENCES = (INDEX_ORDER, SHUFFLED_ROUND, PLANNER)


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

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Next option in order that may be taken; an episode begins with a new order."""
        if len(self._recorder.states) == 1:
            *buttons, leave = sorted(self._order)  # the exit has the last number
            self._order = [*rng.permutation(buttons).tolist(), leave]
        return self.act(observation, action_mask)


class PlanFollower(Reference):
    """Best known plan, made anew where noise has led away from it; stands where there is none."""

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


class Climber(FixedPolicy):
    """A reference on every floor of a tower."""

    Settings: ClassVar[type] = ReferenceSettings

    def __init__(self, name: str, tower: SequenceEnv) -> None:
        self.settings = ReferenceSettings()
        self._tower = tower
        self._players = {id(floor.unwrapped): make_reference(name, floor, find_recorder(floor))
                         for floor in tower.floors}

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Action of the reference on the present floor."""
        return self._players[id(self._tower.unwrapped)].act(observation, action_mask)


def make_reference(name: str, env: gymnasium.Env, recorder: StateRecorder) -> FixedPolicy:
    """Make the reference of this name.

    Args:
        name: one of `REFERENCES`.
        env: its environment, with options for all but `planner`.
        recorder: around the flat room; of a tower the recorders on its floors count.
    """
    if isinstance(env, SequenceEnv) and len(env.floors) > 1:
        return Climber(name, env)
    return {INDEX_ORDER: IndexOrder, SHUFFLED_ROUND: ShuffledRound, PLANNER: PlanFollower}[name](env, recorder)
