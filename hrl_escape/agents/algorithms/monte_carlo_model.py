"""Planning over sampled partial models: draw one structure from those the history leaves likely, act on it, draw again.

In the spirit of Menashe and Stone (2015), whose learner draws partial models of an action's dependencies by Monte
Carlo and plans with them, and of posterior sampling (Strens 2000). A drawn model is partial: it says nothing about
contexts it has not met, and the agent goes there first. This is cheaper than ruling out every other structure, as
`factored-r-max` does, and less certain.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings, SMDPTransition
from hrl_escape.agents.components.exploration import sample_index
from hrl_escape.agents.factored.planning_agent import PlanningAgent
from hrl_escape.agents.factored.search import ModelPlan
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class MonteCarloModelSettings(AgentSettings):
    """Draws of `monte-carlo-model` and what makes a structure likely, beside hypotheses and search."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k."""
    max_parents: Annotated[int, Range(0, 8)] = 2
    """Most factors that decide an outcome, a bit's own value not counted; hypotheses grow as factors to this power."""
    conditions: Literal["all-on", "any"] = "all-on"
    """Contexts that a set of parents tells apart. `all-on`: all of them on, or not, as in a graph of prerequisites
    (wherever every factor is a bit). `any`: each combination of their values."""
    most_nodes: Annotated[int, Range(1)] = 20_000
    """States that a search may expand; what it has not found by then it takes to be out of reach."""
    samples: Annotated[int, Range(1)] = 2
    """Structures drawn for each action; the first predicts, a context that any of them has not met is open."""
    size_penalty: Annotated[float, Range(0)] = 1.0
    """Each parent more makes a structure less likely by exp(-this)."""
    error_penalty: Annotated[float, Range(0)] = 4.0
    """Each outcome that a structure leaves unexplained makes it less likely by exp(-this)."""
    redraws: Annotated[int, Range(0)] = 10
    """Further draws, when models leave nothing open and know no end of the task, before it acts at random."""


class MonteCarloModel(PlanningAgent):
    """Believes structures drawn from their posterior, anew in each episode and after each sample of an action."""

    settings: MonteCarloModelSettings
    STATE = ("_episode", "_redraws", "_seed")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: MonteCarloModelSettings | None = None) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        self._drawn = self.model.make_belief(self._draw, visits=1)
        self._likeliest = self.model.make_belief(self.model.get_likeliest, visits=1)
        self._seed = seed
        self._episode, self._redraws = 0, 0

    def get_graph(self) -> frozenset[tuple[int, int]]:
        """Edges (parent, child) of the likeliest structures; see `FactoredModel.find_graph`."""
        return self.model.find_graph(self.model.get_likeliest)

    def _draw(self, action: int, outcome: int) -> NDArray[np.int64]:
        """Draw hypotheses from the posterior, by a generator that follows from counters, so that none needs saving."""
        learner = self.model.learner
        errors = learner.get_errors(action, outcome)
        sizes = np.array([len(parents) for parents in learner.hypotheses])
        penalty = self.settings.error_penalty * (errors - errors.min()) + self.settings.size_penalty * sizes
        weights = np.exp(penalty.min() - penalty)
        tried = learner.count_samples(action)
        words = [self._seed, self._episode, self._redraws, action, tried]  # not the outcome: those of an action agree
        rng = np.random.default_rng(words)
        return np.array([sample_index(weights, rng) for _ in range(self.settings.samples)])

    def _find_plan(self, observation: Any, action_mask: NDArray[np.bool_]) -> ModelPlan:
        """The way to what the drawn models leave open, else to the end of the task by them; drawn anew if neither."""
        plan = ModelPlan((), (), -np.inf)
        for attempt in range(1 + self.settings.redraws):
            if attempt:
                self._redraws += 1
                self._drawn.forget()
            plan = self._search(self._drawn, observation, action_mask, seek_gaps=True)
            self._is_exploring = bool(plan.actions)
            if not plan.actions:
                plan = self._search(self._drawn, observation, action_mask, seek_gaps=False)
            if plan.actions:
                break
        return plan

    def _find_escape(self, observation: Any, action_mask: NDArray[np.bool_]) -> ModelPlan:
        """The way to the end of the task by the likeliest model."""
        return self._search(self._likeliest, observation, action_mask, seek_gaps=False)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Add to the history; a new episode draws anew."""
        metrics = super().observe(transition)
        if transition.terminated or transition.truncated:
            self._episode += 1
            self._drawn.forget()
        return metrics
