"""Exploration by counts: a state that was reached before has a cost, which grows with the number of visits.

The bonus is weight / sqrt(n) of MBIE-EB (Strehl and Littman 2008), given to deep agents by Bellemare et al. (2016),
minus the weight itself. It is therefore never positive, and agents do not delay the end of an episode to collect it.
Agents learn from it as from any reward; reported returns exclude it. `make_cell_finder` must be able to bin the
observations.
"""

from __future__ import annotations

import sys
from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.components.tables import ResolutionSettings, make_cell_finder
from hrl_escape.agents.state import Columns, Stateful


class Bonus(Stateful):
    """Reward for novelty, for one observation or a batch."""

    _weight: float

    @abstractmethod
    def visit(self, observation: Any) -> float:
        """Count a visit of an observation; return the bonus, at most 0, in units of return."""

    @abstractmethod
    def visit_many(self, observation: NDArray) -> NDArray[np.float32]:
        """Count visits of a batch of observations (n, ...), row by row; return their bonuses, (n,)."""

    def visit_batch(self, observation: Any) -> Any:
        """Count visits of a tensor (n, ...), or of a sequence of n observations; return their bonuses, (n,).

        Without a weight, return the number 0.
        """
        if not self._weight:
            return 0.0
        if isinstance(observation, Sequence):
            return np.array([self.visit(each) for each in observation], np.float32)
        torch = sys.modules["torch"]
        return torch.from_numpy(self.visit_many(observation.cpu().numpy())).to(observation.device)


class CountBonus(Bonus):
    """Counts of visits by cell, and the bonus of the next visit.

    Args:
        space: observation space.
        weight: largest cost of a familiar cell, in units of return; 0 turns counting off.
        bins: number of points to round bounded components to.
        agent: name of the agent, for messages.

    Raises:
        UnsupportedSpaceError: the weight is above 0 and observations cannot be binned, as with pictures.
    """

    STATE = (Columns({"counts": "_counts"}),)

    def __init__(self, space: gymnasium.Space, weight: float, bins: int, agent: str) -> None:
        self._weight = weight
        self._counts: dict[bytes, int] = {}
        self._find_cell: Callable[[Any], NDArray[np.int32]] | None = None
        if self._weight:
            self._find_cell = make_cell_finder(space, ResolutionSettings(bins=bins), agent)

    def visit(self, observation: Any) -> float:
        """Count a visit of an observation's cell; return the bonus, at most 0, in units of return."""
        if self._find_cell is None:
            return 0.0
        key = self._find_cell(observation).tobytes()
        count = self._counts[key] = self._counts.get(key, 0) + 1
        return self._weight / count**0.5 - self._weight

    def visit_many(self, observation: NDArray) -> NDArray[np.float32]:
        """Count visits of a batch of observations (n, ...), row by row; return their bonuses, (n,)."""
        if self._find_cell is None or not len(observation):
            return np.zeros(len(observation), np.float32)
        rows = np.ascontiguousarray(self._find_cell(observation).reshape(len(observation), -1))
        whole = rows.view(np.dtype((np.void, rows.dtype.itemsize * rows.shape[1]))).ravel()
        cells, place, visits = np.unique(whole, return_inverse=True, return_counts=True)
        before = np.array([self._counts.get(cell.tobytes(), 0) for cell in cells])
        rank = np.empty(len(place), np.int64)  # rank of each row among the rows of its cell
        rank[np.argsort(place, kind="stable")] = np.arange(len(place)) - np.repeat(np.cumsum(visits) - visits, visits)
        self._counts |= {cell.tobytes(): int(count) for cell, count in zip(cells, before + visits, strict=True)}
        return (self._weight / np.sqrt(before[place] + rank + 1) - self._weight).astype(np.float32)
