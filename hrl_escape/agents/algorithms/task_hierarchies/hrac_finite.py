"""HRAC: `hiro-finite` whose manager only sets goals that the worker can reach in one window.

Zhang, Guo, Tan, Hu and Chen (2020). Their manager has a penalty for goals that are distant according to a network,
distilled from a matrix of observed adjacency. Here that matrix, or the true number of primitives, excludes them.
"""

from __future__ import annotations

from collections.abc import Callable

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.algorithms.task_hierarchies.hiro_finite import HiroFinite, HiroFiniteSettings
from hrl_escape.agents.hierarchy.goal_space import GoalPoint, GoalSpace
from hrl_escape.agents.hierarchy.task import Return, Seen
from hrl_escape.agents.state import Kept

CountSteps = Callable[[GoalPoint, GoalPoint], NDArray[np.float64]]
"""Fewest primitives from a point to points (..., dimensions), (...)."""


class HracFinite(HiroFinite):
    """`hiro-finite` over goals whose points are adjacent: at most c primitives away.

    Learned adjacency holds the pairs of points (p, p') such that p' was seen within c primitives after p in one window.
    If no goal is known to be adjacent, all are allowed.

    Args:
        goal_space: as for `hiro-finite`.
        count_steps: exact adjacency, or None to learn it.
    """

    STATE = (Kept("_adjacent", pack=lambda pairs: np.array([np.frombuffer(each) for each in sorted(pairs)]),
                  unpack=lambda saved: {row.tobytes() for row in np.asarray(saved)}),)

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: HiroFiniteSettings | None = None, goal_space: GoalSpace | None = None,
                 count_steps: CountSteps | None = None) -> None:
        super().__init__(observation_space, action_space, seed, settings, goal_space)
        self._count_steps = count_steps
        self.privileges += ("adjacency",) * (count_steps is not None)
        self._adjacent: set[bytes] = set()

    def find_adjacent(self, point: GoalPoint, targets: GoalPoint) -> NDArray[np.bool_]:
        """Return which points (count, dimensions) are estimated to be within a window of a point, bool (count,)."""
        if self._count_steps is not None:
            return self._count_steps(point, targets) <= self.settings.window
        return np.array([_make_pair(point, target) in self._adjacent for target in targets])

    def find_allowed(self, seen: Seen, legal: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return legal goals that are adjacent, or all legal ones if none is."""
        targets = self.space.locate(self.space.goals, seen.observation)
        near = legal & self.find_adjacent(self.space.project(seen.observation), targets)
        return near if near.any() else legal

    def store(self, returned: Return) -> None:
        """Store the decision, and record which points were within its window of each other."""
        super().store(returned)
        points = self.latest.points
        self._adjacent |= {_make_pair(before, after) for index, before in enumerate(points)
                           for after in points[index + 1 :]}


def _make_pair(before: GoalPoint, after: GoalPoint) -> bytes:
    return np.round(np.concatenate([before, after]), 6).tobytes()
