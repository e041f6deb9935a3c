"""Soft actor-critic, for actions in a Box.

    y = R + b (min_i Q'_i(s', a') - alpha log pi(a' | s')),  a' ~ pi(. | s'),    critics: minimise (Q_i(s, a) - y)^2
    actor: minimise alpha log pi(a | s) - min_i Q_i(s, a),    temperature: minimise -log alpha (log pi(a | s) + H)

R = sum gamma^i r_i and b = gamma^k (1 - terminated) of a decision of k primitives; pi is a Gaussian through tanh, and H
the target entropy. Haarnoja et al. (2018, arXiv 1812.05905).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import gymnasium
import torch
from torch import Tensor
from torch.nn import functional

from hrl_escape.agents.agent import AgentSettings, GoalRule
from hrl_escape.agents.components.box_agent import BoxAgent
from hrl_escape.agents.components.distributions import draw_squashed, make_constant
from hrl_escape.agents.components.exploration import make_rng
from hrl_escape.agents.components.networks import Learner, make_generator, make_network
from hrl_escape.agents.components.policy import GreedyPolicy, Memory
from hrl_escape.agents.components.replay import Experience
from hrl_escape.agents.decisions import Moments, Policy
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class SACSettings(AgentSettings):
    """Settings of `sac`."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive. Higher values look further ahead and learn more slowly."""
    discounting: Literal["primitive", "decision"] = "primitive"
    """`primitive` discounts k primitives by gamma^k. `decision` sums their rewards and discounts by gamma."""
    bootstrap_on_truncation: bool = True
    """Bootstrap from the last state of a truncated episode. False treats a truncation as a termination."""
    clock: Literal["primitive", "decision"] = "primitive"
    """Unit of warm-up and updates."""
    hidden: tuple[Annotated[int, Range(1)], ...] = (256, 256)
    """Units of each hidden layer."""
    initialisation: Literal["torch", "glorot", "orthogonal"] = "torch"
    """Initial weights: U(+-1/sqrt(fan in)); Xavier uniform; or orthogonal, with tanh units."""
    scale_observations: bool = False
    """Map components with finite bounds to [-1, 1]. It suits bounds that states come near."""
    reward_scale: Annotated[float, Range(0, open_low=True)] = 1.0
    """Factor on the rewards that networks learn. Smaller values suit larger returns."""
    learning_rate: Annotated[float, Range(0, open_low=True)] = 3e-4
    """Step size of Adam. Too large a step diverges."""
    adam_epsilon: Annotated[float, Range(0, open_low=True)] = 1e-8
    """Term in Adam's denominator."""
    max_grad_norm: Annotated[float, Range(0)] = 0.0
    """Largest Euclidean norm of a gradient; larger ones are scaled down. 0 sets no limit."""
    target_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.005
    """Share of the critics blended into their targets. Smaller rates are slower and more stable."""
    alpha: Annotated[float, Range(0, open_low=True)] = 1.0
    """Initial temperature, in scaled rewards per nat. More explores more."""
    target_entropy: float | None = None
    """H, in nats, for actions scaled to [-1, 1]; by default minus the number of components."""
    warmup: Annotated[int, Range(0)] = 1_000
    """Steps of the clock with random actions and without updates."""
    batch_size: Annotated[int, Range(1)] = 256
    """Decisions in an update."""
    updates_per_step: Annotated[float, Range(0)] = 1.0
    """Updates for each step of the clock. More learn more from the same experience and take longer."""
    max_updates: Annotated[int, Range(1)] = 4
    """Most updates after a step of many environments. Where more are due, minibatches grow instead."""
    max_batch_size: Annotated[int, Range(1)] = 1_024
    """Largest minibatch with many environments. Larger ones learn from more decisions and take longer."""
    replay_capacity: Annotated[int, Range(1)] = 300_000
    """Decisions kept for replay."""
    replay_per_env: Annotated[int, Range(1)] = 256
    """Smallest replay capacity per environment with many environments, in decisions."""
    hindsight_goals: Annotated[int, Range(0)] = 0
    """Goals of hindsight replay for each original one, in environments with goals. 0 turns hindsight off."""


