"""Shared parts of the MAXQ learners: primitive values, the path through a call, exploration, the checkpoint.

Each learner adds its completion tables and its equation.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.components.exploration import (
    ExplorationSettings,
    choose_best,
    compute_epsilon,
    make_rng,
    sample_action,
)
from hrl_escape.agents.components.tables import TabularSettings, make_discretiser
from hrl_escape.agents.hierarchy.call_stack import Return
from hrl_escape.agents.hierarchy.runner import CallRunner, StackSettings
from hrl_escape.agents.hierarchy.task import Hierarchy, Seen, Stack, Step
from hrl_escape.agents.hierarchy.task_graph import GraphTask, View, freeze, get_graph
from hrl_escape.agents.hierarchy.value_table import ValueTable
from hrl_escape.agents.state import StateTree

__all__ = ["MaxqRunner", "MaxqSettings"]


@dataclass(frozen=True)
class MaxqSettings(StackSettings, TabularSettings, ExplorationSettings):
    """Settings that the MAXQ learners have in common."""

    all_states: bool = True
    """Learn the completion of a choice from every state on the child's way, not from the first alone."""


class MaxqRunner(CallRunner):
    """Runs a task graph and splits each outcome into what a primitive earned and what completes its callers.

    A task whose policy is given has nothing to choose, so it has no completions: like a primitive it is worth what
    its calls earned, learned from every state on the way. A call that was cut bootstraps.

    Attributes:
        primitive: V(a, s) of the primitives.
        walk: V(i, s) of the tasks whose policy is given.
    """

    settings: MaxqSettings

    def __init__(
        self, name: str, observation_space: gymnasium.Space, seed: int, settings: MaxqSettings, hierarchy: Hierarchy
    ) -> None:
        super().__init__(hierarchy, seed, settings)
        self._primitive_views = get_graph(hierarchy, name).primitive_views
        self.primitive, self.walk = self.make_table(), self.make_table()
        self._discretise = _make_discretiser(name, observation_space, settings, hierarchy)
        self._action_rng = make_rng(seed, "actions")
        self._steps = 0
        self._way: list[tuple[Seen, int, float]] = []
        """Moments of the running root call; how long each one's primitive took, and what it earned."""

    # --- what learners say ------------------------------------------------------------

    @abstractmethod
    def compute_choice_values(self, task: GraphTask, seen: Seen) -> NDArray[np.float64]:
        """Values that a task chooses by, (choices,); -inf where illegal."""

    @abstractmethod
    def compute_task_value(self, task: GraphTask, seen: Seen) -> float:
        """V(i, s) of a task that chooses."""

    @abstractmethod
    def complete(self, returned: Return, task: GraphTask, way: list[tuple[Seen, int]]) -> float:
        """Learn the completion of a choice; `way` holds (moment, primitives from it to the end)."""

    @abstractmethod
    def list_completions(self) -> Mapping[str, ValueTable]:
        """Tables of completions by name, for the checkpoint."""

    # --- parts ------------------------------------------------------------------------

    def make_table(self) -> ValueTable:
        """A table with the rates of the settings."""
        settings = self.settings
        return ValueTable(settings.learning_rate, settings.learning_rate_power, settings.initial_value)

    def make_key(self, task: GraphTask, choice: int, seen: Seen) -> Hashable:
        """Key of (task, choice) at a moment, by the finest view that is given."""
        return task.name, choice, self._show(task.views.get(choice) or task.views.get(None), seen)

    def _make_primitive_key(self, primitive: int, seen: Seen) -> Hashable:
        return primitive, self._show(self._primitive_views.get(primitive), seen)

    def _make_walk_key(self, task: GraphTask, seen: Seen) -> Hashable:
        return task.name, self._show(task.views.get(None), seen)

    def _show(self, view: View | None, seen: Seen) -> Hashable:
        if view is not None:
            return freeze(view(seen))
        assert self._discretise is not None
        return self._discretise(seen.observation)

    def compute_value(self, child: GraphTask | int, seen: Seen) -> float:
        """V(c, s) of a child: a table for a primitive or a given policy, the graph below for a task that chooses."""
        if isinstance(child, int):
            return self.primitive.get(self._make_primitive_key(child, seen))
        if child.policy is not None:
            return self.walk.get(self._make_walk_key(child, seen))
        return self.compute_task_value(child, seen)

    # --- the agent --------------------------------------------------------------------

    def choose(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen) -> int:
        """Explore by what the task chooses by."""
        if _get_task(stack).policy is not None:
            return int(legal.argmax())
        values = self.compute_choice_values(_get_task(stack), seen)
        return sample_action(values, legal, self.settings, self._steps, self._action_rng)

    def choose_greedy(
        self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen, rng: np.random.Generator
    ) -> int:
        """The best choice, the first among equals: callers are told what that one earns."""
        if _get_task(stack).policy is not None:
            return int(legal.argmax())
        return choose_best(self.compute_choice_values(_get_task(stack), seen), legal)

    def learn(self, step: Step, returns: list[Return]) -> Mapping[str, float]:
        """Learn the primitive's value, then the completions of the choices that came back, the innermost first."""
        self._way.append((step.seen, step.duration, step.reward))
        error = abs(self.primitive.update(self._make_primitive_key(step.action, step.seen), step.reward))
        for returned in returns:
            task = _get_task(returned.stack)
            cut_before_its_end = returned.cut and not (returned.ended or returned.terminated)
            if task.policy is not None:
                error = max(error, self._learn_walk(returned, task) if returned.is_over else 0.0)
            elif not cut_before_its_end:
                error = max(error, self.complete(returned, task, self._get_way(returned.decision.duration)))
        if not self._stack:
            self._way = []
        self._steps += step.duration
        return {"td_error": error, "epsilon": compute_epsilon(self.settings, self._steps)}

    def _get_way(self, duration: int) -> list[tuple[Seen, int]]:
        """Moments of the last `duration` primitives, the latest first, each with the primitives to the end."""
        way, length = [], 0
        for seen, took, _ in reversed(self._way):
            length += took
            way.append((seen, length))
            if length >= duration:
                return way if self.settings.all_states else way[-1:]
        return way

    def _learn_walk(self, returned: Return, task: GraphTask) -> float:
        """Learn a given policy's value from every moment of a call that is over; returns the largest error."""
        is_complete = returned.ended or returned.stuck or returned.terminated
        earned = 0.0 if is_complete else self.walk.get(self._make_walk_key(task, returned.seen))
        length, error = 0, 0.0
        for seen, took, reward in reversed(self._way):
            length, earned = length + took, reward + self.gamma**took * earned
            error = max(error, abs(self.walk.update(self._make_walk_key(task, seen), earned)))
            if length >= returned.frame.primitives:
                break
        return error

    def state_dict(self) -> StateTree:
        """Tables, counter, generators, running calls and the way they went."""
        return {
            **super().state_dict(),
            "tables": {name: table.state_dict() for name, table in self._list_tables().items()},
            "steps": self._steps,
            "action_rng": self._action_rng.bit_generator.state,
            "way": [[seen.observation, seen.mask, duration, reward] for seen, duration, reward in self._way],
        }

    def load_state_dict(self, state: StateTree) -> None:
        """Restore what `state_dict` gave."""
        super().load_state_dict(state)
        for name, table in self._list_tables().items():
            table.load_state_dict(state["tables"][name])
        self._steps = int(state["steps"])
        self._action_rng.bit_generator.state = state["action_rng"]
        self._way = [(self.hierarchy.see(seen, np.asarray(mask, np.bool_)), int(duration), float(reward))
                     for seen, mask, duration, reward in state["way"]]  # fmt: skip

    def _list_tables(self) -> Mapping[str, ValueTable]:
        return {**self.list_completions(), "primitive": self.primitive, "walk": self.walk}


def _make_discretiser(
    name: str, space: gymnasium.Space, settings: MaxqSettings, hierarchy: Hierarchy
) -> Callable[[Any], bytes] | None:
    """Keys of whole observations; None where every task and primitive has a view of its own."""
    graph = [task for task in hierarchy.tasks.values() if isinstance(task, GraphTask)]
    called = {(child, index, task) for task in graph for index, child in enumerate(task.children)}
    is_covered = all(
        (None in task.views or (task.policy is None and index in task.views))
        and (not isinstance(child, int) or child in task.primitive_views)
        for child, index, task in called
    )
    return None if is_covered else make_discretiser(space, settings, name)


def _get_task(stack: Stack) -> GraphTask:
    task = stack[-1].task
    assert isinstance(task, GraphTask)
    return task
