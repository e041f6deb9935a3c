"""Planning in sampled partial models: draw a structure from the likely ones, act on it, draw again.

Follows Menashe and Stone (2015), who draw partial models of an action's dependencies by Monte Carlo and plan with them,
and posterior sampling (Strens 2000). A drawn model is partial: contexts that it has not met are open, and the agent
goes there first. This is cheaper than ruling out every other structure, as `factored-r-max` does, and less certain.
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
    """Settings of `monte-carlo-model`: draws, priors of structures, hypotheses and search."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k. Higher values look further ahead."""
    max_parents: Annotated[int, Range(0, 8)] = 2
    """Most factors that decide an outcome, apart from a bit's own value. The number of hypotheses is the number of
    factors to this power."""
    conditions: Literal["all-on", "any"] = "all-on"
    """Contexts that a set of parents distinguishes. `all-on`: whether all of them are on, as in a graph of
    prerequisites (requires binary factors). `any`: each combination of their values."""
    most_nodes: Annotated[int, Range(1)] = 20_000
    """Most states that a search expands. Goals not found by then count as unreachable."""
    samples: Annotated[int, Range(1)] = 2
    """Number of structures drawn for each action. The first one predicts; a context new to any of them is open. More
    explore more."""
    size_penalty: Annotated[float, Range(0)] = 1.0
    """Penalty per parent, in nats: each parent makes a structure less likely by exp(-size_penalty)."""
    error_penalty: Annotated[float, Range(0)] = 4.0
    """Penalty per unexplained outcome, in nats: each makes a structure less likely by exp(-error_penalty)."""
    redraws: Annotated[int, Range(0)] = 10
    """Number of further draws before a random action, if models leave nothing open and have no end of the task."""


class MonteCarloModel(PlanningAgent):
    """Believes structures drawn from their posterior, again in each episode and after each sample of an action."""

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
        """Return edges (parent, child) of the likeliest structures; see `FactoredModel.find_graph`."""
        return self.model.find_graph(self.model.get_likeliest)

    def _draw(self, action: int, outcome: int) -> NDArray[np.int64]:
        """Draw hypotheses from the posterior, by a generator derived from counters, which needs no checkpoint."""
        learner = self.model.learner
        errors = learner.get_errors(action, outcome)
        sizes = np.array([len(parents) for parents in learner.hypotheses])
        penalty = self.settings.error_penalty * (errors - errors.min()) + self.settings.size_penalty * sizes
        weights = np.exp(penalty.min() - penalty)
        tried = learner.count_samples(action)
        words = [self._seed, self._episode, self._redraws, action, tried]  # without the outcome: an action's agree
        rng = np.random.default_rng(words)
        return np.array([sample_index(weights, rng) for _ in range(self.settings.samples)])

    def _find_plan(self, observation: Any, action_mask: NDArray[np.bool_]) -> ModelPlan:
        """Way to open contexts of the drawn models, or to the end of the task; without either, draw again."""
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
        """Way to the end of the task by the likeliest model."""
        return self._search(self._likeliest, observation, action_mask, seek_gaps=False)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Add to the history; a new episode draws again."""
        metrics = super().observe(transition)
        if transition.terminated or transition.truncated:
            self._episode += 1
            self._drawn.forget()
        return metrics
