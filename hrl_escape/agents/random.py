"""The random policy: uniform over legal actions, learning nothing.

Over options it is the measure of what their planners already know (Sutton, Precup and Singh
1999 compare with it): what an agent adds is seen beside it, never alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import SMDPTransition, StateTree, count_actions
from hrl_escape.agents.exploration import make_rng, sample_legal
from hrl_escape.agents.settings import AgentSettings, Range

__all__ = ["RandomAgent", "RandomSettings"]


@dataclass(frozen=True)
class RandomSettings(AgentSettings):
    """The random policy has nothing to set but the discount its logs use."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive; it changes nothing in how this agent acts."""


class RandomAgent:
    """pi(a | s) = 1 / (number of legal actions at s)."""

    Settings: ClassVar[type] = RandomSettings
    recipes: ClassVar[Mapping[str, RandomSettings]] = {"corrected": RandomSettings(), "paper": RandomSettings()}

    def __init__(
        self,
        observation_space: gymnasium.Space,
        action_space: gymnasium.Space,
        seed: int,
        settings: RandomSettings | None = None,
    ) -> None:
        count_actions(action_space, "random")
        self.settings = settings or RandomSettings()
        self._rng = make_rng(seed, "actions")

    @property
    def gamma(self) -> float:
        """Discount per primitive."""
        return self.settings.gamma

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """A legal action, uniformly."""
        return sample_legal(action_mask, self._rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """A legal action, uniformly: this policy is what is evaluated."""
        return sample_legal(action_mask, rng)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Learns nothing."""
        return {}

    def state_dict(self) -> StateTree:
        """The generator."""
        return {"rng": self._rng.bit_generator.state}

    def load_state_dict(self, state: StateTree) -> None:
        """Restore what `state_dict` gave."""
        self._rng.bit_generator.state = state["rng"]
