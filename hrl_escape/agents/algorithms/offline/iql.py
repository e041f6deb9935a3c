"""Implicit Q-learning: expectiles in place of a maximum (Kostrikov, Nair and Levine 2022), on SMDP backups."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.agents.components.networks import compute_td_loss
from hrl_escape.agents.components.offline import DecisionTable, OfflineAgent, OfflineSettings
from hrl_escape.agents.components.replay import Experience
from hrl_escape.settings import Range

MOST_WEIGHT = 100.0
"""Largest weight of a decision in the policy's loss, as in the published program."""


@dataclass(frozen=True)
class IQLSettings(OfflineSettings):
    """Expectile and temperature, beside the settings of every offline agent."""

    expectile: Annotated[float, Range(0.5, 1, open_high=True)] = 0.9
    """tau: 0.5 values the behaviour of the data, as SARSA does; towards 1 the best that the data shows."""
    inverse_temperature: Annotated[float, Range(0)] = 0.3
    """Advantages times this, in units of return, weigh the data's choices in the policy; 0 clones them."""


def compute_expectile(values: NDArray[np.float64], weights: NDArray[np.float64], tau: float) -> NDArray[np.float64]:
    """Expectile of each row: the m with tau sum w (q - m)+ = (1 - tau) sum w (m - q)+, float64 (rows,).

    Values q and weights w, 0 or more, are (rows, n), tau is in (0, 1); a row without weight gives 0. It is exact: the
    balance is linear between two neighbouring values.
    """
    order = np.argsort(values, axis=1)
    q, w = np.take_along_axis(values, order, 1), np.take_along_axis(weights, order, 1)
    below, above = np.cumsum(w, axis=1), w.sum(axis=1, keepdims=True) - np.cumsum(w, axis=1)
    sums = np.cumsum(w * q, axis=1)
    rest = (w * q).sum(axis=1, keepdims=True) - sums
    share = (1.0 - tau) * below + tau * above
    found = ((1.0 - tau) * sums + tau * rest) / np.where(share > 0, share, 1.0)
    following = np.concatenate([q[:, 1:], np.full((len(q), 1), np.inf)], axis=1)
    right = (found <= following) & (share > 0)  # the first stretch on which the balance is at or before its end
    first = right.argmax(axis=1)
    return np.where(w.any(axis=1), found[np.arange(len(q)), first], 0.0)


def expectile_loss(error: Tensor, tau: float) -> Tensor:
    """Mean of |tau - 1(error < 0)| error^2."""
    return (torch.where(error < 0, 1.0 - tau, tau) * error**2).mean()


class IQL(OfflineAgent):
    """V is the expectile of Q over the data's choices, Q = mean of R + gamma^k (1 - terminated) V(s').

    The policy clones the data's choices weighted by exp(inverse temperature x (Q - V)).
    """

    heads = {"q": "action", "target_q": "action", "policy": "action", "value": "state"}
    acting: ClassVar[str] = "policy"
    settings: IQLSettings

    def improve(self, table: DecisionTable, q: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """A sweep: expectiles, then backups; the scores are the logarithms of the weighted counts."""
        values = compute_expectile(q, table.counts, self.settings.expectile)
        found = table.back_up(values)
        advantage = self.settings.inverse_temperature * (found - compute_expectile(
            found, table.counts, self.settings.expectile)[:, None])
        scores = np.log(np.maximum(table.counts, 1e-300)) + np.where(table.shown, advantage, 0.0)
        return found, np.where(table.shown, scores, scores[table.shown].min() - 1.0)

    def compute_loss(self, batch: Experience, rows: NDArray[np.int64]) -> tuple[Tensor, dict[str, float]]:
        """Sum of the three losses; none sends its gradient into another's network."""
        settings = self.settings
        values = self.networks["value"](batch.observation).squeeze(1)
        with torch.no_grad():
            q = self.networks["target_q"](batch.observation).gather(1, batch.action[:, None]).squeeze(1)
            targets = batch.reward + batch.bootstrap * self.networks["value"](batch.next_observation).squeeze(1)
            advantage = (q - values) * settings.inverse_temperature / settings.reward_scale
            weights = advantage.exp().clamp(max=MOST_WEIGHT)
        chosen = self.networks["q"](batch.observation).gather(1, batch.action[:, None]).squeeze(1)
        logits = self.networks["policy"](batch.observation).masked_fill(~batch.mask, -1e9)
        likelihood = logits.log_softmax(dim=1).gather(1, batch.action[:, None]).squeeze(1)
        loss = (expectile_loss(q - values, settings.expectile) + compute_td_loss(chosen, targets, settings.loss)
                - (weights * likelihood).mean())
        return loss, {"value": values.mean().item() / settings.reward_scale}
