"""The random policy: uniform over legal actions, without learning.

Over options it measures the contribution of the options' planners (a comparison in Sutton, Precup and Singh 1999).
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import DiscountSettings, FixedPolicy, count_actions
from hrl_escape.agents.components.exploration import make_rng, sample_legal


class RandomAgent(FixedPolicy):
    """pi(a | s) = 1 / (number of legal actions at s)."""

    settings: DiscountSettings
    STATE = ("_rng",)

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: DiscountSettings | None = None) -> None:
        count_actions(action_space, "random")
        self.settings = settings or DiscountSettings()
        self._rng = make_rng(seed, "actions")

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Return a random legal action."""
        return sample_legal(action_mask, self._rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Return a random legal action: the evaluated policy is the random policy itself."""
        return sample_legal(action_mask, rng)
