"""Agents that learn a factored model and plan in it: to open outcomes first, then to the end of the task.

A subclass chooses the hypotheses that it believes.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent, SMDPTransition, count_actions
from hrl_escape.agents.components.exploration import make_rng, sample_legal
from hrl_escape.agents.factored.compiled_model import ActionModel, compile_action
from hrl_escape.agents.factored.model import Belief, FactoredModel, PendingPlan
from hrl_escape.agents.factored.search import ModelPlan
from hrl_escape.agents.factored.structure import StructureLearner
from hrl_escape.agents.settings import DiscountSettings
from hrl_escape.agents.state import Kept
from hrl_escape.settings import Range


@dataclass(frozen=True)
class PlanningSettings(DiscountSettings):
    """Hypotheses that are considered, and the bound of the search."""

    max_parents: Annotated[int, Range(0, 8)] = 2
    """Most factors that decide an outcome, a bit's own value not counted; hypotheses grow as factors to this power."""
    conditions: Literal["all-on", "any"] = "all-on"
    """Contexts that a set of parents tells apart. `all-on`: all of them on, or not, as in a graph of prerequisites
    (wherever every factor is a bit). `any`: each combination of their values."""
    most_nodes: Annotated[int, Range(1)] = 20_000
    """States that a search may expand; what it has not found by then it takes to be out of reach."""


class PlanningAgent(Agent):
    """Base of agents that follow plans in a learned factored model.

    Attributes:
        model: the history, and everything derived from it.
    """

    name: ClassVar[str]
    STATE = ("model", "_pending", Kept("_is_exploring", "exploring"), "_rng")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: PlanningSettings | None) -> None:
        self.settings = settings or self.Settings()
        actions = count_actions(action_space, self.name)
        self.model = FactoredModel(observation_space, actions, self.gamma, self.settings.max_parents,
                                   self.settings.conditions, self.name, self.make_learner, self.compile_model)
        self._rng = make_rng(seed, "actions")
        self._pending = PendingPlan()
        self._is_exploring = self._is_planned = False

    def make_learner(self, sizes: NDArray[np.int64], actions: int, max_parents: int, all_on: bool) -> StructureLearner:
        """The learner of structure, new."""
        return StructureLearner(sizes, actions, max_parents, all_on)

    def compile_model(self, *arguments: Any) -> ActionModel:
        """Model of an action, from the arguments of `compile_action`."""
        return compile_action(*arguments)

    @abstractmethod
    def _find_plan(self, observation: Any, action_mask: NDArray[np.bool_]) -> ModelPlan:
        """The plan to follow in training: to an open outcome, or to the end of the task."""

    @abstractmethod
    def _find_escape(self, observation: Any, action_mask: NDArray[np.bool_]) -> ModelPlan:
        """The plan to the end of the task by what is known."""

    def _search(self, belief: Belief, observation: Any, action_mask: NDArray[np.bool_], seek_gaps: bool) -> ModelPlan:
        return self.model.search(belief, observation, action_mask, seek_gaps, self.settings.most_nodes)

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """The next step of the plan; without one, any legal action."""
        self._is_planned = False
        if self.model.is_empty:
            return sample_legal(action_mask, self._rng)
        state = self.model.pack(observation)
        action = self._pending.take(state, action_mask)
        if action is None:
            self._pending.begin(self._find_plan(observation, action_mask))
            action = self._pending.take(state, action_mask)
        self._is_planned = action is not None
        return sample_legal(action_mask, self._rng) if action is None else action

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The first step to the end of the task; where no way is known, any legal action."""
        plan = None if self.model.is_empty else self._find_escape(observation, action_mask)
        return plan.actions[0] if plan and plan.actions else sample_legal(action_mask, rng)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Add to the history; the end of an episode drops the plan. `planned` is 0 of a choice by chance."""
        self.model.record(transition)
        if transition.terminated or transition.truncated:
            self._pending.drop()
        return {"exploring": float(self._is_exploring), "planned": float(self._is_planned)}
