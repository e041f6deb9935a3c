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
    """The weight of conservatism, beside the settings of every offline agent."""

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
