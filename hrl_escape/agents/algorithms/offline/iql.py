"""Implicit Q-learning: expectiles instead of a maximum (Kostrikov, Nair and Levine 2022), on SMDP backups."""

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
"""Largest weight of a decision in the policy's loss, as in the published code."""


@dataclass(frozen=True, kw_only=True)
class IQLSettings(AgentSettings):
    """Settings of `iql`: expectile and temperature, and the settings of every offline agent."""

    bins: Annotated[int, Range(2)] = 11
    """Number of evenly spaced points, both bounds included, to round bounded components to: 11 over a 20 m room is 2 m.
    More points make more, finer states. Binary components are unchanged."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """Unit to round unbounded components to multiples of. Smaller values make more, finer states."""
    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive, or per decision if `discounting` is `decision`. Higher values look further ahead and
    learn more slowly."""
    discounting: Literal["primitive", "decision"] = "primitive"
    """`primitive` discounts k primitives by gamma^k. `decision` sums their rewards and discounts by gamma, as the
    paper's agents did."""
    bootstrap_on_truncation: bool = True
    """Bootstrap from the last state of a truncated episode. False treats a truncation as a termination, as in the
    paper's agents."""
    clock: Literal["primitive", "decision"] = "primitive"
    """Unit of warm-up, updates and epsilon. With primitives an agent over options updates as often as a flat one."""
    hidden: tuple[Annotated[int, Range(1)], ...] = (64, 64)
    """Units of each hidden layer."""
    initialisation: Literal["torch", "glorot", "orthogonal"] = "torch"
    """Initial weights: U(+-1/sqrt(fan in)); Xavier uniform with zero bias, as in Keras; or orthogonal with zero bias,
    usual for PPO."""
    learning_rate: Annotated[float, Range(0, open_low=True)] = 3e-4
    """Step size of Adam. Too large a step diverges."""
    max_grad_norm: Annotated[float, Range(0)] = 10.0
    """Largest Euclidean norm of a gradient; larger ones are scaled down. 0 sets no limit."""
    adam_epsilon: Annotated[float, Range(0, open_low=True)] = 1e-8
    """Term in Adam's denominator; 1e-7 in Keras."""
    scale_observations: bool = True
    """Map components with finite bounds to [-1, 1]."""
    reward_scale: Annotated[float, Range(0, open_low=True)] = 0.1
    """Factor on the rewards that networks learn. Smaller values suit larger returns. Temperatures and logged values
    keep units of return."""
    epsilon_start: Annotated[float, Range(0, 1)] = 1.0
    """Epsilon at the beginning; 1 acts at random."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon from `epsilon_steps` on. More explores for longer and lowers the return of training episodes."""
    epsilon_steps: Annotated[int, Range(1)] = 5_000
    """Number of clock steps of the linear decrease of epsilon. More explores for longer."""
    loss: Literal["huber", "squared"] = "huber"
    """Huber loss with threshold 1 in scaled rewards, or half the squared error, which follows outliers."""
    batch_size: Annotated[int, Range(1)] = 256
    """Decisions in an update."""
    warmup: Annotated[int, Range(0)] = 500
    """Steps of the clock before the first update."""
    updates_per_step: Annotated[float, Range(0)] = 0.25
    """Updates for each step of the clock. More learn more from the same experience and take longer."""
    max_updates: Annotated[int, Range(1)] = 16
    """Most updates after a step of many environments. Where more are due, minibatches grow instead. Few large ones
    learn less, because the target network follows updates."""
    replay_per_env: Annotated[int, Range(1)] = 128
    """Smallest replay capacity per environment with many environments, in decisions."""
    passes: Annotated[int, Range(1)] = 50
    """Passes over the data, if `train` has no budget."""
    values: Literal["auto", "table", "network"] = "auto"
    """`table`: exact backups over the states of the data. `auto`: a table if each state occurs at least ten times on
    average and the observation has no rows of objects, which let networks generalise to other rooms."""
    network: Literal["mlp", "objects"] = "objects"
    """`objects`: deep sets over the observation's rows of objects. `mlp`: a perceptron over the whole observation."""
    target_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.01
    """Share of a network blended into its target at each update. Smaller rates are slower and more stable."""
    expectile: Annotated[float, Range(0.5, 1, open_high=True)] = 0.9
    """tau: 0.5 values the behaviour in the data, like SARSA; values towards 1 the best choices in the data."""
    inverse_temperature: Annotated[float, Range(0)] = 0.3
    """Factor on advantages, in units of return, in the weights of the data's choices. More weighs good choices more; 0
    clones the data."""


def compute_expectile(values: NDArray[np.float64], weights: NDArray[np.float64], tau: float) -> NDArray[np.float64]:
    """Return the expectile of each row: the m with tau sum w (q - m)+ = (1 - tau) sum w (m - q)+, float64 (rows,).

    Values q and weights w >= 0 are (rows, n), tau is in (0, 1); a row without weight gives 0. The result is exact,
    because the balance is linear between two neighbouring values.
    """
    order = np.argsort(values, axis=1)
    q, w = np.take_along_axis(values, order, 1), np.take_along_axis(weights, order, 1)
    below, above = np.cumsum(w, axis=1), w.sum(axis=1, keepdims=True) - np.cumsum(w, axis=1)
    sums = np.cumsum(w * q, axis=1)
    rest = (w * q).sum(axis=1, keepdims=True) - sums
    share = (1.0 - tau) * below + tau * above
    found = ((1.0 - tau) * sums + tau * rest) / np.where(share > 0, share, 1.0)
    following = np.concatenate([q[:, 1:], np.full((len(q), 1), np.inf)], axis=1)
    right = (found <= following) & (share > 0)  # the first interval where the balance is at or before its end
    first = right.argmax(axis=1)
    return np.where(w.any(axis=1), found[np.arange(len(q)), first], 0.0)


def expectile_loss(error: Tensor, tau: float) -> Tensor:
    """Return the mean of |tau - 1(error < 0)| error^2."""
    return (torch.where(error < 0, 1.0 - tau, tau) * error**2).mean()


class IQL(OfflineAgent):
    """V is the expectile of Q over the data's choices, Q = mean of R + gamma^k (1 - terminated) V(s').

    The policy clones the data's choices weighted by exp(inverse temperature x (Q - V)).
    """

    heads = {"q": "action", "target_q": "action", "policy": "action", "value": "state"}
    acting: ClassVar[str] = "policy"
    settings: IQLSettings

    def improve(self, table: DecisionTable, q: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Make a sweep: expectiles, then backups; scores are the logarithms of the weighted counts."""
        values = compute_expectile(q, table.counts, self.settings.expectile)
        found = table.back_up(values)
        advantage = self.settings.inverse_temperature * (found - compute_expectile(
            found, table.counts, self.settings.expectile)[:, None])
        scores = np.log(np.maximum(table.counts, 1e-300)) + np.where(table.shown, advantage, 0.0)
        return found, np.where(table.shown, scores, scores[table.shown].min() - 1.0)

    def compute_loss(self, batch: Experience, rows: NDArray[np.int64]) -> tuple[Tensor, dict[str, float]]:
        """Return the sum of the three losses; none has a gradient into another's network."""
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
