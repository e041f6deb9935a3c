"""The random policy: uniform over legal actions, or over a Box, without learning.

Over options it measures the contribution of the options' planners (a comparison in Sutton, Precup and Singh 1999).
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import DiscountSettings, FixedPolicy, count_choices
from hrl_escape.agents.components.box_actions import BoxActions
from hrl_escape.agents.components.exploration import make_rng, sample_legal


class RandomAgent(FixedPolicy):
    """pi(a | s) = 1 / (number of legal actions at s), or uniform between the bounds of a Box."""

    acts_in = ("discrete", "box")
    settings: DiscountSettings
    STATE = ("_rng",)

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: DiscountSettings | None = None) -> None:
        self._box = None if count_choices(action_space, "random") else BoxActions(action_space, "random")
        self.settings = settings or DiscountSettings()
        self._rng = make_rng(seed, "actions")

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> Any:
        """Return a random legal action."""
        return self._draw(action_mask, self._rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> Any:
        """Return a random legal action: the evaluated policy is the random policy itself."""
        return self._draw(action_mask, rng)

    def _draw(self, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> Any:
        if self._box is None:
            return sample_legal(action_mask, rng)
        return self._box.scale(rng.uniform(-1, 1, (1, self._box.size)).astype(np.float32))[0]
