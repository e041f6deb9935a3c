"""Greedy policy of a network over encoded observations and a memory of the episode; and the memory without content."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.agents.components.arrays import draw_minibatches
from hrl_escape.agents.components.box_actions import BoxActions
from hrl_escape.agents.components.networks import Network, ObservationEncoder
from hrl_escape.agents.decisions import Moments, Policy


class Memory:
    """Memory of an episode as additional input of networks. This base class stores nothing: `size` is 0.

    Attributes:
        size: size of the state of an episode.
    """

    size: int = 0

    @property
    def networks(self) -> dict[str, Network]:
        """Networks that are learned, by name."""
        return {}

    def read(self, observation: Tensor, state: Tensor) -> Tensor:
        """Return inputs of the networks, (n, numbers + size), from encoded observations and previous states."""
        return observation

    def evaluate(self, observation: Any, state: Any) -> Any:
        """Return `read` without gradients; arrays give arrays."""
        return observation

    def get_state(self, read: Any) -> Any:
        """Return the states in the result of `read`, (n, size)."""
        return read[(slice(None), *(0,) * (read.ndim - 2), slice(0, 0))]  # pictures have more axes

    def recall(self, encoded: NDArray) -> NDArray:
        """Return inputs of the networks at one encoded observation: of the latest choice there, else a new episode."""
        return encoded

    def draw_batches(self, rollout: Any, size: int, rng: np.random.Generator, epochs: int
                     ) -> Iterator[tuple[Tensor, Tensor]]:
        """Shuffle a rollout in every epoch and cut it; yield about `size` rows and the networks' inputs there."""
        for rows in draw_minibatches(rng, len(rollout.place), size, epochs):
            rows = rows.to(rollout.place.device)
            yield rows, rollout.observation.index_select(0, rows)  # a quarter of the time of indexing


class GreedyPolicy(Policy):
    """Chooses the legal action of highest score, or the action in a Box that the network outputs.

    Args:
        encoder: converts observations to inputs of the network.
        network: maps inputs to one score per action, (n, actions), or to points of the cube [-1, 1]^size first.
        memory: memory of the episode; `Memory()` for none.
        box: bounds of the actions, or None for Discrete actions.
        is_squashed: points go through tanh first.
    """

    def __init__(self, encoder: ObservationEncoder, network: Network, memory: Memory, box: BoxActions | None = None,
                 is_squashed: bool = False) -> None:
        self._encoder, self._network, self._memory = encoder, network, memory
        self._box, self._is_squashed = box, is_squashed
        self.is_markov = memory.size == 0
        self._state: Any = np.zeros((1, memory.size), np.float32)

    def begin_episode(self, rng: np.random.Generator, num_envs: int = 1) -> None:
        """Reset the memory. The policy is deterministic and ignores `rng`."""
        self._state = np.zeros((num_envs, self._memory.size), np.float32)

    def act(self, batch: Moments) -> Any:
        """Return actions, int64 (n,), or float32 (n, ...) of a Box."""
        encoded = self._encoder.encode_batch(batch.observation)
        if not isinstance(encoded, np.ndarray) and isinstance(self._state, np.ndarray):
            self._state = encoded.new_zeros(self._state.shape)
        seen = self._memory.evaluate(encoded, self._state[batch.env])
        self._state[batch.env] = self._memory.get_state(seen)
        scores, mask = self._network.evaluate(seen), batch.action_mask
        if self._box is not None:
            points = scores[:, : self._box.size]
            if self._is_squashed:
                points = np.tanh(points) if isinstance(points, np.ndarray) else points.tanh()
            return self._box.scale(points)
        if isinstance(scores, np.ndarray):
            return np.where(mask, scores, -np.inf).argmax(1)
        return scores.masked_fill(~mask, -np.inf).argmax(1)
