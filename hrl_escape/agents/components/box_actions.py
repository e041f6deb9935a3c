"""Actions in a Box: bounds, and the map between actions and the cube [-1, 1]^n in which policies act."""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from hrl_escape.errors import UnsupportedSpaceError


class BoxActions:
    """Linear map between the cube [-1, 1]^n and a Box with finite bounds; batches are arrays or tensors.

    Attributes:
        size: n, number of components of an action.
        low: lower bounds, float32 (n,).
        high: upper bounds, float32 (n,).

    Raises:
        UnsupportedSpaceError: the space is no Box, or has an infinite bound or integers.
    """

    def __init__(self, space: gymnasium.Space, agent: str) -> None:
        if not isinstance(space, spaces.Box) or space.dtype.kind != "f":
            finite = f", or {agent}-finite, which {agent} meant in 0.3" if agent in ("hiro", "hrac", "hac") else ""
            raise UnsupportedSpaceError(
                f"{agent} needs actions in a Box of floats, not {space}. For Discrete actions, such as options, take "
                f"ppo, dqn, rainbow or torchrl-sac{finite}")
        if not (np.isfinite(space.low).all() and np.isfinite(space.high).all() and (space.high > space.low).all()):
            raise UnsupportedSpaceError(f"{agent} needs finite bounds of actions, low below high, not {space}: give "
                                        "the environment a bounded action space in a wrapper")
        self._shape, self.size = space.shape, math.prod(space.shape)
        self.low, self.high = (bound.astype(np.float32).reshape(-1) for bound in (space.low, space.high))
        self._middle, self._half = (self.high + self.low) / 2, (self.high - self.low) / 2

    def _like(self, array: np.ndarray, batch: Any) -> Any:
        """Return a constant in the library of a batch."""
        return array if isinstance(batch, np.ndarray) else batch.new_tensor(array)

    def scale(self, unit: Any) -> Any:
        """Return actions in the Box, (n, ...), from points (n, size); points outside the cube are clipped."""
        low, high, middle, half = (self._like(part, unit) for part in (self.low, self.high, self._middle, self._half))
        scaled = middle + half * unit
        clipped = np.clip(scaled, low, high) if isinstance(unit, np.ndarray) else scaled.clamp(low, high)
        return clipped.reshape(-1, *self._shape)

    def unscale(self, action: Any) -> Any:
        """Return points of the cube, (n, size), from actions (n, ...)."""
        flat = action.reshape(len(action), self.size)
        return (flat - self._like(self._middle, flat)) / self._like(self._half, flat)
