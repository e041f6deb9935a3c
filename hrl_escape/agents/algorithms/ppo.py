"""Proximal policy optimisation over decisions of any duration, with masked actions.

Schulman et al. (2017), advantages by Schulman et al. (2016), masks by Huang and Ontanon (2022). In the
advantage each decision discounts by its own gamma^k; lambda falls per decision or per primitive, as set.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from hrl_escape.agents.agent import Agent, SMDPTransition, StateTree, compute_backup
from hrl_escape.agents.components.distillation import DeepBonusSettings, make_bonus
from hrl_escape.agents.components.exploration import choose_best, make_rng, sample_index
from hrl_escape.agents.components.networks import (
    Learner,
    NetworkSettings,
    ObservationEncoder,
    make_forward,
    make_generator,
)
from hrl_escape.agents.components.object_network import (
    ObjectNetworkSettings,
    make_action_network,
    make_state_network,
)
from hrl_escape.agents.settings import LearningSettings
from hrl_escape.settings import Range

__all__ = ["PPO", "PPOSettings", "Rollout", "compute_advantages"]


@dataclass(frozen=True)
class PPOSettings(DeepBonusSettings, ObjectNetworkSettings, NetworkSettings, LearningSettings):
    """Settings of `ppo`."""

    initialisation: Literal["torch", "glorot", "orthogonal"] = "orthogonal"
    """Initial weights; `orthogonal` goes with tanh units and a small last layer of the policy."""
    learning_rate: Annotated[float, Range(0, open_low=True)] = 1e-3
    """Step size of Adam."""
    max_grad_norm: Annotated[float, Range(0)] = 0.5
    """Gradients are scaled down to this Euclidean norm; 0 leaves them."""
    rollout: Annotated[int, Range(2)] = 256
    """Decisions collected before each round of updates."""
    epochs: Annotated[int, Range(1)] = 10
    """Passes over a rollout."""
    batch_size: Annotated[int, Range(1)] = 64
    """Decisions in a minibatch."""
    gae_lambda: Annotated[float, Range(0, 1)] = 0.95
    """Lambda of generalised advantage estimation."""
    lambda_per: Literal["decision", "primitive"] = "decision"
    """Unit of lambda: a decision of k primitives weighs later errors by lambda, or by lambda^k."""
    clip: Annotated[float, Range(0, open_low=True)] = 0.2
    """Bound on how far the probability ratio may move to any advantage."""
    entropy_weight: Annotated[float, Range(0)] = 0.01
    """Weight of the policy's entropy in the loss."""
    value_weight: Annotated[float, Range(0)] = 0.5
    """Weight of half the squared value error in the loss."""


class Rollout(NamedTuple):
    """Decisions in order; numpy arrays with leading dimension n.

    Attributes:
        observation: (n, *observation shape), encoded.
        mask: bool (n, actions).
        action: int64 (n,).
        reward: float32 (n,), R, scaled.
        bootstrap: float32 (n,), b.
        duration: int64 (n,), k.
        over: bool (n,), the episode ended here, by termination or truncation.
        next_observation: (n, *observation shape), the state reached, also at an episode's end.
    """

    observation: Any
    mask: Any
    action: Any
    reward: Any
    bootstrap: Any
    duration: Any
    over: Any
    next_observation: Any


