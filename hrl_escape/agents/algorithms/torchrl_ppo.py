"""Proximal policy optimisation from TorchRL's parts: `ProbabilisticActor`, `GAE` and `ClipPPOLoss`.

The algorithm is `ppo` without memory and bonus; see `components/torchrl_agent.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict
from torchrl.modules import ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from hrl_escape.agents.agent import AgentSettings, SMDPTransition
from hrl_escape.agents.components.torchrl_agent import TorchRLAgent
from hrl_escape.agents.state import Kept
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class TorchRLPPOSettings(AgentSettings):
    """Settings of `torchrl-ppo`: rollouts and losses."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k. Higher values look further ahead."""
    hidden: tuple[Annotated[int, Range(1)], ...] = (64, 64)
    """Units of each hidden layer."""
    learning_rate: Annotated[float, Range(0, open_low=True)] = 3e-4
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
    rollout: Annotated[int, Range(2)] = 256
    """Decisions between updates. More make steadier updates, and fewer of them."""
    epochs: Annotated[int, Range(1)] = 10
    """Passes over a rollout. More learn more from it and move further from the policy that collected it."""
    gae_lambda: Annotated[float, Range(0, 1)] = 0.95
    """Lambda of generalised advantages, per decision. 1 has the most variance, and no bias from the critic."""
    clip: Annotated[float, Range(0, open_low=True)] = 0.2
    """Distance from 1 that clips the probability ratio. Smaller is slower and steadier."""
    entropy_weight: Annotated[float, Range(0)] = 0.01
    """Weight of the policy's entropy in the loss. More explores for longer."""
    value_weight: Annotated[float, Range(0)] = 0.5
    """Weight of the critic's squared error in the loss."""


class TorchRLPPO(TorchRLAgent):
    """Maximise the mean of min(ratio A, clip(ratio, 1 - eps, 1 + eps) A) + entropy; see `ppo`.

    A are generalised advantages; a decision of k primitives discounts by gamma^k lambda.
    """

    settings: TorchRLPPOSettings
    STATE = (Kept("_rollout", "rollout", unpack=dict),)

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: TorchRLPPOSettings | None = None) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        settings = self.settings
        with self._own_chance():
            actor = self._make_policy()
            self._critic = ValueOperator(self._make_mlp(1), in_keys=["observation"])
        self._begin(actor, ClipPPOLoss(
            actor, self._critic, clip_epsilon=settings.clip, entropy_coeff=settings.entropy_weight,
            critic_coeff=settings.value_weight, normalize_advantage=True, loss_critic_type="l2"))
        self.estimator = GAE(gamma=settings.gamma, lmbda=settings.gae_lambda, value_network=self._critic)
        self._rows: list[TensorDict] = []

    def compute_preferences(self, observation: Any) -> NDArray:
        """Return the logits of the policy at an observation, before any mask, float32 (actions,)."""
        return self._compute(observation)

    def compute_state_value(self, observation: Any) -> float:
        """Return V(s) at an observation, in units of return."""
        with torch.no_grad():
            seen = self._critic(self._see(observation, np.ones(self._actions, np.bool_)))
        return float(seen["state_value"]) / self.settings.reward_scale

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Store the decision; update when the rollout is full."""
        self._rows.append(self._make_decision(transition))
        return self._learn() if len(self._rows) >= self.settings.rollout else {}

    def _stack(self) -> Any:
        rows: Any = self._rows  # torch's annotations lack TensorDict
        return torch.stack(rows)

    def _learn(self) -> dict[str, float]:
        """Make the updates from the rollout and clear it; return means over the updates."""
        rollout = self._stack()
        self._rows = []
        with torch.no_grad():
            policy = self._actor.get_dist(rollout)
            rollout["action_log_prob"] = policy.log_prob(rollout["action"])  # the policy has not changed since
            self.estimator(rollout)
        told: list[dict[str, float]] = []
        for _ in range(self.settings.epochs):
            order = torch.randperm(len(rollout), generator=self._chance)
            told += [self._descend(rollout[rows]) for rows in order.split(self.settings.batch_size) if len(rows) > 1]
        return {name: float(np.mean([each[name] for each in told])) for name in told[0]}

    @property
    def _rollout(self) -> dict[str, Any] | None:
        """Decisions of the rollout so far by key, or None if it is empty."""
        return {key: value.numpy() for key, value in sorted(self._stack().flatten_keys(" ").items())
                } if self._rows else None

    @_rollout.setter
    def _rollout(self, saved: Mapping[str, Any] | None) -> None:
        self._rows = []
        if saved is not None:
            kept = {key: torch.from_numpy(np.array(value)) for key, value in saved.items()}
            self._rows = list(TensorDict(kept, [len(kept["action"])]).unflatten_keys(" ").unbind(0))
