"""Factored R-MAX with structure learning: explore outcomes that the hypotheses leave open, then exploit.

SLF-R-MAX of Strehl, Diuk and Littman (2007), for semi-Markov decisions, with the priors of `structure.py`. As in R-MAX
(Brafman and Tennenholtz 2002) unknown outcomes are worth more than known ones, here without bound: the agent goes to
the soonest reachable open outcome, and to the best known end of the task if there is none. Plans come from forward
search (`search.py`), which does not enumerate states.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings
from hrl_escape.agents.factored.planning_agent import PlanningAgent
from hrl_escape.agents.factored.search import ModelPlan
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class FactoredRMaxSettings(AgentSettings):
    """Settings of `factored-r-max`: samples per context, hypotheses and search."""

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
    visits: Annotated[int, Range(1)] = 1
    """Samples that make a context known. 1 is enough for deterministic outcomes; more are needed under noise."""


class FactoredRMax(PlanningAgent):
    """Believes all sets of parents that leave the fewest samples unexplained, and explores where two of them differ."""

    Settings: ClassVar[type] = FactoredRMaxSettings

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: AgentSettings | None = None) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        self._careful = self.model.make_belief(self.model.get_alive, self.settings.visits)
        self._bold = self.model.make_belief(self.model.get_likeliest, self.settings.visits)

    def get_graph(self) -> frozenset[tuple[int, int]]:
        """Return edges (parent, child) of the smallest remaining hypotheses; see `FactoredModel.find_graph`."""
        return self.model.find_graph(self._bold.choose)

    def _find_plan(self, observation: Any, action_mask: NDArray[np.bool_]) -> ModelPlan:
        """Way to the soonest open outcome, or to the end of the task if none is reachable."""
        plan = self._search(self._careful, observation, action_mask, seek_gaps=True)
        self._is_exploring = bool(plan.actions)
        return plan if plan.actions else self._find_escape(observation, action_mask)

    def _find_escape(self, observation: Any, action_mask: NDArray[np.bool_]) -> ModelPlan:
        """Way to the end of the task by known outcomes, otherwise by the likeliest."""
        plan = self._search(self._careful, observation, action_mask, seek_gaps=False)
        return plan if plan.actions else self._search(self._bold, observation, action_mask, seek_gaps=False)

    def compute_plan_value(self, observation: Any, action_mask: NDArray[np.bool_]) -> float:
        """Return the discounted return of the best known way to the end of the task; -inf if none is known."""
        return -np.inf if self.model.is_empty else self._find_escape(observation, action_mask).value