class PPO(Agent):
    """Maximise the mean of min(ratio A, clip(ratio, 1 - eps, 1 + eps) A) + entropy, minimise (V - target)^2.

    ratio = pi(o | s) / pi_old(o | s) over legal actions. A is `compute_advantages`, normalised in each minibatch, and
    the value's target is A + V_old. There is no epsilon schedule: the policy itself is random.
    """

    name: ClassVar[str] = "ppo"
    Settings: ClassVar[type] = PPOSettings
    settings: PPOSettings
    is_markov: ClassVar[bool] = True

    def __init__(
        self,
        observation_space: gymnasium.Space,
        action_space: gymnasium.Space,
        seed: int,
        settings: PPOSettings | None = None,
    ) -> None:
        self.settings = settings = settings or PPOSettings()
        self._encoder = ObservationEncoder(observation_space, settings.scale_observations)
        generator = make_generator(make_rng(seed, "weights"))
        self.policy = make_action_network(self._encoder, action_space, settings, generator, output_gain=0.01)
        self.critic = make_state_network(self._encoder, settings, generator)
        self._forward, self._forward_critic = make_forward(self.policy), make_forward(self.critic)
        networks = {"policy": self.policy, "critic": self.critic}
        self._learner = Learner(self.name, networks, networks, settings)
        self._action_rng, self._batch_rng = make_rng(seed, "actions"), make_rng(seed, "batches")
        self._bonus = make_bonus(observation_space, seed, settings, settings, self.name)
        self._rows: list[Rollout] = []

    def compute_preferences(self, observation: Any) -> NDArray:
        """Logits of the policy at an observation, before any mask, float32 (actions,)."""
        return self._forward(self._encoder.encode(observation))

    def compute_state_value(self, observation: Any) -> float:
        """V(s) at an observation, in units of return."""
        return float(self._forward_critic(self._encoder.encode(observation))[0]) / self.settings.reward_scale

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Draw from the policy over legal actions."""
        logits = np.where(action_mask, self.compute_preferences(observation), -np.inf)
        weights = np.exp(logits.astype(np.float64) - logits.max())
        return sample_index(weights / weights.sum(), self._action_rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The likeliest legal action."""
        return choose_best(self.compute_preferences(observation), action_mask)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Keep the decision; update when the rollout is full."""
        reward, bootstrap = compute_backup(transition, self.settings)
        reward += self._bonus.visit(transition.next_observation)
        self._rows.append(
            Rollout(
                self._encoder.encode(transition.observation),
                transition.action_mask,
                transition.action,
                reward * self.settings.reward_scale,
                bootstrap,
                transition.duration,
                transition.terminated or transition.truncated,
                self._encoder.encode(transition.next_observation),
            )
        )
        if len(self._rows) < self.settings.rollout:
            return {}
        rollout, self._rows = _stack(self._rows), []
        return self._learn(rollout)

    def _learn(self, rollout: Rollout) -> dict[str, float]:
        """The updates from one rollout; returns means over them."""
        observation, mask, action = (
            torch.from_numpy(rollout.observation),
            torch.from_numpy(rollout.mask),
            torch.from_numpy(rollout.action),
        )
        with torch.no_grad():
            values = self.critic(observation).squeeze(1)
            next_values = self.critic(torch.from_numpy(rollout.next_observation)).squeeze(1)
            old_log_probability = compute_log_policy(self.policy(observation), mask).gather(1, action[:, None])
        advantages = torch.from_numpy(compute_advantages(rollout, values.numpy(), next_values.numpy(), self.settings))
        targets = advantages + values
        totals = torch.zeros(4)
        count = 0
        for _ in range(self.settings.epochs):
            order = torch.from_numpy(self._batch_rng.permutation(len(action)))
            for rows in order.split(self.settings.batch_size):
                if len(rows) < 2:
                    continue  # one advantage cannot be normalised
                loss, parts = self.compute_loss(
                    observation[rows],
                    mask[rows],
                    action[rows],
                    old_log_probability[rows].squeeze(1),
                    advantages[rows],
                    targets[rows],
                )
                self._learner.minimise(loss)
                totals += parts
                count += 1
        names = ("loss", "policy_loss", "value_loss", "entropy")
        mean_value = values.mean().item() / self.settings.reward_scale
        return dict(zip(names, (totals / count).tolist(), strict=True)) | {
            "gradient_norm": self._learner.gradient_norm, "value": mean_value}

    def compute_loss(
        self,
        observation: torch.Tensor,
        mask: torch.Tensor,
        action: torch.Tensor,
        old_log_probability: torch.Tensor,
        advantage: torch.Tensor,
        target: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """The loss over a minibatch; and, without gradient, (4,): loss, policy loss, value loss, entropy."""
        settings = self.settings
        log_policy = compute_log_policy(self.policy(observation), mask)
        ratio = (log_policy.gather(1, action[:, None]).squeeze(1) - old_log_probability).exp()
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        clipped = ratio.clamp(1 - settings.clip, 1 + settings.clip)
        policy_loss = -torch.minimum(ratio * advantage, clipped * advantage).mean()
        value_loss = 0.5 * functional.mse_loss(self.critic(observation).squeeze(1), target)
        entropy = -(log_policy.exp() * log_policy.masked_fill(~mask, 0.0)).sum(dim=1).mean()
        loss = policy_loss + settings.value_weight * value_loss - settings.entropy_weight * entropy
        return loss, torch.stack((loss, policy_loss, value_loss, entropy)).detach()

    def state_dict(self) -> StateTree:
        """Networks, optimiser, the rollout so far, generators."""
        return {
            "learner": self._learner.state_dict(),
            "rollout": _stack(self._rows)._asdict() if self._rows else None,
            "bonus": self._bonus.state_dict(),
            "action_rng": self._action_rng.bit_generator.state,
            "batch_rng": self._batch_rng.bit_generator.state,
        }

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`."""
        self._learner.load_state_dict(state["learner"])
        self._bonus.load_state_dict(state["bonus"])
        self._rows = []
        if state["rollout"] is not None:
            self._rows = [Rollout(*row) for row in zip(*Rollout(**state["rollout"]), strict=True)]
        self._action_rng.bit_generator.state = state["action_rng"]
        self._batch_rng.bit_generator.state = state["batch_rng"]


def compute_log_policy(logits: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """Log probabilities of the softmax over legal actions, -inf elsewhere. Shapes (batch, actions)."""
    return functional.log_softmax(logits.masked_fill(~mask, -torch.inf), dim=1)


def compute_advantages(
    rollout: Rollout, values: NDArray, next_values: NDArray, settings: PPOSettings
) -> NDArray[np.float32]:
    """Generalised advantages of decisions of different duration.

    delta_t = R_t + b_t V(s_{t+1}) - V(s_t), and A_t = delta_t + b_t L_t A_{t+1} unless the episode ended at t,
    with b_t = gamma^k_t (1 - terminated) and L_t = lambda, or lambda^k_t with `lambda_per="primitive"`.

    Args:
        rollout: n decisions in order.
        values: V(s_t), (n,).
        next_values: V of the states reached, (n,).
        settings: lambda.

    Returns:
        float32 (n,).
    """
    delta = rollout.reward + rollout.bootstrap * next_values - values
    powers = rollout.duration if settings.lambda_per == "primitive" else np.ones(len(delta))
    carry = rollout.bootstrap * settings.gae_lambda**powers * ~rollout.over
    advantages, following = np.empty(len(delta), np.float32), 0.0
    for t in range(len(delta) - 1, -1, -1):
        following = delta[t] + carry[t] * following
        advantages[t] = following
    return advantages


def _stack(rows: list[Rollout]) -> Rollout:
    dtypes = (None, np.bool_, np.int64, np.float32, np.float32, np.int64, np.bool_, None)
    return Rollout(*(np.array(field, dtype) for field, dtype in zip(zip(*rows, strict=True), dtypes, strict=True)))
