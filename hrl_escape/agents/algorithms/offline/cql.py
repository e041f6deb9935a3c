"""Conservative Q-learning, CQL(H) over discrete actions (Kumar, Zhou, Tucker and Levine 2020), on SMDP backups."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.agents.agent import AgentSettings
from hrl_escape.agents.algorithms.offline.fitted_q import FittedQ
from hrl_escape.agents.components.offline import DecisionTable
from hrl_escape.agents.components.replay import Experience
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class CQLSettings(AgentSettings):
    """Settings of `cql`: the weight of conservatism, and the settings of every offline agent."""

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
    alpha: Annotated[float, Range(0)] = 1.0
    """Weight of log sum exp Q - Q(s, o). More keeps the policy closer to the data. Q is in units of return in a table,
    and scaled by `reward_scale` in a network."""


class CQL(FittedQ):
    """Minimise the temporal-difference loss + alpha [log sum over legal o' of exp Q(s, o') - Q(s, o)].

    In a table the minimum is Q = B Q - alpha (pi / beta - 1) with pi the softmax of Q and beta the data's frequencies
    (their equation 2): choices likelier under pi than in the data get lower values than in the data.
    """

    settings: CQLSettings

    def improve(self, table: DecisionTable, q: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Make a sweep of backups with the penalty, with a step size that does not overshoot."""
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
        """Return the mean of alpha [log sum over legal actions of exp Q - Q of the data's choice]."""
        legal = values.masked_fill(~batch.mask, -1e9)
        return self.settings.alpha * (legal.logsumexp(dim=1) - chosen).mean()
