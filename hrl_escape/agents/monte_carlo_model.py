"""Planning over sampled partial models: draw one structure from those the history leaves likely, act on it, draw again.

In the spirit of Menashe and Stone (2015), whose learner draws partial models of an action's dependencies by Monte
Carlo and plans with them, and of posterior sampling (Strens 2000). A drawn model is partial: it says nothing about
contexts it has not met, and the agent goes there first. Cheaper than to rule every other structure out,
which `factored-r-max` does, and less sure to.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import SMDPTransition, StateTree, count_actions
from hrl_escape.agents.exploration import make_rng, sample_index, sample_legal
from hrl_escape.agents.factored_model import FactoredModel, PendingPlan
from hrl_escape.agents.lookahead import Plan
from hrl_escape.agents.settings import AgentSettings, Range

__all__ = ["MonteCarloModel", "MonteCarloModelSettings"]


@dataclass(frozen=True)
class MonteCarloModelSettings(AgentSettings):
    """Settings of `monte-carlo-model`."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive."""
    max_parents: Annotated[int, Range(0, 8)] = 2
    """Most factors that decide an outcome, a bit's own value not counted; hypotheses grow as factors to this power."""
    conditions: Literal["all-on", "any"] = "all-on"
    """What a set of parents can decide. `all-on`: one thing where all of them are on and another where not, as in a
    graph of prerequisites (wherever every factor is a bit). `any`: something else for each combination of values."""
    samples: Annotated[int, Range(1)] = 2
    """Structures drawn for each action; the first predicts, a context that any of them has not met is open."""
    size_penalty: Annotated[float, Range(0)] = 1.0
    """Each parent more makes a structure less likely by exp(-this)."""
    error_penalty: Annotated[float, Range(0)] = 4.0
    """Each outcome that a structure leaves unexplained makes it less likely by exp(-this)."""
    redraws: Annotated[int, Range(0)] = 10
    """Draws anew, when models leave nothing open and know no end of the task, before it acts at random."""
    most_nodes: Annotated[int, Range(1)] = 20_000
    """States that a search may expand."""


class MonteCarloModel:
    """Draws structures from their posterior once an episode and whenever there is news of an action."""

    Settings: ClassVar[type] = MonteCarloModelSettings
    recipes: ClassVar[Mapping[str, MonteCarloModelSettings]] = {"corrected": MonteCarloModelSettings()}

    def __init__(
        self,
        observation_space: gymnasium.Space,
        action_space: gymnasium.Space,
        seed: int,
        settings: MonteCarloModelSettings | None = None,
    ) -> None:
        self.settings = settings or MonteCarloModelSettings()
        actions = count_actions(action_space, "monte-carlo-model")
        self.model = FactoredModel(
            observation_space,
            actions,
            self.settings.gamma,
            self.settings.max_parents,
            self.settings.conditions,
            "monte-carlo-model",
        )
        self._drawn = self.model.make_belief(self._draw, visits=1)
        self._likeliest = self.model.make_belief(self.model.get_likeliest, visits=1)
        self._seed = seed
        self._rng = make_rng(seed, "actions")
        self._pending = PendingPlan()
        self._episode, self._redraws = 0, 0
        self._is_exploring = False

    @property
    def gamma(self) -> float:
        """Discount per primitive."""
        return self.settings.gamma

    def get_graph(self) -> frozenset[tuple[int, int]]:
        """Edges (parent, child) of the likeliest structures, by number of the observation's component."""
        return self.model.find_graph(self.model.get_likeliest)

    def _draw(self, action: int, outcome: int) -> NDArray[np.int64]:
        """Draw hypotheses from the posterior.

        The generator follows from counters and how often the action was tried, so a draw needs no saving.
        """
        learner = self.model.learner
        errors = learner.get_errors(action, outcome)
        sizes = np.array([len(parents) for parents in learner.hypotheses])
        penalty = self.settings.error_penalty * (errors - errors.min()) + self.settings.size_penalty * sizes
        weights = np.exp(penalty.min() - penalty)
        tried = learner.count_samples(action)
        words = [self._seed, self._episode, self._redraws, action, tried]  # not the outcome: those of an action agree
        rng = np.random.default_rng(words)
        return np.array([sample_index(weights, rng) for _ in range(self.settings.samples)])

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """The next step to what the drawn models leave open, else to the end of the task by them, else any."""
        if self.model.is_empty:
            return sample_legal(action_mask, self._rng)
        state = self.model.pack(observation)
        action = self._pending.take(state, action_mask)
        if action is None:
            self._pending.begin(self._find_plan(observation, action_mask))
            action = self._pending.take(state, action_mask)
        return sample_legal(action_mask, self._rng) if action is None else action

    def _find_plan(self, observation: Any, action_mask: NDArray[np.bool_]) -> Plan:
        most = self.settings.most_nodes
        plan = Plan((), (), -np.inf, True)
        for attempt in range(1 + self.settings.redraws):
            if attempt:
                self._redraws += 1
                self._drawn.forget()
            plan = self.model.search(self._drawn, observation, action_mask, True, most)
            self._is_exploring = bool(plan.actions)
            if not plan.actions:
                plan = self.model.search(self._drawn, observation, action_mask, False, most)
            if plan.actions:
                break
        return plan

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The first step to the end of the task by the likeliest model; if it knows none, any."""
        if self.model.is_empty:
            return sample_legal(action_mask, rng)
        plan = self.model.search(self._likeliest, observation, action_mask, False, self.settings.most_nodes)
        return plan.actions[0] if plan.actions else sample_legal(action_mask, rng)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Add to the history; a new episode draws anew."""
        self.model.record(transition)
        is_over = transition.terminated or transition.truncated
        if is_over:
            self._episode += 1
            self._pending.drop()
            self._drawn.forget()
        return {"exploring": float(self._is_exploring)}

    def state_dict(self) -> StateTree:
        """History, plan, what draws follow from, generator."""
        return {
            "model": self.model.state_dict(),
            "pending": self._pending.state_dict(),
            "episode": self._episode,
            "redraws": self._redraws,
            "seed": self._seed,
            "exploring": self._is_exploring,
            "rng": self._rng.bit_generator.state,
        }

    def load_state_dict(self, state: StateTree) -> None:
        """Restore what `state_dict` gave."""
        self._episode, self._redraws, self._seed = (int(state[name]) for name in ("episode", "redraws", "seed"))
        self.model.load_state_dict(state["model"])
        self._pending.load_state_dict(state["pending"])
        self._is_exploring = bool(state["exploring"])
        self._rng.bit_generator.state = state["rng"]
