"""Discrete soft actor-critic from TorchRL: `ProbabilisticActor`, `ReplayBuffer`, `DiscreteSACLoss`, `SoftUpdate`.

Soft actor-critic (Haarnoja et al. 2018) for discrete actions (Christodoulou 2019): the policy is stochastic, and a
learned temperature weighs its entropy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from tensordict.nn import TensorDictModule
from torchrl.objectives import DiscreteSACLoss, SoftUpdate, ValueEstimators

from hrl_escape.agents.agent import AgentSettings
from hrl_escape.agents.components.torchrl_agent import TorchRLReplayAgent
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class TorchRLSACSettings(AgentSettings):
    """Settings of `torchrl-sac`: temperature, targets and replay."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k. Higher values look further ahead."""
    hidden: tuple[Annotated[int, Range(1)], ...] = (64, 64)
    """Units of each hidden layer."""
    learning_rate: Annotated[float, Range(0, open_low=True)] = 1e-3
    """Step size of Adam. Too large a step diverges."""
    max_grad_norm: Annotated[float, Range(0, open_low=True)] = 10.0
    """Largest Euclidean norm of a gradient; larger ones are scaled down."""
    batch_size: Annotated[int, Range(1)] = 64
    """Decisions in an update."""
    scale_observations: bool = True
    """Map components with finite bounds to [-1, 1]."""
    reward_scale: Annotated[float, Range(0, open_low=True)] = 0.1
    """Factor on the rewards that networks learn. Smaller values suit larger returns. Logged values keep units of
    return."""
    replay_capacity: Annotated[int, Range(1)] = 50_000
    """Decisions kept for replay."""
    warmup: Annotated[int, Range(0)] = 500
    """Primitives before the first update."""
    updates_per_step: Annotated[float, Range(0)] = 0.25
    """Updates for each primitive. More learn more from the same experience and take longer."""
    alpha: Annotated[float, Range(0, open_low=True)] = 0.1
    """Initial temperature, in scaled rewards per nat. More explores more."""
    entropy_share: Annotated[float, Range(0, 1)] = 0.2
    """Target entropy for the temperature, as a fraction of the uniform policy's over all actions. More explores
    more."""
    target_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.02
    """Share of the critics blended into their targets at each update. Smaller rates are slower and more stable."""


class TorchRLSAC(TorchRLReplayAgent):
    """Maximise E[Q(s, o) + alpha H(pi(. | s))], with the smaller value of two critics.

    The critics' target is R + gamma^k (1 - terminated) sum over legal o' of pi(o' | s') (min Q'(s', o') - alpha log
    pi(o' | s')).
    """

    settings: TorchRLSACSettings

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: TorchRLSACSettings | None = None) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        settings = self.settings
        with self._own_chance():
            actor = self._make_policy()
            critic = TensorDictModule(self._make_mlp(self._actions), ["observation"], ["action_value"])
            target: Any = settings.entropy_share * float(np.log(self._actions))
            loss = DiscreteSACLoss(actor, critic, action_space="categorical", num_actions=self._actions,
                                   alpha_init=settings.alpha, target_entropy=target)
        loss.make_value_estimator(ValueEstimators.TD0, gamma=settings.gamma)
        self._begin(actor, loss)
        self._target = SoftUpdate(loss, tau=settings.target_rate)

    def compute_preferences(self, observation: Any) -> NDArray:
        """Return the logits of the policy at an observation, before any mask, float32 (actions,)."""
        return self._compute(observation)
