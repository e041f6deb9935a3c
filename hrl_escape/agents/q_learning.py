"""Tabular Q-learning over decisions of any duration.

SMDP Q-learning of Bradtke and Duff (1994), as in Sutton, Precup and Singh (1999), section 3.2;
with durations of 1 it is Q-learning of Watkins (1989).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import SMDPTransition, StateTree, compute_backup, count_actions, count_steps
from hrl_escape.agents.bonuses import BonusSettings, CountBonus
from hrl_escape.agents.exploration import (
    ExplorationSettings,
    choose_best,
    compute_epsilon,
    make_rng,
    sample_action,
)
from hrl_escape.agents.settings import LearningSettings
from hrl_escape.agents.tabular import QTable, TabularSettings, make_discretiser
from hrl_escape.agents.updates import Updates

__all__ = ["QLearning", "QLearningSettings"]


@dataclass(frozen=True)
class QLearningSettings(BonusSettings, TabularSettings, ExplorationSettings, LearningSettings):
    """Settings of `q-learning`."""


class QLearning:
    """Q(s, o) <- Q(s, o) + alpha [R + gamma^k (1 - terminated) max over legal o' of Q(s', o') - Q(s, o)].

    The recipe `paper` treats actions as the paper's agents did: plain sum, one gamma a decision, cuts as ends.
    """

    Settings: ClassVar[type] = QLearningSettings
    recipes: ClassVar[Mapping[str, QLearningSettings]] = {
        "corrected": QLearningSettings(),
        "paper": QLearningSettings(discounting="decision", bootstrap_on_truncation=False, clock="decision"),
    }

    def __init__(
        self,
        observation_space: gymnasium.Space,
        action_space: gymnasium.Space,
        seed: int,
        settings: QLearningSettings | None = None,
    ) -> None:
        self.settings = settings or QLearningSettings()
        self.table = QTable(count_actions(action_space, "q-learning"), self.settings)
        self._discretise = make_discretiser(observation_space, self.settings, "q-learning")
        self._bonus = CountBonus(observation_space, self.settings, "q-learning")
        self._rng = make_rng(seed, "actions")
        self._steps = 0

    @property
    def gamma(self) -> float:
        """Discount per primitive."""
        return self.settings.gamma

    def compute_values(self, observation: Any) -> NDArray[np.float64]:
        """Q(s, .) at an observation, float64 (actions,)."""
        return self.table.get_values(self._discretise(observation))

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Explore as the settings say."""
        values = self.compute_values(observation)
        return sample_action(values, action_mask, self.settings, self._steps, self._rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The legal action of highest value."""
        return choose_best(self.compute_values(observation), action_mask)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """One backup."""
        reward, bootstrap = compute_backup(transition, self.settings)
        target = reward + self._bonus.visit(transition.next_observation)
        if bootstrap:
            next_values = self.compute_values(transition.next_observation)
            target += bootstrap * float(next_values[transition.next_action_mask].max())
        error = self.table.update(self._discretise(transition.observation), transition.action, target)
        self._steps += count_steps(transition, self.settings)
        epsilon = compute_epsilon(self.settings, self._steps)
        return {"td_error": abs(error), "epsilon": epsilon, "states": len(self.table)}

    def learn(self, transition: SMDPTransition) -> Updates:
        """As `observe`: a backup takes microseconds, so trials that run together take turns at it."""
        yield from ()
        return dict(self.observe(transition))

    def state_dict(self) -> StateTree:
        """Table, counter, generator."""
        return {
            "table": self.table.state_dict(),
            "bonus": self._bonus.state_dict(),
            "steps": self._steps,
            "rng": self._rng.bit_generator.state,
        }

    def load_state_dict(self, state: StateTree) -> None:
        """Restore what `state_dict` gave."""
        self.table.load_state_dict(state["table"])
        self._bonus.load_state_dict(state["bonus"])
        self._steps = int(state["steps"])
        self._rng.bit_generator.state = state["rng"]
