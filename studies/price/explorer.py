"""A flat learner whose random choices last: planned options, or one primitive repeated as long as these last.

It values, learns from and greedily chooses primitives alone, so that options serve exploration and nothing else. A
random choice is begun so seldom that the share of primitives that are random is epsilon, as without.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.agents.components.exploration import choose_best, compute_epsilon, sample_legal
from studies.price.over_primitives import PrimitivesDQN, PrimitivesSettings, read_room

__all__ = ["ExploringDQN", "ExploringSettings", "make_explorer"]


@dataclass(frozen=True)
class ExploringSettings(PrimitivesSettings):
    """Settings of `ExploringDQN`, beside those of `dqn`."""

    explores_by: Literal["options", "repeats"] = "options"
    """Kind of a random choice; a repeat's length is that of an option."""


class ExploringDQN(PrimitivesDQN):
    """`dqn` whose random choices last."""

    Settings: ClassVar[type] = ExploringSettings
    settings: ExploringSettings  # pyright: ignore[reportIncompatibleVariableOverride]
    STATE = ("_repeated",)

    def __init__(self, observation_space: gymnasium.Space, seed: int, settings: ExploringSettings) -> None:
        super().__init__(observation_space, seed, settings)
        self._repeated = (0, 0)  # a primitive, and for how many decisions more

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Begin a random choice, go on with it, or take the best primitive of the online network."""
        settings, (choice, left) = self.settings, self._repeated
        legal = self.cut(action_mask)
        if left and legal[choice]:
            self._repeated = choice, left - 1
            return choice
        epsilon, length = compute_epsilon(settings, self._schedule.steps), float(np.mean(settings.lengths))
        if self._action_rng.random() >= epsilon / (epsilon + length * (1 - epsilon)):
            return choose_best(self.values.online.compute(self._encoder.encode(observation)), legal)
        if settings.explores_by == "options" and len(options := self.list_options(action_mask)):
            return int(self._action_rng.choice(options))
        choice = sample_legal(legal, self._action_rng)
        self._repeated = choice, int(self._action_rng.choice(settings.lengths)) - 1
        return choice

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Learn from each primitive of the decision as if it had been chosen."""
        if transition.terminated or transition.truncated:
            self._repeated = (0, 0)
        told: Mapping[str, float] = {}
        mask = transition.action_mask
        for number, step in enumerate(transition.trace, 1):
            is_last = number == len(transition.trace)
            after = transition.next_action_mask if is_last else step.next_action_mask.astype(np.bool_)
            reward = float(step.reward)
            told = super().observe(transition._replace(
                observation=step.observation, action=int(step.action), action_mask=self.cut(mask),
                reward=reward, summed_reward=reward, duration=1, discount=self.gamma,
                next_observation=step.next_observation, next_action_mask=self.cut(after),
                terminated=is_last and transition.terminated, truncated=is_last and transition.truncated, trace=()))
            mask = after
        return told


def make_explorer(explores_by: Literal["options", "repeats"], env: Any, seed: int, settings: Mapping[str, Any]
                  ) -> ExploringDQN:
    """Make the learner for an `OptionsEnv` with primitives and traces; see `read_room`."""
    changed = {**settings, "explores_by": explores_by}
    return ExploringDQN(env.observation_space, seed, read_room(ExploringSettings, env, changed))
