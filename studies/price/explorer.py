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
from hrl_escape.agents.components.exploration import choose_best, compute_epsilon, make_rng, sample_legal
from hrl_escape.agents.decisions import Decisions, Moments, make_decision
from studies.price.over_primitives import PrimitivesDQN, PrimitivesSettings, read_room

__all__ = ["ExploringDQN", "ExploringSettings", "make_explorer"]


@dataclass(frozen=True, kw_only=True)
class ExploringSettings(PrimitivesSettings):
    """Settings of `ExploringDQN`, in addition to the settings of `dqn`."""

    explores_by: Literal["options", "repeats"] = "options"
    """Kind of a random choice; a repeat's length is that of an option."""


class ExploringDQN(PrimitivesDQN):
    """`dqn` whose random choices last."""

    Settings: ClassVar[type] = ExploringSettings
    settings: ExploringSettings  # pyright: ignore[reportIncompatibleVariableOverride]
    STATE = ("_repeated", "_choice_rng")

    def __init__(self, observation_space: gymnasium.Space, seed: int, settings: ExploringSettings) -> None:
        super().__init__(observation_space, seed, settings)
        self._repeated = (0, 0)  # a primitive, and for how many decisions more
        self._choice_rng = make_rng(seed, "actions")

    def act(self, batch: Moments) -> Any:
        """Begin a random choice, go on with it, or take the best primitive of the online network, int64 (1,)."""
        return np.array([self._choose(batch.observation[0], batch.action_mask[0])])

    def _choose(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        settings, (choice, left) = self.settings, self._repeated
        legal = self.cut(action_mask)
        if left and legal[choice]:
            self._repeated = choice, left - 1
            return choice
        epsilon, length = compute_epsilon(settings, self._schedule.steps), float(np.mean(settings.lengths))
        if self._choice_rng.random() >= epsilon / (epsilon + length * (1 - epsilon)):
            return choose_best(self.values.online.compute(self._encoder.encode(observation)), legal)
        if settings.explores_by == "options" and len(options := self.list_options(action_mask)):
            return int(self._choice_rng.choice(options))
        choice = sample_legal(legal, self._choice_rng)
        self._repeated = choice, int(self._choice_rng.choice(settings.lengths)) - 1
        return choice

    def observe(self, batch: Decisions) -> Mapping[str, float]:
        """Learn from each primitive of the decision as if it had been chosen."""
        if batch.terminated[0] or batch.truncated[0]:
            self._repeated = (0, 0)
        logged: Mapping[str, float] = {}
        mask, (trace,) = batch.action_mask[0], batch.trace
        for number, step in enumerate(trace, 1):
            is_last = number == len(trace)
            after = batch.next_action_mask[0] if is_last else step.next_action_mask.astype(np.bool_)
            reward = float(step.reward)
            logged = super().observe(make_decision(SMDPTransition(
                step.observation, int(step.action), self.cut(mask), reward, reward, 1, self.gamma,
                step.next_observation, self.cut(after), bool(is_last and batch.terminated[0]),
                bool(is_last and batch.truncated[0]))))
            mask = after
        return logged


def make_explorer(explores_by: Literal["options", "repeats"], env: Any, seed: int, settings: Mapping[str, Any]
                  ) -> ExploringDQN:
    """Make the learner for an `OptionsEnv` with primitives and traces; see `read_room`."""
    changed = {**settings, "explores_by": explores_by}
    return ExploringDQN(env.observation_space, seed, read_room(ExploringSettings, env, changed))
