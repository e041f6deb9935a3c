"""MAXQ-0: the value of a call is what the child earns, plus what is still earned to complete the parent.

Dietterich (2000), without pseudo-rewards. Every task is told the truth about what it earns, and is
optimal for itself; the result is the recursively optimal policy of the task graph.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import count_actions
from hrl_escape.agents.hierarchy.call_stack import Return
from hrl_escape.agents.hierarchy.maxq_runner import MaxqRunner, MaxqSettings
from hrl_escape.agents.hierarchy.task import Hierarchy, Seen
from hrl_escape.agents.hierarchy.task_graph import GraphTask, flat
from hrl_escape.agents.hierarchy.value_table import ValueTable

__all__ = ["Maxq0", "Maxq0Settings"]


@dataclass(frozen=True)
class Maxq0Settings(MaxqSettings):
    """Settings of `maxq-0`."""


class Maxq0(MaxqRunner):
    """Values of primitives, and of completing a task after each of its choices.

    Primitive a, paid r:  V(a, s) <- V(a, s) + alpha [r - V(a, s)]
    Task i, child c took N from s to s':

        V(i, s')  = max over legal c' of V(c', s') + C(i, s', c')
        C(i, s, c) <- C(i, s, c) + alpha [gamma^N (1 - i is over at s') V(i, s') - C(i, s, c)]

    With `all_states`, the second is done for every state on the child's way, N counted from there. "Over" means over
    for task i: a call that its caller cut short bootstraps, and one whose child was cut learns nothing.

    Args:
        observation_space: for tasks that see the whole observation.
        action_space: Discrete.
        seed: fixes exploration.
        settings: rates, exploration, discount.
        hierarchy: from `maxq(graph, until)`; without one, a single task over all primitives, which is Q-learning.
    """

    Settings: ClassVar[type] = Maxq0Settings

    def __init__(
        self,
        observation_space: gymnasium.Space,
        action_space: gymnasium.Space,
        seed: int,
        settings: Maxq0Settings | None = None,
        hierarchy: Hierarchy | None = None,
    ) -> None:
        actions = count_actions(action_space, "maxq-0")
        super().__init__("maxq-0", observation_space, seed, settings or Maxq0Settings(), hierarchy or flat(actions))
        self.completion = self.make_table()

    def compute_choice_values(self, task: GraphTask, seen: Seen) -> NDArray[np.float64]:
        """V(c, s) + C(i, s, c), (choices,); -inf where illegal."""
        legal = task.legal(seen, None)
        return np.array([
            self.compute_value(child, seen) + self.completion.get(self.make_key(task, choice, seen))
            if legal[choice] else -np.inf
            for choice, child in enumerate(task.children)
        ])  # fmt: skip

    def compute_task_value(self, task: GraphTask, seen: Seen) -> float:
        """V(i, s), the best of its choices."""
        return float(self.compute_choice_values(task, seen).max())

    def complete(self, returned: Return, task: GraphTask, way: list[tuple[Seen, int]]) -> float:
        """Learn C of one choice from every moment on the child's way; returns the largest error."""
        is_over = returned.ended or returned.stuck or returned.terminated
        after = 0.0 if is_over else self.compute_task_value(task, returned.seen)
        choice, error = returned.decision.choice, 0.0
        for seen, duration in way:
            update = self.completion.update(self.make_key(task, choice, seen), self.gamma**duration * after)
            error = max(error, abs(update))
        return error

    def list_completions(self) -> Mapping[str, ValueTable]:
        """The one table of completions."""
        return {"completion": self.completion}
