"""Agents with a table of action values: acting on it, and the SMDP backup of one decision.

Ties are drawn: in learning by the agent's own generator, in evaluation by that of the episode, so that evaluating
frozen tables twice gives the same numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent, SMDPTransition, compute_backup, count_actions, count_steps
from hrl_escape.agents.components.exploration import (
    choose_best,
    compute_epsilon,
    make_rng,
    sample_action,
)
from hrl_escape.agents.components.tables import QTable, TabularSettings, make_discretiser
from hrl_escape.agents.settings import LearningSettings

__all__ = ["TabularAgent", "TabularAgentSettings"]


@dataclass(frozen=True)
class TabularAgentSettings(TabularSettings, LearningSettings):
    """Settings of agents with a table of action values."""


class TabularAgent(Agent):
    """Base of agents that learn Q(s, o) in a table.

    Attributes:
        name: of the algorithm, for messages.
        table: Q.
    """

    name: ClassVar[str]
    STATE = ("table", "_steps", "_rng")

    def __init__(
        self,
        observation_space: gymnasium.Space,
        action_space: gymnasium.Space,
        seed: int,
        settings: TabularAgentSettings | None = None,
    ) -> None:
        self.settings = settings or self.Settings()
        self.table = QTable(count_actions(action_space, self.name), self.settings)
        self._discretise = make_discretiser(observation_space, self.settings, self.name)
        self._rng = make_rng(seed, "actions")
        self._steps = 0

    def compute_values(self, observation: Any) -> NDArray[np.float64]:
        """Q(s, .) at an observation, float64 (actions,)."""
        return self.table.get_values(self._discretise(observation))

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Explore as the settings say."""
        values = self.compute_values(observation)
        return sample_action(values, action_mask, self.settings, self._steps, self._rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The legal action of highest value, drawn among equals."""
        return choose_best(self.compute_values(observation), action_mask, rng)

    def back_up(self, transition: SMDPTransition, bonus: float = 0.0) -> float:
        """Q(s, o) <- Q(s, o) + alpha [R + bonus + b max over legal o' of Q(s', o') - Q(s, o)]; returns the error."""
        reward, bootstrap = compute_backup(transition, self.settings)
        target = reward + bonus
        if bootstrap:
            next_values = self.compute_values(transition.next_observation)
            target += bootstrap * float(next_values[transition.next_action_mask].max())
        return self.table.update(self._discretise(transition.observation), transition.action, target)

    def finish_decision(self, transition: SMDPTransition, error: float) -> dict[str, float]:
        """Advance the clock; returns numbers to log."""
        self._steps += count_steps(transition, self.settings)
        epsilon = compute_epsilon(self.settings, self._steps)
        return {"td_error": abs(error), "epsilon": epsilon, "states": len(self.table)}
