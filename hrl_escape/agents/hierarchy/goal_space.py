"""Goals as the interface between levels: by number alone, with a manager and a worker, or as points.

Goals are defined on observations. A goal space projects an observation onto a point. A goal is a point to be at or,
where goals are relative, a displacement still to be made (Nachum et al. 2018). A NaN in a goal marks a component that
does not matter.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from hrl_escape.agents.hierarchy.task import BaseTask, Frame, Hierarchy, Seen, Stack, Step, allow_only
from hrl_escape.errors import AgentSettingsError, UnsupportedSpaceError


@dataclass(frozen=True)
class GoalView:
    """Part of an observation that a level sees."""

    space: gymnasium.Space  # of this part
    see: Callable[[Any], Any]  # observation -> that part


class ViewTask(BaseTask):
    """A task with a part of the observation as its input, or all of it without a view."""

    def __init__(self, name: str, choices: int, view: GoalView | None, child: BaseTask | None = None) -> None:
        super().__init__(name, choices, None if view is None else view.space, child)
        self._view = view

    def view(self, seen: Seen, stack: Stack) -> Any:
        """Return the part of the observation in the view."""
        return seen.observation if self._view is None else self._view.see(seen.observation)


@dataclass(frozen=True)
class GoalSet:
    """Finitely many goals, numbered from 0."""

    count: int  # number of goals
    reached: Callable[[Any, int], bool]  # (observation, goal) -> whether it is reached there
    is_open: Callable[[Any, int], bool] | None = None
    """(observation, goal) -> whether the manager can choose it there; anywhere by default."""
    policy: Callable[[Any, int], int | None] | None = None
    """(observation, goal) -> the primitive towards it, or None; by default this policy is learned."""
    manager_view: GoalView | None = None  # what of an observation the manager sees; all by default
    worker_view: GoalView | None = None  # the part of it that the worker sees, in addition to the goal
    names: tuple[str, ...] = ()  # of the goals, for options made of them; numbers by default
    places: tuple[tuple[float, float] | None, ...] = ()
    """X and y of each goal on the floor, m, for drawings; none by default."""
    source: Literal["given", "synthesised"] = "given"  # where the goals come from
    privileges: tuple[str, ...] = ("goals",)  # information beyond the observation


class Manager(ViewTask):
    """Task that chooses an open goal that is not reached, with the environment's reward."""

    def __init__(self, goals: GoalSet, worker: Worker) -> None:
        super().__init__("manager", goals.count, goals.manager_view, worker)
        self._goals, self._worker = goals, worker

    def legal(self, seen: Seen, context: Any) -> NDArray[np.bool_]:
        """Return the open goals that are not reached here and leave the worker a choice."""
        goals = self._goals
        return np.array([
            not goals.reached(seen.observation, goal)
            and (goals.is_open is None or goals.is_open(seen.observation, goal))
            and bool(self._worker.legal(seen, goal).any())
            for goal in range(goals.count)
        ], np.bool_)  # fmt: skip


class Worker(ViewTask):
    """Task that is rewarded for reaching its goal only; it ends after `patience` primitives, or never for 0."""

    def __init__(self, goals: GoalSet, primitives: int, patience: int = 0) -> None:
        super().__init__("worker", primitives, goals.worker_view)
        self._goals, self._patience = goals, patience

    def legal(self, seen: Seen, context: Any) -> NDArray[np.bool_]:
        """Return the legal primitives, or the one of a given policy."""
        policy = self._goals.policy
        return seen.mask if policy is None else allow_only(policy(seen.observation, context), seen.mask)

    def list_calls(self) -> Mapping[str, Any]:
        """Return one call for each goal, under the goal's name."""
        names = self._goals.names or tuple(f"goal {goal}" for goal in range(self._goals.count))
        return {name: goal for goal, name in enumerate(names)}

    def is_callable(self, seen: Seen, context: Any) -> bool:
        """Return whether the goal is open, not reached, and has a way."""
        is_open = self._goals.is_open
        return (is_open is None or is_open(seen.observation, context)) and super().is_callable(seen, context)

    def find_place(self, context: Any) -> tuple[float, float] | None:
        """Return the place of the goal."""
        return self._goals.places[context] if self._goals.places else None

    def is_reached(self, frame: Frame, seen: Seen) -> bool:
        """Return whether the goal of a call is reached."""
        return self._goals.reached(seen.observation, frame.context)

    def ends(self, frame: Frame, seen: Seen) -> float:
        """Return 1 if the goal is reached, or patience has run out, else 0."""
        given_up = self._patience > 0 and frame.primitives >= self._patience
        return float(given_up or self.is_reached(frame, seen))

    def pay(self, step: Step, frame: Frame) -> float:
        """Return 1 on reaching the goal, at the last primitive of a choice."""
        return step.arrival * self.is_reached(frame, step.next_seen)


