"""MAXQ-Q: MAXQ with pseudo-rewards, which shape what a task strives for and stay out of what it reports.

Dietterich (2000), section 5. Beside the completion C, which callers add up, each task keeps its own
completion with the pseudo-reward of its end, and chooses by that.
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

__all__ = ["MaxqQ", "MaxqQSettings"]


@dataclass(frozen=True)
class MaxqQSettings(MaxqSettings):
    """Settings of `maxq-q`."""


class MaxqQ(MaxqRunner):
    """Two completions of each choice: what callers are told, and what the task chooses by.

    Primitive a, paid r:  V(a, s) <- V(a, s) + alpha [r - V(a, s)]
    Task i, child c took N from s to s'; D is C with the pseudo-reward P_i of where i ends:

        a* = argmax over legal c' of V(c', s') + D(i, s', c')
        D(i, s, c) <- D + alpha [gamma^N (V(a*, s') + D(i, s', a*)) - D],   gamma^N P_i(s') where i ended at s'
        C(i, s, c) <- C + alpha [gamma^N (V(a*, s') + C(i, s', a*)) - C],   0               where i ended at s'
        V(i, s')   =  V(a*, s') + C(i, s', a*)

    One a*, chosen by D, serves both: C is the value of the policy that is followed. No pseudo-reward reaches C, so
    callers are told what the environment pays. Without pseudo-rewards D = C, which is `maxq-0`.

    Args:
        observation_space: for tasks that see the whole observation.
        action_space: Discrete.
        seed: fixes exploration.
        settings: rates, exploration, discount.
        hierarchy: from `maxq(graph, until, pseudo=...)`; without one, a single task over all primitives.
    """

    Settings: ClassVar[type] = MaxqQSettings

    def __init__(
        self,
        observation_space: gymnasium.Space,
        action_space: gymnasium.Space,
        seed: int,
        settings: MaxqQSettings | None = None,
        hierarchy: Hierarchy | None = None,
    ) -> None:
        actions = count_actions(action_space, "maxq-q")
        super().__init__("maxq-q", observation_space, seed, settings or MaxqQSettings(), hierarchy or flat(actions))
        self.completion, self.own_completion = self.make_table(), self.make_table()

    def compute_choice_values(self, task: GraphTask, seen: Seen) -> NDArray[np.float64]:
        """V(c, s) + D(i, s, c), (choices,); -inf where illegal."""
        legal = task.legal(seen, None)
        return np.array([
            self.compute_value(child, seen) + self.own_completion.get(self.make_key(task, choice, seen))
            if legal[choice] else -np.inf
            for choice, child in enumerate(task.children)
        ])  # fmt: skip

    def compute_task_value(self, task: GraphTask, seen: Seen) -> float:
        """V(i, s): what the choice that D prefers earns from the environment."""
        choice = int(self.compute_choice_values(task, seen).argmax())
        return self.compute_value(task.children[choice], seen) + self.completion.get(self.make_key(task, choice, seen))

    def complete(self, returned: Return, task: GraphTask, way: list[tuple[Seen, int]]) -> float:
        """Learn D and C of one choice from every moment on the child's way; returns the largest error of D."""
        own_after = after = 0.0
        if returned.ended:
            own_after = task.final(returned.frame, returned.seen)
        elif not (returned.stuck or returned.terminated):
            own_after = float(self.compute_choice_values(task, returned.seen).max())
            after = self.compute_task_value(task, returned.seen)
        choice, error = returned.decision.choice, 0.0
        for seen, duration in way:
            key, discount = self.make_key(task, choice, seen), self.gamma**duration
            error = max(error, abs(self.own_completion.update(key, discount * own_after)))
            self.completion.update(key, discount * after)
        return error

    def list_completions(self) -> Mapping[str, ValueTable]:
        """Both tables of completions."""
        return {"completion": self.completion, "own_completion": self.own_completion}
