"""MAXQ-Q: the value of a call is the child's return, plus the return of completing the parent afterwards.

Dietterich (2000). Every task reports its true return and is optimal for itself. Pseudo-rewards (section 5) affect what
a task optimises and stay out of what it reports. In addition to the completion C, which callers add up, each task keeps
another one with the pseudo-reward of its end, and chooses by that. Without pseudo-rewards this is MAXQ-0.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings, count_actions
from hrl_escape.agents.components.exploration import choose_best
from hrl_escape.agents.components.tables import ValueTable, make_discretiser
from hrl_escape.agents.hierarchy.runner import TabularRunner
from hrl_escape.agents.hierarchy.task import Hierarchy, Return, Seen, Stack, Step
from hrl_escape.agents.hierarchy.task_graph import GraphTask, View, flat, freeze, get_graph, get_task
from hrl_escape.agents.state import Kept
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class MaxqQSettings(AgentSettings):
    """Settings of `maxq-q`: learned completions, step sizes, exploration and discount."""

    epsilon_start: Annotated[float, Range(0, 1)] = 1.0
    """Epsilon at the beginning; 1 acts at random."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon from `epsilon_steps` on. More explores for longer and lowers the return of training episodes."""
    epsilon_steps: Annotated[int, Range(1)] = 5_000
    """Number of clock steps of the linear decrease of epsilon. More explores for longer."""
    exploration: Literal["epsilon-greedy", "boltzmann"] = "epsilon-greedy"
    """`epsilon-greedy` draws evenly with probability epsilon. `boltzmann` draws by exp(q / temperature)."""
    temperature: Annotated[float, Range(0, open_low=True)] = 1.0
    """Temperature of `boltzmann`, in units of return. More explores more."""
    boltzmann_clip: Annotated[float, Range(0)] = 0.0
    """Bound on the size of q / temperature in `boltzmann`, as in keras-rl 0.4.2; values beyond it are equally likely. 0
    sets none."""
    bins: Annotated[int, Range(2)] = 11
    """Number of evenly spaced points, both bounds included, to round bounded components to: 11 over a 20 m room is 2 m.
    More points make more, finer states. Binary components are unchanged."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """Unit to round unbounded components to multiples of. Smaller values make more, finer states."""
    learning_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.5
    """Step size of the first update of a state and action. 1 suits deterministic environments; smaller values average
    noise."""
    learning_rate_power: Annotated[float, Range(0, 1)] = 0.0
    """Power p in the step size learning_rate / n^p of the n-th update of a state and action. Values above 0.5 converge
    under noise."""
    initial_value: float = 0.0
    """Value of actions that were never tried, in units of return. Higher values explore more."""
    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k. Higher values look further ahead."""
    polled: Literal["never", "evaluation", "always"] = "never"
    """Choose every running call again at each primitive, instead of running it to its end: never, in evaluation
    only (hierarchical greedy execution), or always."""
    pseudo_rewards: bool = True
    """Choose by completions with the pseudo-rewards of the task graph; False is MAXQ-0."""
    all_states: bool = True
    """Learn the completion of a choice from every state on the child's way, instead of the first one alone."""


