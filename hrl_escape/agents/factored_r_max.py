"""Factored R-MAX with structure learning: explore whatever the parents still in question leave open, then exploit.

SLF-R-MAX of Strehl, Diuk and Littman (2007), for semi-Markov decisions, with the priors of `structure.py`. As in R-MAX
(Brafman and Tennenholtz 2002) what is not known is worth more than anything known; here without bound, so that
the soonest open outcome is sought while one can be reached, and the best known end after that. Plans
come from forward search (`lookahead.py`): states are never enumerated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import SMDPTransition, StateTree, count_actions
from hrl_escape.agents.exploration import make_rng, sample_legal
from hrl_escape.agents.factored_model import FactoredModel, PendingPlan
from hrl_escape.agents.lookahead import Plan
from hrl_escape.agents.settings import AgentSettings, Range

__all__ = ["FactoredRMax", "FactoredRMaxSettings"]


@dataclass(frozen=True)
class FactoredRMaxSettings(AgentSettings):
    """Settings of `factored-r-max`."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive."""
    max_parents: Annotated[int, Range(0, 8)] = 2
    """Most factors that decide an outcome, a bit's own value not counted; hypotheses grow as factors to this power."""
    conditions: Literal["all-on", "any"] = "all-on"
    """What a set of parents can decide. `all-on`: one thing where all of them are on and another where not, as in a
    graph of prerequisites (wherever every factor is a bit). `any`: something else for each combination of values."""
    visits: Annotated[int, Range(1)] = 1
    """Samples that make a context known; 1 is enough where outcomes have no chance in them."""
    most_nodes: Annotated[int, Range(1)] = 20_000
    """States that a search may expand; what it has not found by then it takes to be out of reach."""


class FactoredRMax:
    """Learns which factors decide what each action does, explores what is open, plans to the end of the task."""

    Settings: ClassVar[type] = FactoredRMaxSettings
    recipes: ClassVar[Mapping[str, FactoredRMaxSettings]] = {"corrected": FactoredRMaxSettings()}

    def __init__(
        self,
        observation_space: gymnasium.Space,
        action_space: gymnasium.Space,
        seed: int,
        settings: FactoredRMaxSettings | None = None,
    ) -> None:
        self.settings = settings or FactoredRMaxSettings()
        actions = count_actions(action_space, "factored-r-max")
        self.model = FactoredModel(
            observation_space,
            actions,
            self.settings.gamma,
            self.settings.max_parents,
            self.settings.conditions,
            "factored-r-max",
        )
        self._careful = self.model.make_belief(self.model.get_alive, self.settings.visits)
        self._bold = self.model.make_belief(self.model.get_likeliest, self.settings.visits)
        self._rng = make_rng(seed, "actions")
        self._pending = PendingPlan()
        self._is_exploring = False

    @property
    def gamma(self) -> float:
        """Discount per primitive."""
        return self.settings.gamma

    def get_graph(self) -> frozenset[tuple[int, int]]:
        """Edges (parent, child) believed at present, by number of the observation's component.

        See `FactoredModel.find_graph`.
        """
        return self.model.find_graph(self._bold.choose)

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """The next step to what is open; if nothing is, to the end of the task; if none is known, any."""
        if self.model.is_empty:
            return sample_legal(action_mask, self._rng)
        state = self.model.pack(observation)
        action = self._pending.take(state, action_mask)
        if action is None:
            plan = self.model.search(self._careful, observation, action_mask, True, self.settings.most_nodes)
            self._is_exploring = bool(plan.actions)
            self._pending.begin(plan if plan.actions else self._find_escape(observation, action_mask))
            action = self._pending.take(state, action_mask)
        return sample_legal(action_mask, self._rng) if action is None else action

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The first step to the end of the task by what is known, else by what is likeliest, else any."""
        plan = None if self.model.is_empty else self._find_escape(observation, action_mask)
        return plan.actions[0] if plan and plan.actions else sample_legal(action_mask, rng)

    def _find_escape(self, observation: Any, action_mask: NDArray[np.bool_]) -> Plan:
        plan = self.model.search(self._careful, observation, action_mask, False, self.settings.most_nodes)
        if plan.actions:
            return plan
        return self.model.search(self._bold, observation, action_mask, False, self.settings.most_nodes)

    def compute_value(self, observation: Any, action_mask: NDArray[np.bool_]) -> float:
        """Discounted return of the best known way to the end of the task; -inf if none is known."""
        return -np.inf if self.model.is_empty else self._find_escape(observation, action_mask).value

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Add to the history."""
        self.model.record(transition)
        is_over = transition.terminated or transition.truncated
        if is_over:
            self._pending.drop()
        return {"exploring": float(self._is_exploring)}

    def state_dict(self) -> StateTree:
        """History, plan, generator."""
        return {
            "model": self.model.state_dict(),
            "pending": self._pending.state_dict(),
            "exploring": self._is_exploring,
            "rng": self._rng.bit_generator.state,
        }

    def load_state_dict(self, state: StateTree) -> None:
        """Restore what `state_dict` gave."""
        self.model.load_state_dict(state["model"])
        self._pending.load_state_dict(state["pending"])
        self._is_exploring = bool(state["exploring"])
        self._rng.bit_generator.state = state["rng"]
