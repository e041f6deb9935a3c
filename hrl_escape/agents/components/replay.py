"""Replay of SMDP backups: a ring buffer in plain numpy, and n-step composition before it.

The buffer stores the backup (R, b) of each decision, target R + b V(s'), so that duration, discount and termination
cannot be lost or applied twice (see `agent.compute_backup`). On one CPU core it samples several times faster than
TorchRL's ReplayBuffer over LazyTensorStorage (`python -m benchmarks.agents`).
"""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from hrl_escape.agents.state import StateTree
from hrl_escape.errors import CheckpointError

__all__ = ["Experience", "NStep", "ReplayBuffer"]


class Experience(NamedTuple):
    """Backups, one (fields without a leading dimension) or a batch of them.

    Attributes:
        observation: (batch, *observation shape), encoded.
        mask: bool (batch, actions), legal there.
        action: int64 (batch,), or float32 (batch, actions) for relaxed actions.
        reward: float32 (batch,), R.
        bootstrap: float32 (batch,), b: gamma^k, or 0 where nothing follows.
        next_observation: (batch, *observation shape).
        next_mask: bool (batch, actions), legal at the next observation.
    """

    observation: Any
    mask: Any
    action: Any
    reward: Any
    bootstrap: Any
    next_observation: Any
    next_mask: Any


class ReplayBuffer:
    """The last `capacity` backups, sampled uniformly with replacement.

    Args:
        capacity: how many are kept.
        observation_shape: shape of an encoded observation.
        observation_dtype: its dtype.
        actions: number of actions, the length of masks.
        action_shape: () for an index, (actions,) for a relaxed action.
    """

    def __init__(
        self,
        capacity: int,
        observation_shape: tuple[int, ...],
        observation_dtype: DTypeLike,
        actions: int,
        action_shape: tuple[int, ...] = (),
    ) -> None:
        self.capacity = capacity
        self.added = 0
        self._fields = Experience(
            observation=np.zeros((capacity, *observation_shape), observation_dtype),
            mask=np.zeros((capacity, actions), np.bool_),
            action=np.zeros((capacity, *action_shape), np.float32 if action_shape else np.int64),
            reward=np.zeros(capacity, np.float32),
            bootstrap=np.zeros(capacity, np.float32),
            next_observation=np.zeros((capacity, *observation_shape), observation_dtype),
            next_mask=np.zeros((capacity, actions), np.bool_),
        )

    def __len__(self) -> int:
        return min(self.added, self.capacity)

    def add(self, experience: Experience) -> None:
        """Store one backup, over the oldest when full."""
        row = self.added % self.capacity
        for field, value in zip(self._fields, experience, strict=True):
            field[row] = value
        self.added += 1

    def sample(self, batch: int, rng: np.random.Generator) -> Experience:
        """Draw a batch; arrays are copies with leading dimension `batch`."""
        rows = rng.integers(len(self), size=batch)
        return Experience(*(field.take(rows, axis=0) for field in self._fields))

    def state_dict(self) -> StateTree:
        """The filled rows and the counter."""
        filled = len(self)
        return {"added": self.added} | {name: field[:filled] for name, field in self._fields._asdict().items()}

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`.

        Raises:
            CheckpointError: it comes from a buffer of another capacity or of other spaces.
        """
        self.added = int(state["added"])
        for name, field in self._fields._asdict().items():
            stored: NDArray = state[name]
            if stored.shape != (len(self), *field.shape[1:]) or stored.dtype != field.dtype:
                raise CheckpointError(
                    f"the checkpoint's replay has {name} of shape {stored.shape} {stored.dtype}; "
                    f"this agent needs ({len(self)}, ...) of {field.shape[1:]} {field.dtype}"
                )
            field[: len(self)] = stored


class NStep:
    """Joins n consecutive decisions into one backup: (R1, b1) then (R2, b2) is (R1 + b1 R2, b1 b2).

    Thus each decision contributes its own gamma^k (Sutton, Precup and Singh 1999), and a decision after which nothing
    follows, b = 0, ends the return. An episode's end flushes the shorter tails.

    Args:
        n: decisions to join.
    """

    def __init__(self, n: int) -> None:
        self.n = n
        self._pending: deque[Experience] = deque()

    def push(self, experience: Experience, episode_over: bool) -> list[Experience]:
        """Take in one decision; returns the joined backups that are complete."""
        joined = [self._join(earlier, experience) for earlier in self._pending]
        self._pending = deque([*joined, experience])
        if episode_over:
            complete = list(self._pending)
            self._pending.clear()
            return complete
        return [self._pending.popleft()] if len(self._pending) == self.n else []

    @staticmethod
    def _join(first: Experience, then: Experience) -> Experience:
        return first._replace(
            reward=first.reward + first.bootstrap * then.reward,
            bootstrap=first.bootstrap * then.bootstrap,
            next_observation=then.next_observation,
            next_mask=then.next_mask,
        )

    def state_dict(self) -> StateTree:
        """The decisions not yet complete."""
        return {"pending": [dict(experience._asdict()) for experience in self._pending]}

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`."""
        self._pending = deque(Experience(**fields) for fields in state["pending"])
