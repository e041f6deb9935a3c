"""Fitted Q-iteration over decisions of any duration (Ernst, Geurts and Wehenkel 2005) on SMDP backups.

In a table it is value iteration on the data's empirical MDP, over the actions in the data; from data with every state
and action it finds the optimal values. Networks take the maximum over all legal actions, and values of actions outside
the data can grow too large (Fujimoto, Meger and Precup 2019). `cql` and `iql` avoid that.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.agents.components.networks import compute_td_loss
from hrl_escape.agents.components.offline import DecisionTable, OfflineAgent, OfflineSettings
from hrl_escape.agents.components.replay import Experience


class FittedQ(OfflineAgent):
    """Q(s, o) <- mean of R + gamma^k (1 - terminated) max over o' of Q(s', o').

    Networks use double Q-learning: the online network chooses o', the target network values it.
    """

    Settings: ClassVar[type] = OfflineSettings
    heads = {"q": "action", "target_q": "action"}

    def improve(self, table: DecisionTable, q: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Make a sweep of exact backups; actions outside the data score below all others."""
        found = table.back_up(np.where(table.shown, q, -np.inf).max(axis=1))
        return found, np.where(table.shown, found, min(table.worst, found.min()) - 1.0)

    def compute_loss(self, batch: Experience, rows: NDArray[np.int64]) -> tuple[Tensor, dict[str, float]]:
        """Return the temporal-difference loss, plus the result of `penalise`."""
        values = self.networks["q"](batch.observation)
        with torch.no_grad():
            best = self.networks["q"](batch.next_observation).masked_fill(~batch.next_mask, -torch.inf).argmax(1, True)
            targets = batch.reward + batch.bootstrap * self.networks["target_q"](batch.next_observation).gather(
                1, best).squeeze(1)
        chosen = values.gather(1, batch.action[:, None]).squeeze(1)
        loss = compute_td_loss(chosen, targets, self.settings.loss) + self.penalise(values, chosen, batch)
        return loss, {"value": chosen.mean().item() / self.settings.reward_scale}

    def penalise(self, values: Tensor, chosen: Tensor, batch: Experience) -> Tensor | float:
        """Return an addition to the loss; 0 here."""
        del values, chosen, batch
        return 0.0
