"""Goals as points: what all agents with goals ask of them, whether they name places or displacements.

A goal space projects an observation onto a point. A goal is a point to be at or, where goals are relative, a
displacement still to be made (Nachum et al. 2018). A NaN in a goal stands for a component that does not matter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from hrl_escape.agents.hierarchy.goals import GoalSet, GoalView
from hrl_escape.agents.hierarchy.task import BaseTask, Seen, Stack
from hrl_escape.errors import AgentSettingsError, UnsupportedSpaceError

GoalPoint = NDArray[np.float64]
"""(dimensions,), in the units of the projection; or points, (..., dimensions)."""


def measure_straight(start: GoalPoint, end: GoalPoint) -> NDArray[np.float64]:
    """Euclidean distance over the components that matter, (...)."""
    return np.sqrt(np.nansum((end - start) ** 2, axis=-1))


@dataclass(frozen=True)
class GoalSpace:
    """Points that goals lie in, and the finitely many goals that may be named, numbered from 0."""

    project: Callable[[Any], GoalPoint]  # observation -> its point
    goals: NDArray[np.float64]  # float64 (count, dimensions)
    is_relative: bool = False  # goals are displacements from where they are named
    distance: Callable[[GoalPoint, GoalPoint], NDArray[np.float64]] = measure_straight
    """From a point to points (..., dimensions), in their unit or in any other, such as primitives along the floor."""
    tolerance: float = 1e-6  # distance at which a goal counts as reached
    find_desired: Callable[[Any], int] | None = None
    """Observation -> number of the goal that the episode asks for; None where its end alone tells."""
    view: GoalView | None = None  # what of an observation tables and networks see; all by default
    privileges: tuple[str, ...] = ("goals",)  # what the space tells an agent that the observation does not

    def __post_init__(self) -> None:
        if self.goals.ndim != 2 or not len(self.goals):
            raise AgentSettingsError("GoalSpace.goals", f"an array of shape {self.goals.shape}",
                                     "(count, dimensions), at least one goal")

    def locate(self, goal: GoalPoint, observation: Any) -> GoalPoint:
        """Point that a goal named at an observation means."""
        return self.project(observation) + goal if self.is_relative else goal

    def advance(self, goal: GoalPoint, observation: Any, next_observation: Any) -> GoalPoint:
        """h(s, g, s'): the same goal as told at s'; s + g - s' where goals are relative, else g."""
        if not self.is_relative:
            return goal
        return goal + self.project(observation) - self.project(next_observation)

    def measure(self, goal: GoalPoint, observation: Any) -> NDArray[np.float64]:
        """Distance that is left to a goal, or to each of several, as told at an observation; (...)."""
        return self.distance(self.project(observation), self.locate(goal, observation))

    def is_reached(self, goal: GoalPoint, observation: Any) -> bool:
        """A goal as told at an observation is reached there."""
        return bool(self.measure(goal, observation) <= self.tolerance)

    def list_reached(self, observation: Any) -> NDArray[np.bool_]:
        """Mask of the goals that, named at an observation, are reached there, bool (count,)."""
        return self.measure(self.goals, observation) <= self.tolerance

    def find_nearest(self, point: GoalPoint) -> int:
        """Number of the goal nearest to a point, or to a displacement where goals are relative."""
        return int(measure_straight(point, self.goals).argmin())


class GoalTask(BaseTask):
    """A task that sees what a goal space shows of an observation.

    Args:
        name: unique in its hierarchy.
        space: of its goals.
        choices: how many it has.

    Attributes:
        goal_space: of its goals.
    """

    def __init__(self, name: str, space: GoalSpace, choices: int) -> None:
        super().__init__(name, choices, None if space.view is None else space.view.space)
        self.goal_space = space

    def view(self, seen: Seen, stack: Stack) -> Any:
        """The part of the observation that tables see."""
        view = self.goal_space.view
        return seen.observation if view is None else view.see(seen.observation)


def make_goal_space(space: gymnasium.Space, agent: str) -> GoalSpace:
    """Goals of an observation space: each state of a Discrete one; else each bound of each bounded component.

    A bit has the goals 0 and 1.

    Raises:
        UnsupportedSpaceError: the space has no bounded component, or is of another kind.
    """
    if isinstance(space, spaces.Discrete):
        numbers = float(space.start) + np.arange(float(space.n))
        return GoalSpace(lambda observation: np.array([float(observation)]), numbers[:, None], privileges=())
    if isinstance(space, spaces.MultiBinary):
        low, high = np.zeros(space.shape), np.ones(space.shape)
    elif isinstance(space, spaces.MultiDiscrete):
        low, high = space.start.astype(float), (space.start + space.nvec - 1).astype(float)
    elif isinstance(space, spaces.Box) and len(space.shape) == 1:
        low, high = space.low.astype(float), space.high.astype(float)
    else:
        raise UnsupportedSpaceError(f"{agent} finds no goals in {space}; give it a GoalSpace")
    low, high = low.reshape(-1), high.reshape(-1)
    bounded = np.flatnonzero((low > -1e6) & (high < 1e6) & (high > low))
    if not len(bounded):
        raise UnsupportedSpaceError(f"{agent} finds no bounded component in {space}; give it a GoalSpace")
    goals = np.full((2 * len(bounded), len(low)), np.nan)
    for row, index in enumerate(bounded):
        goals[2 * row, index], goals[2 * row + 1, index] = low[index], high[index]
    return GoalSpace(lambda observation: np.asarray(observation, np.float64).reshape(-1), goals, privileges=())


def make_goals(space: gymnasium.Space, agent: str) -> GoalSet:
    """The same goals, for agents that know them by number alone.

    Raises:
        UnsupportedSpaceError: as `make_goal_space`.
    """
    made = make_goal_space(space, agent)
    goals, is_free = made.goals, np.isnan(made.goals)
    return GoalSet(len(goals), lambda observation, goal: bool(
        ((made.project(observation) == goals[goal]) | is_free[goal]).all()), privileges=())
