"""Goals as the interface between two levels: a manager names one of finitely many, a worker walks there.

What a goal is, and whether it is reached, is read from the observation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from hrl_escape.agents.hierarchy.task import BaseTask, Call, Frame, Hierarchy, Seen, Step
from hrl_escape.errors import UnsupportedSpaceError

__all__ = ["GoalSet", "Manager", "Worker", "make_goal_hierarchy", "make_goals"]


@dataclass(frozen=True)
class GoalSet:
    """Finitely many goals, numbered from 0.

    Attributes:
        count: how many there are.
        reached: (observation, goal) -> whether it is reached there.
    """

    count: int
    reached: Callable[[Any, int], bool]


def make_goals(space: gymnasium.Space, agent: str) -> GoalSet:
    """Goals of an observation space: each state of a Discrete one; else each bound of each bounded component.

    A bit has the goals 0 and 1.

    Raises:
        UnsupportedSpaceError: the space has no bounded component, or is of another kind.
    """
    if isinstance(space, spaces.Discrete):
        first = int(space.start)
        return GoalSet(int(space.n), lambda observation, goal: int(observation) == first + goal)
    if isinstance(space, spaces.MultiBinary):
        low, high = np.zeros(space.shape), np.ones(space.shape)
    elif isinstance(space, spaces.MultiDiscrete):
        low, high = space.start.astype(float), (space.start + space.nvec - 1).astype(float)
    elif isinstance(space, spaces.Box) and len(space.shape) == 1:
        low, high = space.low.astype(float), space.high.astype(float)
    else:
        raise UnsupportedSpaceError(f"{agent} finds no goals in {space}; give it a GoalSet")
    low, high = low.reshape(-1), high.reshape(-1)
    bounded = np.flatnonzero((low > -1e6) & (high < 1e6) & (high > low))
    if not len(bounded):
        raise UnsupportedSpaceError(f"{agent} finds no bounded component in {space}; give it a GoalSet")
    goals = [(int(index), bound[index]) for index in bounded for bound in (low, high)]

    def is_reached(observation: Any, goal: int) -> bool:
        index, value = goals[goal]
        return bool(np.asarray(observation).reshape(-1)[index] == value)

    return GoalSet(len(goals), is_reached)


class Manager(BaseTask):
    """Names a goal that is not reached; paid by the environment."""

    def __init__(self, goals: GoalSet, worker: Worker) -> None:
        super().__init__("manager", goals.count)
        self._goals, self._worker = goals, worker

    def legal(self, seen: Seen, context: Any) -> NDArray[np.bool_]:
        """Goals that are not reached here."""
        reached = [self._goals.reached(seen.observation, goal) for goal in range(self._goals.count)]
        return ~np.array(reached, np.bool_)

    def decode(self, choice: int, seen: Seen, context: Any) -> Call:
        """The worker, told the goal."""
        return Call(self._worker, int(choice))


class Worker(BaseTask):
    """Walks to the goal it is told: paid 1 for reaching it, nothing else.

    Args:
        goals: which there are.
        primitives: of the environment.
        patience: primitives after which the call is given up; 0 never gives up.
    """

    def __init__(self, goals: GoalSet, primitives: int, patience: int = 0) -> None:
        super().__init__("worker", primitives)
        self._goals, self._patience = goals, patience

    def list_calls(self) -> Mapping[str, Any]:
        """One a goal."""
        return {f"goal {goal}": goal for goal in range(self._goals.count)}

    def is_reached(self, frame: Frame, seen: Seen) -> bool:
        """The goal of a call is reached."""
        return self._goals.reached(seen.observation, frame.context)

    def ends(self, frame: Frame, seen: Seen) -> float:
        """Certain where the goal is reached, or patience has run out."""
        given_up = self._patience > 0 and frame.primitives >= self._patience
        return float(given_up or self.is_reached(frame, seen))

    def pay(self, step: Step, frame: Frame) -> float:
        """1 on reaching the goal."""
        return float(self.is_reached(frame, step.next_seen))


def make_goal_hierarchy(
    goals: GoalSet, primitives: int, patience: int = 0, privileges: tuple[str, ...] = ()
) -> Hierarchy:
    """A manager over a worker."""
    worker = Worker(goals, primitives, patience)
    return Hierarchy(Manager(goals, worker), (worker,), privileges=privileges)
