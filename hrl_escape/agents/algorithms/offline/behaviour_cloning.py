"""Behaviour cloning: the choices of the data, of all trajectories or of the best (Pomerleau 1989).

With the prefix `smdp-` it clones decisions, without it primitives. A clone of the best tenth is the usual yardstick of
offline learning, "10 % BC" (Chen et al. 2021).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import cross_entropy

from hrl_escape.agents.components.offline import (
    Decisions,
    DecisionTable,
    OfflineAgent,
    OfflineSettings,
    Primitives,
    list_best,
)
from hrl_escape.agents.components.replay import Experience
from hrl_escape.settings import Range


@dataclass(frozen=True)
class BehaviourCloningSettings(OfflineSettings):
    """The share of trajectories that is cloned, beside the settings of every offline agent."""

    best: Annotated[float, Range(0, 1, open_low=True)] = 1.0
    """Share of the trajectories, the best by plain return, that is cloned."""


class BehaviourCloning(OfflineAgent):
    """pi(o | s) = share of o among the data's choices at s; the greedy policy takes the most frequent."""

    heads = {"policy": "action"}
    acting: ClassVar[str] = "policy"
    settings: BehaviourCloningSettings

    def begin(self, data: Decisions, primitives: Primitives | None = None) -> None:
        """Take the trajectories that are to be cloned."""
        kept = list_best(data, self.settings.best)
        fields: Any = [field[kept] for field in data]
        super().begin(Decisions(*fields), primitives)

    def improve(self, table: DecisionTable, q: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Counts, which no sweep changes."""
        return q, table.counts

    def compute_loss(self, batch: Experience, rows: NDArray[np.int64]) -> tuple[Tensor, dict[str, float]]:
        """Mean of -log pi(o | s) over legal actions, for the data's choices."""
        logits = self.networks["policy"](batch.observation).masked_fill(~batch.mask, -1e9)
        return cross_entropy(logits, batch.action), {}
