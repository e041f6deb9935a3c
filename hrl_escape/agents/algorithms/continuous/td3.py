"""Twin delayed deep deterministic policy gradient, for actions in a Box.

    y = R + b min_i Q'_i(s', clip(mu'(s') + clip(sigma eps, -c, c), -1, 1)),    critics: minimise (Q_i(s, a) - y)^2
    every d-th update, actor: maximise Q_1(s, mu(s)),    targets' <- (1 - tau) targets' + tau online

R = sum gamma^i r_i and b = gamma^k (1 - terminated) of a decision of k primitives. Fujimoto, van Hoof and Meger (2018).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import gymnasium
import torch
from torch import Tensor
from torch.nn import functional

from hrl_escape.agents.agent import AgentSettings, GoalRule
from hrl_escape.agents.components.box_agent import BoxAgent
from hrl_escape.agents.components.exploration import make_rng
from hrl_escape.agents.components.networks import Learner, Network, make_generator, make_network
from hrl_escape.agents.components.policy import GreedyPolicy, Memory
from hrl_escape.agents.components.replay import Experience
from hrl_escape.agents.decisions import Moments, Policy
from hrl_escape.agents.state import Stateful
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class TD3Settings(AgentSettings):
    """Settings of `td3`. Actions are scaled to [-1, 1], so noise is in these units."""

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
    learning_rate: Annotated[float, Range(0, open_low=True)] = 1e-3
    """Step size of Adam. Too large a step diverges."""
    adam_epsilon: Annotated[float, Range(0, open_low=True)] = 1e-8
    """Term in Adam's denominator."""
    max_grad_norm: Annotated[float, Range(0)] = 0.0
    """Largest Euclidean norm of a gradient; larger ones are scaled down. 0 sets no limit."""
    target_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.005
    """tau, share of the online networks blended into the targets. Smaller rates are slower and more stable."""
    exploration_noise: Annotated[float, Range(0)] = 0.1
    """Standard deviation of the noise on actions. More explores more."""
    target_noise: Annotated[float, Range(0)] = 0.2
    """sigma, standard deviation of the noise on target actions. More smooths the critic over similar actions."""
    target_noise_clip: Annotated[float, Range(0)] = 0.5
    """c, bound on that noise."""
    policy_delay: Annotated[int, Range(1)] = 2
    """d, critic updates for each update of actor and targets."""
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


class TwinDelayed(Stateful):
    """Networks of TD3 with their update; goal hierarchies use one at each level.

    Args:
        name: in messages.
        make: makes a network from its outputs and its additional inputs.
        actions: n, number of components of an action in [-1, 1]^n.
        settings: `TD3Settings`, or others with its fields.
        seed: of the target noise.
    """

    STATE = ("actor_learner", "critic_learner", "_noise")

    def __init__(self, name: str, make: Callable[[int, int], Network], actions: int, settings: Any, seed: int) -> None:
        self.settings, self.size = settings, actions
        self.actor, self.target_actor = make(actions, 0), make(actions, 0).requires_grad_(False)
        self.critics = [make(1, actions) for _ in range(2)]
        self.target_critics = [make(1, actions).requires_grad_(False) for _ in range(2)]
        for target, source in self._pair_targets():
            target.blend(source, 1.0)
        self.actor_learner = Learner(name, {"actor": self.actor, "target": self.target_actor}, ["actor"], settings)
        critics = {f"critic_{i}": each for i, each in enumerate(self.critics)}
        targets = {f"target_{i}": each for i, each in enumerate(self.target_critics)}
        self.critic_learner = Learner(name, critics | targets, critics, settings)
        self._noise = make_generator(make_rng(seed, f"{name} target noise"))

    def _pair_targets(self) -> list[tuple[Network, Network]]:
        return [(self.target_actor, self.actor), *zip(self.target_critics, self.critics, strict=True)]

    def move(self, device: torch.device) -> None:
        """Move networks and optimisers to a device."""
        self.actor_learner.move(device)
        self.critic_learner.move(device)

    def evaluate(self, observation: Any) -> Any:
        """Return mu(s) in [-1, 1]^n without gradients, (n, actions), in the library of the observations."""
        points = self.actor.evaluate(observation)
        return points.tanh() if isinstance(points, Tensor) else torch.from_numpy(points).tanh().numpy()

    def compute_targets(self, reward: Tensor, bootstrap: Tensor, next_observation: Tensor) -> Tensor:
        """Return y of decisions, (n,), with fresh noise on the target actions."""
        settings = self.settings
        with torch.no_grad():
            action = self.target_actor(next_observation).tanh()
            noise = torch.randn(action.shape, generator=self._noise).to(action.device) * settings.target_noise
            noise = noise.clamp(-settings.target_noise_clip, settings.target_noise_clip)
            pairs = torch.cat((next_observation, (action + noise).clamp(-1, 1)), dim=1)
            values = torch.minimum(*(critic(pairs).squeeze(1) for critic in self.target_critics))
            return reward + bootstrap * values

    def update(self, observation: Tensor, action: Tensor, reward: Tensor, bootstrap: Tensor, next_observation: Tensor,
               penalise: Callable[[Tensor], Tensor] | None = None) -> dict[str, float]:
        """Make one update from decisions, (n, ...) each; returns numbers to log.

        `penalise` is an additional loss of the actor as a function of its actions, or None.
        """
        targets = self.compute_targets(reward, bootstrap, next_observation)
        pairs = torch.cat((observation, action), dim=1)
        losses = [functional.mse_loss(critic(pairs).squeeze(1), targets) for critic in self.critics]
        metrics = {"loss": self.critic_learner.minimise(losses[0] + losses[1]),
                   "gradient_norm": self.critic_learner.gradient_norm}
        if self.critic_learner.updates % self.settings.policy_delay == 0:
            points = self.actor(observation).tanh()
            loss = -self.critics[0](torch.cat((observation, points), dim=1)).mean()
            metrics["actor_loss"] = self.actor_learner.minimise(loss if penalise is None else loss + penalise(points))
            for target, source in self._pair_targets():
                target.blend(source, self.settings.target_rate)
        return metrics


class TD3(BoxAgent):
    """Twin delayed DDPG; the equations are in the module's text.

    Attributes:
        networks: actor, critics and their targets.
    """

    settings: TD3Settings
    STATE = ("networks",)

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: TD3Settings | None = None, goal_rule: GoalRule | None = None) -> None:
        super().__init__(observation_space, action_space, seed, settings, goal_rule)
        generator = make_generator(make_rng(seed, "weights"))
        self.networks = TwinDelayed(self.name, lambda outputs, extra: make_network(
            self._encoder, outputs, self.settings, generator, extra), self.box.size, self.settings, seed)

    def explore(self, batch: Moments) -> Any:
        """Return the actor's points with noise, (n, size)."""
        points = self.networks.evaluate(self._encoder.encode_batch(batch.observation))
        noise = self._arrays.draw_normal(*points.shape)
        return (points + self.settings.exploration_noise * noise).clip(-1, 1)

    def make_policy(self) -> Policy:
        """Make the policy of the actor without noise."""
        return GreedyPolicy(self._encoder, self.networks.actor, Memory(), self.box, is_squashed=True)

    def move(self, device: torch.device) -> None:
        """Move networks and optimisers to a device."""
        self.networks.move(device)

    def update(self, batch: Experience) -> Mapping[str, float]:
        """Make one update of the critics and, every d-th time, of the actor."""
        observation, _, action, reward, bootstrap, next_observation, _ = map(torch.as_tensor, batch)
        return self.networks.update(observation, action, reward, bootstrap, next_observation)
