"""Greedy policy of a network over encoded observations and what a memory keeps of the episode."""

from __future__ import annotations

from typing import Any

import numpy as np

from hrl_escape.agents.components.memory import Memory
from hrl_escape.agents.components.networks import Network, ObservationEncoder
from hrl_escape.agents.decisions import Moments, Policy


class GreedyPolicy(Policy):
    """Chooses the legal action of highest score.

    Args:
        encoder: from observations to inputs of the network.
        network: from inputs to one score an action, (n, actions).
        memory: of the episode; `NoMemory` for none.
    """

    def __init__(self, encoder: ObservationEncoder, network: Network, memory: Memory) -> None:
        self._encoder, self._network, self._memory = encoder, network, memory
        self.is_markov = memory.size == 0
        self._state: Any = np.zeros((1, memory.size), np.float32)

    def begin_episode(self, rng: np.random.Generator, num_envs: int = 1) -> None:
        """Forget the episodes; nothing is drawn."""
        self._state = np.zeros((num_envs, self._memory.size), np.float32)

    def act(self, batch: Moments) -> Any:
        """Choose actions, int64 (n,)."""
        encoded = self._encoder.encode_batch(batch.observation)
        if not isinstance(encoded, np.ndarray) and isinstance(self._state, np.ndarray):
            self._state = encoded.new_zeros(self._state.shape)
        seen = self._memory.evaluate(encoded, self._state[batch.env])
        self._state[batch.env] = self._memory.get_state(seen)
        scores, mask = self._network.evaluate(seen), batch.action_mask
        if isinstance(scores, np.ndarray):
            return np.where(mask, scores, -np.inf).argmax(1)
        return scores.masked_fill(~mask, -np.inf).argmax(1)
