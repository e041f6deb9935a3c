"""Reading a state as factors: which numbers of an observation are discrete, and what is left of it.

Components of MultiBinary, MultiDiscrete and Discrete observations are factors. Of a flat Box, those are
that have never shown another value than 0 and 1 (in a room, the puzzle's bits); the rest is the pose, on which
durations depend and outcomes are taken not to. Nothing is learned here but which components these are.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from hrl_escape.errors import UnsupportedSpaceError

__all__ = ["FactorReader"]


class FactorReader:
    """Splits observations into factors and pose.

    Args:
        space: of the observations.
        agent: whom errors name.

    Attributes:
        components: int64 (factors,), where in the flattened observation each factor is.
        sizes: int64 (factors,), how many values each can take.

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
                f"observations, not {space}; for pictures use dqn or ppo"
            )
        self._is_open = isinstance(space, spaces.Box)
        self._sizes = sizes.astype(np.int64)
        self._set(np.ones(len(sizes), dtype=np.bool_))

    def _set(self, chosen: NDArray[np.bool_]) -> None:
        self._chosen = chosen
        self.components = chosen.nonzero()[0]
        self.sizes = self._sizes[chosen]

    def flatten(self, observation: Any) -> NDArray[np.float64]:
        """The observation as float64 (components,)."""
        return np.asarray(observation, dtype=np.float64).ravel()

    def notice(self, flat: NDArray[np.float64]) -> bool:
        """Look whether a factor shows that it is none; says whether the factors changed.

        Args:
            flat: (components,) or (observations, components).
        """
        if not self._is_open:
            return False
        rows = np.atleast_2d(flat)
        chosen = self._chosen & ((rows == 0) | (rows == 1)).all(axis=0)
        if (chosen == self._chosen).all():
            return False
        self._set(chosen)
        return True

    def read(self, flat: NDArray[np.float64]) -> NDArray[np.int64]:
        """Values of the factors, int64 (..., factors). What is no value of theirs (before `notice`) reads as 0."""
        values = flat[..., self.components]
        return np.where((values >= 0) & (values < self.sizes), values, 0).astype(np.int64)

    def read_pose(self, flat: NDArray[np.float64]) -> NDArray[np.float64]:
        """What is not discrete, float64 (..., components - factors)."""
        return flat[..., ~self._chosen]
