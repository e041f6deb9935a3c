"""Observations split into discrete factors and a pose.

All components of MultiBinary, MultiDiscrete and Discrete observations are factors. In a flat Box, factors are the
components that have only ever been 0 or 1 (in a room, the puzzle's bits). The remaining components are the pose. The
models assume that durations depend on the pose, and outcomes do not.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from hrl_escape.errors import UnsupportedSpaceError


class FactorReader:
    """Splits observations into factors and pose.

    Attributes:
        components: index of each factor in the flattened observation, int64 (factors,).
        sizes: number of values of each factor, int64 (factors,).

    Raises:
        UnsupportedSpaceError: observations are neither discrete nor a one-axis Box.
    """

    def __init__(self, space: gymnasium.Space, agent: str) -> None:
        if isinstance(space, spaces.Discrete):
            sizes = np.array([space.start + space.n])
        elif isinstance(space, spaces.MultiBinary):
            sizes = np.full(int(np.prod(space.shape)), 2)
        elif isinstance(space, spaces.MultiDiscrete):
            sizes = (space.start + space.nvec).ravel()
        elif isinstance(space, spaces.Box) and len(space.shape) == 1:
            sizes = np.full(space.shape[0], 2)
        else:
            raise UnsupportedSpaceError(
                f"{agent} learns about discrete factors and needs Discrete, MultiBinary, MultiDiscrete or flat Box "
                f"observations, not {space}; for other observations use dqn or ppo"
            )
        self._is_open = isinstance(space, spaces.Box)
        self._sizes = sizes.astype(np.int64)
        self._set(np.ones(len(sizes), dtype=np.bool_))

    def _set(self, chosen: NDArray[np.bool_]) -> None:
        self._chosen = chosen
        self.components = chosen.nonzero()[0]
        self.sizes = self._sizes[chosen]

    def flatten(self, observation: Any) -> NDArray[np.float64]:
        """Return the observation as float64 (components,)."""
        return np.asarray(observation, dtype=np.float64).ravel()

    def notice(self, flat: NDArray[np.float64]) -> bool:
        """Drop factors with values other than 0 and 1; return whether the factors changed."""
        if not self._is_open:
            return False
        rows = np.atleast_2d(flat)
        chosen = self._chosen & ((rows == 0) | (rows == 1)).all(axis=0)
        if (chosen == self._chosen).all():
            return False
        self._set(chosen)
        return True

    def keep(self, components: NDArray[np.int64]) -> None:
        """Drop every factor that is not among these components."""
        self._set(self._chosen & np.isin(np.arange(len(self._chosen)), components))

    def read(self, flat: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the values of the factors, int64 (..., factors). Other numbers (before `notice`) read as 0."""
        values = flat[..., self.components]
        return np.where((values >= 0) & (values < self.sizes), values, 0).astype(np.int64)

    def read_pose(self, flat: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the components that are not factors, float64 (..., components - factors)."""
        return flat[..., ~self._chosen]
