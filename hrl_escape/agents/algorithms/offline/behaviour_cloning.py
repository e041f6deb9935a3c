"""Behaviour cloning: the choices of the data, of all trajectories or of the best (Pomerleau 1989).

With the prefix `smdp-` it clones decisions, without it primitives. A clone of the best tenth is the usual yardstick of
offline learning, "10 % BC" (Chen et al. 2021).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import cross_entropy

from hrl_escape.agents.agent import AgentSettings
from hrl_escape.agents.components.offline import (
    DecisionTable,
    OfflineAgent,
    Primitives,
    RecordedDecisions,
    list_best,
)
from hrl_escape.agents.components.replay import Experience
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class BehaviourCloningSettings(AgentSettings):
    """The share of trajectories that is cloned, beside the settings of every offline agent."""

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
    best: Annotated[float, Range(0, 1, open_low=True)] = 1.0
    """Share of the trajectories, the best by plain return, that is cloned."""


class BehaviourCloning(OfflineAgent):
    """pi(o | s) = share of o among the data's choices at s; the greedy policy takes the most frequent."""

    heads = {"policy": "action"}
    acting: ClassVar[str] = "policy"
    settings: BehaviourCloningSettings

    def begin(self, data: RecordedDecisions, primitives: Primitives | None = None) -> None:
        """Take the trajectories that are to be cloned."""
        kept = list_best(data, self.settings.best)
        fields: Any = [field[kept] for field in data]
        super().begin(RecordedDecisions(*fields), primitives)

    def improve(self, table: DecisionTable, q: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Counts, which no sweep changes."""
        return q, table.counts

    def compute_loss(self, batch: Experience, rows: NDArray[np.int64]) -> tuple[Tensor, dict[str, float]]:
        """Mean of -log pi(o | s) over legal actions, for the data's choices."""
        logits = self.networks["policy"](batch.observation).masked_fill(~batch.mask, -1e9)
        return cross_entropy(logits, batch.action), {}
