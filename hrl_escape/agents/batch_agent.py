"""Interface of agents that act on, and learn from, a batch of n decisions in one environment or in many."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.decisions import Decisions, Moments, Policy
from hrl_escape.agents.state import Kept, Stateful, StateTree

if TYPE_CHECKING:
    import torch


class BatchAgent(Agent):
    """An agent that acts on, and learns from, a batch of n decisions.

    A new agent acts in one environment. `begin_episodes` prepares it for many.

    Attributes:
        place: number of environments, and device of their tensors, or None for NumPy arrays.
    """

    STATE = (Kept("_running", unpack=dict, is_left_out=True),)
    place: tuple[int, torch.device | None] = 1, None

    @abstractmethod
    def begin_episodes(self, num_envs: int = 1, device: torch.device | None = None) -> None:
        """Begin an episode in every environment; decisions that have not ended are dropped.

        Args:
            num_envs: number of environments.
            device: device of batches and networks, or None for NumPy arrays of one environment.
        """

    @abstractmethod
    def act(self, batch: Moments) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Choose actions for learning, int64 (n,), or float32 (n, ...) of a Box."""

    @abstractmethod
    def observe(self, batch: Decisions) -> Mapping[str, float]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Learn from decisions and return numbers to log.

        Decisions of one environment come in order, each from the state reached by the one before, until one is
        terminated or truncated.
        """

    @abstractmethod
    def make_policy(self) -> Policy:
        """Make a policy that chooses as evaluation does."""

    def list_running(self) -> Mapping[str, Stateful]:
        """Parts of the state that belong to the present environments, by their names in a checkpoint."""
        return {}

    @property
    def _running(self) -> StateTree:
        parts = {name: part.state_dict() for name, part in self.list_running().items()}
        return {"num_envs": self.place[0], "is_many": self.place[1] is not None, **parts}

    @_running.setter
    def _running(self, saved: StateTree) -> None:
        """Parts continue if the number of environments is the same, on any device; otherwise they do not change."""
        if (saved["num_envs"], saved["is_many"]) == (self.place[0], self.place[1] is not None):
            for name, part in self.list_running().items():
                part.load_state_dict(saved[name])

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> Any:
        """Choose as `make_policy` does, in the episode of `rng`."""
        if (known := self.recall(rng)) is None:
            policy = self.make_policy()
            policy.begin_episode(rng)
            self._evaluation, known = (rng, policy), (policy,)
        return known[0].choose(observation, action_mask)
