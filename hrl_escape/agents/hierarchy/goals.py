"""Goals as the interface between two levels: a manager names one of finitely many, a worker walks there.

What a goal is, and whether it is reached, is read from the observation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.hierarchy.task import BaseTask, Call, Frame, Hierarchy, Seen, Stack, Step, allow_only


@dataclass(frozen=True)
class GoalView:
    """Part of an observation that a level sees."""

    space: gymnasium.Space  # of what it sees
    see: Callable[[Any], Any]  # observation -> that part


@dataclass(frozen=True)
class GoalSet:
    """Finitely many goals, numbered from 0."""

    count: int  # how many there are
    reached: Callable[[Any, int], bool]  # (observation, goal) -> whether it is reached there
    is_open: Callable[[Any, int], bool] | None = None
    """(observation, goal) -> whether the manager may name it there; anywhere by default."""
    policy: Callable[[Any, int], int | None] | None = None
    """(observation, goal) -> the primitive towards it, None where there is none; by default that is learned."""
    manager_view: GoalView | None = None  # what of an observation the manager sees; all by default
    worker_view: GoalView | None = None  # what of it the worker sees, beside the goal
    names: tuple[str, ...] = ()  # of the goals, for options made of them; numbers by default
    places: tuple[tuple[float, float] | None, ...] = ()
    """X and y of each goal on the floor, m, for drawings; none by default."""
    source: Literal["given", "synthesised"] = "given"  # where the goals come from
    privileges: tuple[str, ...] = ("goals",)  # what they tell the agent that the observation does not


class Manager(BaseTask):
    """Names an open goal that is not reached; paid by the environment."""

    def __init__(self, goals: GoalSet, worker: Worker) -> None:
        super().__init__("manager", goals.count, None if goals.manager_view is None else goals.manager_view.space)
        self._goals, self._worker = goals, worker

    def view(self, seen: Seen, stack: Stack) -> Any:
        """The manager's part of the observation."""
        view = self._goals.manager_view
        return seen.observation if view is None else view.see(seen.observation)

    def legal(self, seen: Seen, context: Any) -> NDArray[np.bool_]:
        """Goals that are open and not reached here, and towards which the worker can do something."""
        goals = self._goals
        return np.array([
            not goals.reached(seen.observation, goal)
            and (goals.is_open is None or goals.is_open(seen.observation, goal))
            and bool(self._worker.legal(seen, goal).any())
            for goal in range(goals.count)
        ], np.bool_)  # fmt: skip

    def decode(self, choice: int, seen: Seen, context: Any) -> Call:
        """The worker, told the goal."""
        return Call(self._worker, int(choice))


class Worker(BaseTask):
    """Walks to the goal it is told, paid for reaching it alone.

    Args:
        goals: which there are.
        primitives: of the environment.
        patience: primitives after which the call is given up; 0 never gives up.
    """

    def __init__(self, goals: GoalSet, primitives: int, patience: int = 0) -> None:
        super().__init__("worker", primitives, None if goals.worker_view is None else goals.worker_view.space)
        self._goals, self._patience = goals, patience
        self.is_planned = goals.policy is not None

    def view(self, seen: Seen, stack: Stack) -> Any:
        """The worker's part of the observation."""
        view = self._goals.worker_view
        return seen.observation if view is None else view.see(seen.observation)

    def legal(self, seen: Seen, context: Any) -> NDArray[np.bool_]:
        """The legal primitives; of a policy that is given, its one."""
        policy = self._goals.policy
        return seen.mask if policy is None else allow_only(policy(seen.observation, context), seen.mask)

    def list_calls(self) -> Mapping[str, Any]:
        """One a goal, under the goal's name."""
        names = self._goals.names or tuple(f"goal {goal}" for goal in range(self._goals.count))
        return {name: goal for goal, name in enumerate(names)}

    def is_callable(self, seen: Seen, context: Any) -> bool:
        """The goal is open, not reached, and there is a way."""
        is_open = self._goals.is_open
        return (is_open is None or is_open(seen.observation, context)) and super().is_callable(seen, context)

    def find_place(self, context: Any) -> tuple[float, float] | None:
        """Place of the goal."""
        return self._goals.places[context] if self._goals.places else None

    def is_reached(self, frame: Frame, seen: Seen) -> bool:
        """The goal of a call is reached."""
        return self._goals.reached(seen.observation, frame.context)

    def ends(self, frame: Frame, seen: Seen) -> float:
        """Certain where the goal is reached, or patience has run out."""
        given_up = self._patience > 0 and frame.primitives >= self._patience
        return float(given_up or self.is_reached(frame, seen))

    def pay(self, step: Step, frame: Frame) -> float:
        """1 on reaching the goal, by the last primitive of a choice that lasts several."""
        return step.arrival * self.is_reached(frame, step.next_seen)


def make_goal_hierarchy(goals: GoalSet, primitives: int, patience: int = 0) -> Hierarchy:
    """A manager over a worker."""
    worker = Worker(goals, primitives, patience)
    return Hierarchy(Manager(goals, worker), (worker,), source=goals.source, privileges=goals.privileges)
