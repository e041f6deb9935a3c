"""Feudal learning: managers over cells within cells, each paid for obeying its own manager.

Dayan and Hinton (1993), Feudal reinforcement learning. A manager sees the world at its own grain
(information hiding), and whoever obeys is paid, also if the order was no good (reward hiding).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import count_actions
from hrl_escape.agents.components.exploration import (
    ExplorationSettings,
    choose_best,
    compute_epsilon,
    make_rng,
    sample_action,
)
from hrl_escape.agents.components.tables import QTable, TabularSettings, make_discretiser
from hrl_escape.agents.hierarchy.call_stack import Return
from hrl_escape.agents.hierarchy.feudal import FeudalTask, make_feudal_hierarchy
from hrl_escape.agents.hierarchy.regions import Quadtree
from hrl_escape.agents.hierarchy.runner import CallRunner, StackSettings
from hrl_escape.agents.hierarchy.task import Seen, Stack, Step
from hrl_escape.settings import Range

__all__ = ["FeudalRl", "FeudalRlSettings"]


@dataclass(frozen=True)
class FeudalRlSettings(StackSettings, TabularSettings, ExplorationSettings):
    """Settings of `feudal-rl`."""

    penalty: Annotated[float, Range(0)] = 0.2
    """Cost to a manager of leaving its cell otherwise than it was ordered to."""
    patience: Annotated[int, Range(0)] = 10
    """Primitives after which an order to the last level is given up, and twice as many a level higher; 0 never gives
    up. Walls may shut the way that a manager was ordered."""


class FeudalRl(CallRunner):
    """Q-learning at every level of a quadtree, given the order from above.

    Level n in cell c, ordered m, chose a; that came back after k primitives in cell c', paid rho on the way:

        Q_n(c, m, a) <- Q_n + alpha [rho + gamma^k (1 - over) max over legal a' of Q_n(c', m, a') - Q_n(c, m, a)]

    rho is gamma^(k-1) times 1 where m was obeyed: the cell above c was left in the direction ordered, or the episode
    terminated during a search; minus a penalty where it was left in another direction; 0 else. "Over" is either, or
    the end of the episode; an order that was given up, or cut, bootstraps. The top level alone is paid by the
    environment, R = sum of gamma^i r_i. Below the tree the last level sees the observation and chooses primitives.

    A cell is no state: where in it the agent is decides what follows. Values of managers need not converge.

    Args:
        observation_space: Discrete, or a Box that is rounded.
        action_space: Discrete.
        seed: fixes exploration.
        settings: see `FeudalRlSettings`.
        tree: the cells; by default there are none, which is Q-learning.
    """

    Settings: ClassVar[type] = FeudalRlSettings
    STATE = ("tables", "_steps", "_action_rng")

    def __init__(
        self,
        observation_space: gymnasium.Space,
        action_space: gymnasium.Space,
        seed: int,
        settings: FeudalRlSettings | None = None,
        tree: Quadtree | None = None,
    ) -> None:
        settings = settings or FeudalRlSettings()
        actions = count_actions(action_space, "feudal-rl")
        tree = tree or Quadtree(0, lambda observation: (0.0, 0.0))
        hierarchy = make_feudal_hierarchy(tree, actions, settings.penalty, settings.patience)
        super().__init__(hierarchy, seed, settings)
        self.tables = {name: QTable(int(task.space.n), settings) for name, task in hierarchy.tasks.items()}
        self._discretise = make_discretiser(observation_space, settings, "feudal-rl")
        self._action_rng = make_rng(seed, "actions")
        self._steps = 0

    def make_key(self, task: FeudalTask, view: Any, order: int | None) -> bytes:
        """Key of what a level sees and what it was ordered."""
        seen = self._discretise(view) if task.is_last else np.asarray(view, np.int32).tobytes()
        return seen + np.int32(-1 if order is None else order).tobytes()

    def compute_choice_values(self, task: FeudalTask, view: Any, order: int | None) -> NDArray[np.float64]:
        """Q_n(c, m, .), (choices,)."""
        return self.tables[task.name].get_values(self.make_key(task, view, order))

    def choose(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen) -> int:
        """Explore by the level's values; on the last level, obey where the tree says how."""
        if _get_task(stack).is_last and _get_task(stack).tree.policy is not None:
            return int(legal.argmax())
        values = self.compute_choice_values(_get_task(stack), view, stack[-1].context)
        return sample_action(values, legal, self.settings, self._steps, self._action_rng)

    def choose_greedy(
        self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen, rng: np.random.Generator
    ) -> int:
        """The level's best choice."""
        if _get_task(stack).is_last and _get_task(stack).tree.policy is not None:
            return int(legal.argmax())
        return choose_best(self.compute_choice_values(_get_task(stack), view, stack[-1].context), legal, rng)

    def learn(self, step: Step, returns: list[Return]) -> Mapping[str, float]:
        """Learn at every level whose choice came back."""
        error = 0.0
        for returned in returns:
            task, frame, decision = _get_task(returned.stack), returned.frame, returned.decision
            if task.is_last and task.tree.policy is not None:
                continue
            order, target = frame.context, decision.reward
            if not (returned.terminated or task.is_settled(frame, returned.seen)):
                view = task.view(returned.seen, returned.stack)
                legal = task.legal(returned.seen, order)
                if not legal.any():
                    continue  # stuck
                values = self.compute_choice_values(task, view, order)
                target += decision.discount * float(np.where(legal, values, -np.inf).max())
            key = self.make_key(task, decision.view, order)
            error = max(error, abs(self.tables[task.name].update(key, decision.choice, target)))
        self._steps += step.duration
        return {"td_error": error, "epsilon": compute_epsilon(self.settings, self._steps)}


def _get_task(stack: Stack) -> FeudalTask:
    task = stack[-1].task
    assert isinstance(task, FeudalTask)
    return task