class SAC(BoxAgent):
    """Soft actor-critic; the equations are in the module's text.

    Attributes:
        actor: means, then logarithms of standard deviations.
        critics: two action values in scaled rewards.
    """

    settings: SACSettings
    STATE = ("_actor_learner", "_critic_learner", "_temperature_learner", "_noise")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: SACSettings | None = None, goal_rule: GoalRule | None = None) -> None:
        super().__init__(observation_space, action_space, seed, settings, goal_rule)
        settings, size, encoder = self.settings, self.box.size, self._encoder
        generator = make_generator(make_rng(seed, "weights"))
        self.actor = make_network(encoder, 2 * size, settings, generator)
        self.critics = [make_network(encoder, 1, settings, generator, size) for _ in range(2)]
        self._targets = [make_network(encoder, 1, settings, generator, size).requires_grad_(False) for _ in range(2)]
        for target, critic in zip(self._targets, self.critics, strict=True):
            target.blend(critic, 1.0)
        self._log_alpha = make_constant(1, math.log(settings.alpha))
        self._target_entropy = -float(size) if settings.target_entropy is None else settings.target_entropy
        critics = {f"critic_{i}": each for i, each in enumerate(self.critics)}
        targets = {f"target_{i}": each for i, each in enumerate(self._targets)}
        self._actor_learner = Learner(self.name, {"actor": self.actor}, ["actor"], settings)
        self._critic_learner = Learner(self.name, critics | targets, critics, settings)
        self._temperature_learner = Learner(self.name, {"log_alpha": self._log_alpha}, ["log_alpha"], settings)
        self._noise = make_generator(make_rng(seed, "noise"))

    @property
    def alpha(self) -> float:
        """Temperature, in scaled rewards per nat."""
        return math.exp(float(self._log_alpha.weights))

    def explore(self, batch: Moments) -> Any:
        """Draw from the policy, (n, size)."""
        outputs = torch.as_tensor(self.actor.evaluate(self._encoder.encode_batch(batch.observation)))
        noise = torch.as_tensor(self._arrays.draw_normal(len(outputs), self.box.size))
        points = draw_squashed(outputs, noise)[0]
        return points.numpy() if self.place[1] is None else points

    def make_policy(self) -> Policy:
        """Make the policy of the mean through tanh."""
        return GreedyPolicy(self._encoder, self.actor, Memory(), self.box, is_squashed=True)

    def move(self, device: torch.device) -> None:
        """Move networks and optimisers to a device."""
        for learner in (self._actor_learner, self._critic_learner, self._temperature_learner):
            learner.move(device)

    def update(self, batch: Experience) -> Mapping[str, float]:
        """Make one gradient step of critics, actor and temperature, and blend the targets."""
        observation, _, action, reward, bootstrap, next_observation, _ = map(torch.as_tensor, batch)
        targets = self.compute_targets(reward, bootstrap, next_observation)
        values = self._compute_values(self.critics, observation, action)
        losses = [functional.mse_loss(value, targets) for value in values]
        metrics = {"loss": self._critic_learner.minimise(losses[0] + losses[1]),
                   "gradient_norm": self._critic_learner.gradient_norm}
        points, log_density = self._draw(observation)
        value = torch.minimum(*self._compute_values(self.critics, observation, points))
        metrics["actor_loss"] = self._actor_learner.minimise((self.alpha * log_density - value).mean())
        excess = (log_density.detach() + self._target_entropy).mean()
        self._temperature_learner.minimise(-(self._log_alpha(observation[:1]) * excess).sum())
        for target, critic in zip(self._targets, self.critics, strict=True):
            target.blend(critic, self.settings.target_rate)
        return metrics | {"alpha": self.alpha, "entropy": -float(log_density.detach().mean())}

    def compute_targets(self, reward: Tensor, bootstrap: Tensor, next_observation: Tensor) -> Tensor:
        """Return y of decisions, (n,), with fresh draws of the next actions."""
        with torch.no_grad():
            points, log_density = self._draw(next_observation)
            value = torch.minimum(*self._compute_values(self._targets, next_observation, points))
            return reward + bootstrap * (value - self.alpha * log_density)

    def _draw(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        noise = torch.randn((len(observation), self.box.size), generator=self._noise).to(observation.device)
        return draw_squashed(self.actor(observation), noise)

    @staticmethod
    def _compute_values(critics: Any, observation: Tensor, points: Tensor) -> list[Tensor]:
        pairs = torch.cat((observation, points), dim=1)
        return [critic(pairs).squeeze(1) for critic in critics]