def make_goal_hierarchy(goals: GoalSet, primitives: int, patience: int = 0) -> Hierarchy:
    """Make a hierarchy of a manager over a worker."""
    worker = Worker(goals, primitives, patience)
    return Hierarchy(Manager(goals, worker), (worker,), source=goals.source, privileges=goals.privileges)


# --- goals as points ---------------------------------------------------------------------

GoalPoint = NDArray[np.float64]
"""(dimensions,), in the units of the projection; or points, (..., dimensions)."""


def measure_straight(start: GoalPoint, end: GoalPoint) -> NDArray[np.float64]:
    """Compute the Euclidean distance over the components that matter, (...)."""
    return np.sqrt(np.nansum((end - start) ** 2, axis=-1))


@dataclass(frozen=True)
class GoalSpace:
    """Points for goals, and a finite set of goals to choose from, numbered from 0."""

    project: Callable[[Any], GoalPoint]  # observation -> its point
    goals: NDArray[np.float64]  # float64 (count, dimensions)
    is_relative: bool = False  # goals are displacements from the point of their choice
    distance: Callable[[GoalPoint, GoalPoint], NDArray[np.float64]] = measure_straight
    """From a point to points (..., dimensions), in their unit or in any other, such as primitives along the floor."""
    tolerance: float = 1e-6  # largest distance from a reached goal
    find_desired: Callable[[Any], int] | None = None
    """Observation -> number of the goal that the episode asks for, or None if only its end shows it."""
    view: GoalView | None = None  # what of an observation tables and networks see; all by default
    names: tuple[str, ...] = ()  # of the goals, for a person; none by default
    privileges: tuple[str, ...] = ("goals",)  # information beyond the observation

    def __post_init__(self) -> None:
        if self.goals.ndim != 2 or not len(self.goals):
            raise AgentSettingsError("GoalSpace.goals", f"an array of shape {self.goals.shape}",
                                     "(count, dimensions), at least one goal")
        if self.names and len(self.names) != len(self.goals):
            raise AgentSettingsError("GoalSpace.names", f"{len(self.names)} names", f"one for each of "
                                     f"{len(self.goals)} goals, or none")

    def locate(self, goal: GoalPoint, observation: Any) -> GoalPoint:
        """Return the point of a goal that was chosen at an observation."""
        return self.project(observation) + goal if self.is_relative else goal

    def advance(self, goal: GoalPoint, observation: Any, next_observation: Any) -> GoalPoint:
        """Return h(s, g, s'), the same goal relative to s': s + g - s' if goals are relative, else g."""
        if not self.is_relative:
            return goal
        return goal + self.project(observation) - self.project(next_observation)

    def measure(self, goal: GoalPoint, observation: Any) -> NDArray[np.float64]:
        """Return the distance from an observation to a goal, or to each of several; (...)."""
        return self.distance(self.project(observation), self.locate(goal, observation))

    def is_reached(self, goal: GoalPoint, observation: Any) -> bool:
        """Return whether a goal is reached at an observation."""
        return bool(self.measure(goal, observation) <= self.tolerance)

    def list_reached(self, observation: Any) -> NDArray[np.bool_]:
        """Return the mask of goals that are reached already when chosen at an observation, bool (count,)."""
        return self.measure(self.goals, observation) <= self.tolerance


class GoalTask(ViewTask):
    """A task with the view of a goal space, which is its attribute `goal_space`."""

    def __init__(self, name: str, space: GoalSpace, choices: int, child: BaseTask | None = None) -> None:
        super().__init__(name, choices, space.view, child)
        self.goal_space = space

    def list_calls(self) -> Mapping[str, Any]:
        """Return one call for each goal, by number."""
        return {f"goal {goal}": goal for goal in range(len(self.goal_space.goals))}


def make_goal_space(space: gymnasium.Space, agent: str) -> GoalSpace:
    """Make the goals of an observation space: each state of a Discrete one, else each bound of each component.

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
    """Make the same goals, for agents that use their numbers only."""
    made = make_goal_space(space, agent)
    goals, is_free = made.goals, np.isnan(made.goals)
    return GoalSet(len(goals), lambda observation, goal: bool(
        ((made.project(observation) == goals[goal]) | is_free[goal]).all()), privileges=())