class MaxqQ(TabularRunner):
    """Two completions of each choice: one reported to callers, and one that the task chooses by.

    Primitive a, reward r:  V(a, s) <- V(a, s) + alpha [r - V(a, s)]
    Task i, child c took N from s to s'; D is C with the pseudo-reward P_i of i's final state:

        a* = argmax over legal c' of V(c', s') + D(i, s', c')
        D(i, s, c) <- D + alpha [gamma^N (V(a*, s') + D(i, s', a*)) - D],   gamma^N P_i(s') where i ended at s'
        C(i, s, c) <- C + alpha [gamma^N (V(a*, s') + C(i, s', a*)) - C],   0               where i ended at s'
        V(i, s')   =  V(a*, s') + C(i, s', a*)

    One a*, chosen by D, serves both: C is the value of the executed policy. C contains no pseudo-reward, and callers
    therefore receive returns of the environment. With `all_states`, C and D are learned for every state on the child's
    way, with N counted from there. "Ended" means over for task i. A call that its caller cut short bootstraps, and one
    whose child was cut is not learned, including options of the environment.

    A task with a given policy makes no choices and has no completions. Like a primitive it is worth the return of its
    calls, learned from every state on the way. A call that was cut bootstraps.

    Args:
        observation_space: observation space, for tasks that see the whole observation.
        hierarchy: result of `maxq(graph, until, pseudo=...)`; without one, a single task over all primitives, which is
            Q-learning.

    Attributes:
        tables: C (`completion`), D (`own_completion`), V of primitives (`primitive`) and of tasks with a given policy
            (`walk`).
    """

    settings: MaxqQSettings
    EPISODE = (*TabularRunner.EPISODE, "_way")
    EPISODE_STATE = (*TabularRunner.EPISODE_STATE, "way")
    STATE = ("tables", Kept("_told_way", "way"))
    _way: list[tuple[Seen, int, float]]
    """Moments of the running root call, with the duration and reward of each one's primitive."""

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: MaxqQSettings | None = None, hierarchy: Hierarchy | None = None) -> None:
        settings = settings or MaxqQSettings()
        super().__init__(hierarchy or flat(count_actions(action_space, "maxq-q")), seed, settings)
        self._primitive_views = get_graph(self.hierarchy, "maxq-q").primitive_views
        self.tables = {name: ValueTable(settings.learning_rate, settings.learning_rate_power, settings.initial_value)
                       for name in ("completion", "own_completion", "primitive", "walk")}
        self._discretise = _make_discretiser(observation_space, settings, self.hierarchy)

    def begin_episode(self) -> None:
        """Clear the running calls."""
        super().begin_episode()
        self._way = []

    # --- values -----------------------------------------------------------------------

    def make_key(self, task: GraphTask, choice: int, seen: Seen) -> Hashable:
        """Return the key of (task, choice) at a moment, from the finest given view."""
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
        """Return V(c, s) of a child: from a table for a primitive or given policy, otherwise from the graph below."""
        if isinstance(child, int):
            return self.tables["primitive"].get(self._make_primitive_key(child, seen))
        if child.policy is not None:
            return self.tables["walk"].get(self._make_walk_key(child, seen))
        return self.compute_task_value(child, seen)

    def compute_choice_values(self, task: GraphTask, seen: Seen) -> NDArray[np.float64]:
        """Return V(c, s) + D(i, s, c), (choices,); -inf if illegal."""
        legal = task.legal(seen, None)
        return np.array([
            self.compute_value(child, seen) + self.tables["own_completion"].get(self.make_key(task, choice, seen))
            if legal[choice] else -np.inf
            for choice, child in enumerate(task.children)
        ])  # fmt: skip

    def compute_task_value(self, task: GraphTask, seen: Seen) -> float:
        """Return V(i, s): the environment's return of the choice that D prefers."""
        choice = int(self.compute_choice_values(task, seen).argmax())
        told = self.tables["completion"].get(self.make_key(task, choice, seen))
        return self.compute_value(task.children[choice], seen) + told

    # --- the agent --------------------------------------------------------------------

    def weigh(self, stack: Stack, view: Any, seen: Seen) -> NDArray[np.float64] | None:
        """Return the values that the task chooses by, unless its policy is given."""
        task = get_task(stack)
        return None if task.policy is not None else self.compute_choice_values(task, seen)

    def choose_greedy(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen, rng: np.random.Generator
                      ) -> int:
        """Return the best choice; ties by the first, because callers use the value of that one."""
        values = self.weigh(stack, view, seen)
        return int(legal.argmax()) if values is None else choose_best(values, legal)

    def learn(self, step: Step, returns: list[Return]) -> Mapping[str, float]:
        """Update the primitive's value, then the completions of finished choices, the innermost first."""
        self._way.append((step.seen, step.duration, step.reward))
        error = 0.0
        if not step.cut:
            key = self._make_primitive_key(step.action, step.seen)
            error = abs(self.tables["primitive"].update(key, step.reward))
        for returned in returns:
            task = get_task(returned.stack)
            cut_before_its_end = (returned.cut or step.cut) and not (returned.ended or returned.terminated)
            if task.policy is not None:
                error = max(error, self._learn_walk(returned, task) if returned.is_over else 0.0)
            elif not cut_before_its_end:
                error = max(error, self.complete(returned, task, self._get_way(returned.decision.duration)))
        if not self._stack:
            self._way = []
        return self.finish_step(step, error)

    def complete(self, returned: Return, task: GraphTask, way: list[tuple[Seen, int]]) -> float:
        """Update D and C of a choice from moments and primitives to its end; return the largest error of D."""
        own_after = after = 0.0
        if returned.ended:
            own_after = task.final(returned.frame, returned.seen) if self.settings.pseudo_rewards else 0.0
        elif not (returned.stuck or returned.terminated):
            own_after = float(self.compute_choice_values(task, returned.seen).max())
            after = self.compute_task_value(task, returned.seen)
        choice, error = returned.decision.choice, 0.0
        for seen, duration in way:
            key, discount = self.make_key(task, choice, seen), self.gamma**duration
            error = max(error, abs(self.tables["own_completion"].update(key, discount * own_after)))
            self.tables["completion"].update(key, discount * after)
        return error

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
        """Update a given policy's value from every moment of a finished call; return the largest error."""
        is_complete = returned.ended or returned.stuck or returned.terminated
        earned = 0.0 if is_complete else self.tables["walk"].get(self._make_walk_key(task, returned.seen))
        length, error = 0, 0.0
        for seen, took, reward in reversed(self._way):
            length, earned = length + took, reward + self.gamma**took * earned
            error = max(error, abs(self.tables["walk"].update(self._make_walk_key(task, seen), earned)))
            if length >= returned.frame.primitives:
                break
        return error

    @property
    def _told_way(self) -> list[list[Any]]:
        return [[seen.observation, seen.mask, duration, reward] for seen, duration, reward in self._way]

    @_told_way.setter
    def _told_way(self, saved: list[list[Any]]) -> None:
        self._way = [(self.hierarchy.see(seen, np.asarray(mask, np.bool_)), int(duration), float(reward))
                     for seen, mask, duration, reward in saved]


def _make_discretiser(space: gymnasium.Space, settings: MaxqQSettings, hierarchy: Hierarchy
                      ) -> Callable[[Any], bytes] | None:
    """Keys of whole observations, or None if every task and primitive has a view of its own."""
    graph = [task for task in hierarchy.tasks.values() if isinstance(task, GraphTask)]
    called = {(child, index, task) for task in graph for index, child in enumerate(task.children)}
    is_covered = all(
        (None in task.views or (task.policy is None and index in task.views))
        and (not isinstance(child, int) or child in task.primitive_views)
        for child, index, task in called
    )
    return None if is_covered else make_discretiser(space, settings, "maxq-q")
