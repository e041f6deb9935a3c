"""Conservative Q-learning, CQL(H) over discrete actions (Kumar, Zhou, Tucker and Levine 2020), on SMDP backups."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.agents.algorithms.offline.fitted_q import FittedQ
from hrl_escape.agents.components.offline import DecisionTable, OfflineSettings
from hrl_escape.agents.components.replay import Experience
from hrl_escape.settings import Range


@dataclass(frozen=True)
class CQLSettings(OfflineSettings):
    """The weight of conservatism, beside the settings of every offline agent."""

    alpha: Annotated[float, Range(0)] = 1.0
    """Weight of log sum exp Q - Q(s, o), with Q in units of return in a table and scaled by `reward_scale` in a
    network."""


class CQL(FittedQ):
    """Minimise the temporal-difference loss + alpha [log sum over legal o' of exp Q(s, o') - Q(s, o)].

    In a table the minimum is Q = B Q - alpha (pi / beta - 1) with pi the softmax of Q and beta the data's shares (their
    equation 2): choices likelier under pi than in the data are valued below what the data says.
    """

    settings: CQLSettings

    def improve(self, table: DecisionTable, q: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """A sweep of backups with the penalty, by a step that does not overshoot."""
        shown, alpha = table.shown, self.settings.alpha
        known = np.where(shown, q, -np.inf)
        best = known.max(axis=1, keepdims=True)
        weights = np.where(shown, np.exp(np.where(shown, q, 0.0) - np.where(np.isfinite(best), best, 0.0)), 0.0)
        policy = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-300)
        beta = table.counts / np.maximum(table.counts.sum(axis=1, keepdims=True), 1.0)
        shares = np.where(shown, beta, 1.0)
        target = table.back_up(best[:, 0]) - np.where(shown, alpha * (policy / shares - 1.0), 0.0)
        found = q + (target - q) / (1.0 + alpha * policy * (1.0 - policy) / shares)
        return found, np.where(shown, found, min(table.worst, found.min()) - 1.0)

    def penalise(self, values: Tensor, chosen: Tensor, batch: Experience) -> Tensor:
        """Mean of alpha [log sum over legal actions of exp Q - Q of the data's]."""
        legal = values.masked_fill(~batch.mask, -1e9)
        return self.settings.alpha * (legal.logsumexp(dim=1) - chosen).mean()
