"""SHARSA: proposals of a cloned policy, chosen by the value of the behaviour (Park et al. 2025, "Horizon reduction").

Its high level proposes by a clone and keeps the proposal of largest SARSA value, so that nothing outside the data is
ever valued. Published over continuous subgoals, each some fixed number of steps away; here what is proposed is an
option, whose own duration is the horizon, and the options themselves are the low level.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.algorithms.offline.iql import IQL, IQLSettings
from hrl_escape.agents.components.exploration import sample_index
from hrl_escape.agents.components.offline import DecisionTable
from hrl_escape.settings import Range


@dataclass(frozen=True)
class SharsaSettings(IQLSettings):
    """Number of proposals; the expectile and the temperature are those of the behaviour and its clone."""

    expectile: Annotated[float, Range(0.5, 1, open_high=True)] = 0.5
    """0.5 values the behaviour, as SARSA does."""
    inverse_temperature: Annotated[float, Range(0)] = 0.0
    """0 proposes as the data chose."""
    proposals: Annotated[int, Range(1)] = 16
    """Options drawn from the clone, of which the one of highest value runs."""


class Sharsa(IQL):
    """o = argmax over `proposals` draws o_j ~ clone(s) of Q(s, o_j), with Q the SARSA value of the behaviour."""

    Settings: ClassVar[type] = SharsaSettings
    settings: Any
    is_markov = False

    def improve(self, table: DecisionTable, q: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Expectile backups; the scores are the logarithms of counts, and nothing for what the data never shows."""
        found, scores = super().improve(table, q)
        return found, np.where(table.shown, scores, -1e9)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The best of some draws from the clone."""
        logits = np.where(action_mask, self.compute_preferences(observation).astype(np.float64), -np.inf)
        policy = np.exp(logits - logits.max())
        policy /= policy.sum()
        drawn = {sample_index(policy, rng) for _ in range(self.settings.proposals)}
        values = self.compute_values(observation)
        return min(drawn) if values is None else max(sorted(drawn), key=lambda action: values[action])
