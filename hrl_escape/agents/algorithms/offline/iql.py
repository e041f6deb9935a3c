"""Implicit Q-learning: expectiles in place of a maximum (Kostrikov, Nair and Levine 2022), on SMDP backups."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.agents.agent import AgentSettings
from hrl_escape.agents.components.networks import compute_td_loss
from hrl_escape.agents.components.offline import DecisionTable, OfflineAgent
from hrl_escape.agents.components.replay import Experience
from hrl_escape.settings import Range

MOST_WEIGHT = 100.0
"""Largest weight of a decision in the policy's loss, as in the published program."""


@dataclass(frozen=True, kw_only=True)
class IQLSettings(AgentSettings):
    """Expectile and temperature, beside the settings of every offline agent."""

    bins: Annotated[int, Range(2)] = 11
    """A component with bounds low, high is rounded to the nearest of this many evenly spaced points, both ends
    included: 11 over a 20 m room is 2 m; a bit stays a bit."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """A component without bounds is rounded to multiples of this, in its own unit."""
    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive; per decision if `discounting` is `decision`."""
    discounting: Literal["primitive", "decision"] = "primitive"
    """`primitive`: an action of k primitives is worth sum gamma^i r_i and discounts by gamma^k. `decision`: it is
    worth the plain sum and discounts by gamma, as if it were one step, as the paper's agents did."""
    bootstrap_on_truncation: bool = True
    """Bootstrap from the state in which an episode was truncated; otherwise truncation counts as termination, as in
    the paper's agents."""
    clock: Literal["primitive", "decision"] = "primitive"
    """Unit in which warm-up, update and exploration schedules count. With primitives, flat and option-level agents do
    the same work on the same experience."""
    hidden: tuple[Annotated[int, Range(1)], ...] = (64, 64)
    """Units of each hidden layer."""
    initialisation: Literal["torch", "glorot", "orthogonal"] = "torch"
    """Initial weights: `torch` U(+-1/sqrt(fan in)); `glorot` Xavier uniform with zero bias, as Keras; `orthogonal`
    with zero bias, usual for PPO."""
    learning_rate: Annotated[float, Range(0, open_low=True)] = 3e-4
    """Step size of Adam."""
    max_grad_norm: Annotated[float, Range(0)] = 10.0
    """Gradients are scaled down to this Euclidean norm; 0 leaves them."""
    adam_epsilon: Annotated[float, Range(0, open_low=True)] = 1e-8
    """Term in Adam's denominator; Keras has 1e-7."""
    scale_observations: bool = True
    """Map components with finite bounds in the observation space to [-1, 1]."""
    reward_scale: Annotated[float, Range(0, open_low=True)] = 0.1
    """Networks learn rewards times this; temperatures and logged values stay in units of return."""
    epsilon_start: Annotated[float, Range(0, 1)] = 1.0
    """Epsilon at the beginning."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon from `epsilon_steps` on."""
    epsilon_steps: Annotated[int, Range(1)] = 5_000
    """Steps of the clock over which epsilon falls linearly."""
    loss: Literal["huber", "squared"] = "huber"
    """Loss of action values: Huber with threshold 1 (in scaled rewards), or half the squared error."""
    batch_size: Annotated[int, Range(1)] = 256
    """Decisions in an update."""
    warmup: Annotated[int, Range(0)] = 500
    """Steps of the clock before the first update."""
    updates_per_step: Annotated[float, Range(0)] = 0.25
    """Updates from replay for each step of the clock; an option of 16 primitives is followed by 16 times as many."""
    stream_updates: Annotated[int, Range(1)] = 16
    """Most updates after a step of many streams. Where more are due, minibatches grow, so that every decision is
    learned from as often; much fewer and larger ones learn less, as the target network follows updates."""
    stream_replay: Annotated[int, Range(1)] = 128
    """Decisions of each stream, on average, for which replay has room at least."""
    passes: Annotated[int, Range(1)] = 50
    """Passes over the data, where `train` is given no budget."""
    values: Literal["auto", "table", "network"] = "auto"
    """`table`: exact backups over the states that the data shows. `auto`: a table where the data shows each state ten
    times or more, on average, and the observation has no rows of objects, which networks carry to other rooms."""
    network: Literal["mlp", "objects"] = "objects"
    """`objects`: deep sets over rows of objects; `mlp`: a perceptron, also where the observation has no rows."""
    target_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.01
    """Share of a network blended into its target at each update."""
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
