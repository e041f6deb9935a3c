"""SHARSA: proposals of a cloned policy, chosen by the value of the behaviour (Park et al. 2025, "Horizon reduction").

Its high level proposes by a clone and keeps the proposal of largest SARSA value, so that nothing outside the data is
ever valued. Published over continuous subgoals, each some fixed number of steps away; here what is proposed is an
option, whose own duration is the horizon, and the options themselves are the low level.
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
    """Number of proposals; the expectile and the temperature are those of the behaviour and its clone."""

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
