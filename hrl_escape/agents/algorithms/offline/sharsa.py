"""SHARSA: proposals of a cloned policy, chosen by the value of the behaviour (Park et al. 2025, "Horizon reduction").

Its high level proposes with a clone and keeps the proposal with the largest SARSA value, and choices outside the data
are therefore never valued. Published proposals are continuous subgoals, a fixed number of steps away. Here a proposal
is an option, whose duration is the horizon, and the options themselves are the low level.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings
from hrl_escape.agents.algorithms.offline.iql import IQL
from hrl_escape.agents.components.exploration import sample_index
from hrl_escape.agents.components.offline import DecisionTable
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class SharsaSettings(AgentSettings):
    """Settings of `sharsa`: proposals, expectile and temperature of behaviour and clone, and offline settings."""

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
    expectile: Annotated[float, Range(0.5, 1, open_high=True)] = 0.5
    """Expectile of values: 0.5 values the behaviour in the data, like SARSA."""
    inverse_temperature: Annotated[float, Range(0)] = 0.0
    """Factor on advantages in the weights of the clone; 0 clones the data as it is."""
    proposals: Annotated[int, Range(1)] = 16
    """Number of options drawn from the clone; the one of highest value runs. More drift further from the data."""


class Sharsa(IQL):
    """o = argmax over `proposals` draws o_j ~ clone(s) of Q(s, o_j), with Q the SARSA value of the behaviour."""

    Settings: ClassVar[type] = SharsaSettings
    settings: Any
    is_markov = False

    def improve(self, table: DecisionTable, q: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Make expectile backups; scores are the logarithms of counts, -inf for actions outside the data."""
        found, scores = super().improve(table, q)
        return found, np.where(table.shown, scores, -1e9)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Return the best of several draws from the clone."""
        logits = np.where(action_mask, self.compute_preferences(observation).astype(np.float64), -np.inf)
        policy = np.exp(logits - logits.max())
        policy /= policy.sum()
        drawn = {sample_index(policy, rng) for _ in range(self.settings.proposals)}
        values = self.compute_values(observation)
        return min(drawn) if values is None else max(sorted(drawn), key=lambda action: values[action])
