"""Deep deterministic policy gradient on discrete actions, through a relaxation.

Lillicrap et al. (2016). The actor outputs one number per action, and the environment receives the argmax. The critic's
input is the executed action as a one-hot vector, which lets the actor follow an exact expectation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from hrl_escape.agents.agent import AgentSettings
from hrl_escape.agents.components.exploration import (
    OrnsteinUhlenbeck,
    compute_epsilon,
    compute_exploration,
    make_rng,
    measure_conduct,
)
from hrl_escape.agents.components.networks import Learner, Network, compute_td_loss, make_generator, make_network
from hrl_escape.agents.components.policy import GreedyPolicy, Memory
from hrl_escape.agents.components.replay import Experience, ReplayAgent, UpdateSchedule
from hrl_escape.agents.decisions import Decisions, Moments, Policy
from hrl_escape.agents.keras_rl_2019.keras_rl import LinearRelaxation
from hrl_escape.agents.state import Kept
from hrl_escape.errors import AgentSettingsError
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class DDPGSettings(AgentSettings):
    """Settings of `ddpg`; `warmup` applies to the critic."""

    relaxation: Literal["one-hot", "linear"] = "one-hot"
    """Action vector as input of the critic. `one-hot`: the executed action; the actor follows its expected value under
    the softmax of its outputs. `linear`: the actor's unbounded outputs with their noise, as in the paper."""
    exploration: Literal["epsilon-greedy", "ornstein-uhlenbeck"] = "epsilon-greedy"
    """`epsilon-greedy`: a random legal action with probability epsilon. `ornstein-uhlenbeck`: correlated noise on the
    actor's outputs."""
    target_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.005
    """Share of the online networks blended into the target networks at each update. Smaller rates are slower and more
    stable."""
    average_actor: bool = True
    """Use the target actor, an average of recent weights (Polyak and Juditsky 1992), as greedy policy. The argmax of
    the actor itself changes from one update to the next during learning."""
    replay_capacity: Annotated[int, Range(1)] = 100_000
    """Decisions kept for replay."""
    actor_warmup: Annotated[int, Range(0)] = 1_000
    """Steps of the clock before the actor's first update."""
    entropy_weight: Annotated[float, Range(0)] = 0.3
    """Weight of the actor's entropy in its loss, in scaled rewards; `one-hot` only. It keeps the softmax's gradient
    alive and does not change the argmax of the best policy."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive. Higher values look further ahead and learn more slowly."""
    discounting: Literal["primitive", "decision"] = "primitive"
    """`primitive` discounts k primitives by gamma^k. `decision` sums their rewards and discounts by gamma."""
    bootstrap_on_truncation: bool = True
    """Bootstrap from the last state of a truncated episode. False treats a truncation as a termination."""
    clock: Literal["primitive", "decision"] = "primitive"
    """Unit of warm-up, updates and epsilon. With primitives an agent over options updates as often as a flat one."""

    epsilon_start: Annotated[float, Range(0, 1)] = 1.0
    """Epsilon at the beginning; 1 acts at random."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon from `epsilon_steps` on. More explores for longer and lowers the return of training episodes."""
    epsilon_steps: Annotated[int, Range(1)] = 5_000
    """Number of clock steps of the linear decrease of epsilon. More explores for longer."""

    hidden: tuple[Annotated[int, Range(1)], ...] = (64, 64)
    """Units of each hidden layer."""
    initialisation: Literal["torch", "glorot", "orthogonal"] = "torch"
    """Initial weights: U(+-1/sqrt(fan in)); Xavier uniform, as in Keras; or orthogonal, with tanh units."""
    scale_observations: bool = True
    """Map components with finite bounds to [-1, 1]."""
    reward_scale: Annotated[float, Range(0, open_low=True)] = 0.1
    """Factor on the rewards that networks learn. Smaller values suit larger returns."""
    learning_rate: Annotated[float, Range(0, open_low=True)] = 3e-4
    """Step size of Adam. Too large a step diverges."""
    adam_epsilon: Annotated[float, Range(0, open_low=True)] = 1e-8
    """Term in Adam's denominator; 1e-7 in Keras."""
    max_grad_norm: Annotated[float, Range(0)] = 10.0
    """Largest Euclidean norm of a gradient; larger ones are scaled down. 0 sets no limit."""
    loss: Literal["huber", "squared"] = "huber"
    """Huber loss with threshold 1 in scaled rewards, or half the squared error, which follows outliers."""

    warmup: Annotated[int, Range(0)] = 500
    """Steps of the clock before the first update."""
    batch_size: Annotated[int, Range(1)] = 64
    """Decisions in an update."""
    updates_per_step: Annotated[float, Range(0)] = 0.25
    """Updates for each step of the clock. More learn more from the same experience and take longer."""
    max_updates: Annotated[int, Range(1)] = 16
    """Most updates after a step of many environments. Where more are due, minibatches grow instead. Few large ones
    learn less, because the target network follows updates."""
    replay_per_env: Annotated[int, Range(1)] = 128
    """Smallest replay capacity per environment with many environments, in decisions."""


class OneHotRelaxation:
    """The action vector is one-hot.

    The actor maximises the mean of sum over legal o of pi(o | s) Q(s, o), pi the softmax of its outputs. With few
    actions that sum is exact (Christodoulou 2019), while a sampled relaxation (Jang, Gu and Poole 2017; Lowe et al.
    2017) only estimates its gradient.

    Args:
        entropy_weight: weight of the actor's entropy in its loss.
    """

    def __init__(self, entropy_weight: float) -> None:
        self._entropy_weight = entropy_weight

    def encode(self, outputs: Any, action: Any) -> Any:
        """Return the vectors for replay, (n, actions), of outputs (n, actions) and actions (n,), arrays or tensors."""
        library: Any = np if isinstance(outputs, np.ndarray) else torch
        columns = library.arange(outputs.shape[1], device=outputs.device)
        return (columns == action[:, None]) + library.zeros_like(outputs)

    def relax(self, outputs: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
        """Return the best legal actions for an actor's outputs as vectors, all (batch, actions)."""
        best = outputs.masked_fill(~mask, -torch.inf).argmax(dim=1)
        return functional.one_hot(best, outputs.shape[1]).to(outputs.dtype)

    def compute_actor_loss(self, critic: Callable[[torch.Tensor], torch.Tensor], observation: torch.Tensor,
                           outputs: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
        """Return minus the mean of sum over legal o of pi(o | s) Q(s, o), minus the weighted entropy of pi."""
        log_policy = functional.log_softmax(outputs.masked_fill(~mask, -1e9), dim=1)
        policy = log_policy.exp()
        entropy = -(policy * log_policy).sum(dim=1).mean()
        batch, actions = outputs.shape
        with torch.no_grad():
            vectors = torch.eye(actions, device=outputs.device).repeat(batch, 1)
            pairs = torch.cat((observation.repeat_interleave(actions, 0), vectors), dim=1)
            values = critic(pairs).view(batch, actions)
        return -(policy * values).sum(dim=1).mean() - self._entropy_weight * entropy


class DDPG(ReplayAgent):
    """Critic: minimise the mean of loss(R + b Q'(s', mu'(s')) - Q(s, a)). Actor: maximise the mean of Q(s, mu(s)).

    R = sum gamma^i r_i, b = gamma^k (1 - terminated), primes are target networks. The executed action is the argmax of
    the actor's outputs over legal actions; the relaxation converts it to the critic's input a.
    """

    settings: DDPGSettings
    STATE = (Kept("_actor_learner", "actor"), Kept("_critic_learner", "critic"),
             Kept("_noise.state", "noise"), Kept("_noise_rng", "action_rng"))

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: DDPGSettings | None = None) -> None:
        super().__init__(observation_space, action_space, seed, settings, relaxed=True)
        settings, encoder, actions = self.settings, self._encoder, self._actions
        self._schedule = UpdateSchedule(min(settings.warmup, settings.actor_warmup), settings.updates_per_step)
        generator = make_generator(make_rng(seed, "weights"))
        self.actor = make_network(encoder, actions, settings, generator)
        self.critic = make_network(encoder, 1, settings, generator, extra_inputs=actions)
        self.target_actor = make_network(encoder, actions, settings, generator).requires_grad_(False)
        self.target_critic = make_network(encoder, 1, settings, generator, actions).requires_grad_(False)
        self.target_actor.blend(self.actor, 1.0)
        self.target_critic.blend(self.critic, 1.0)
        actors = {"actor": self.actor, "target_actor": self.target_actor}
        critics = {"critic": self.critic, "target_critic": self.target_critic}
        self._actor_learner = Learner(self.name, actors, ["actor"], settings)
        self._critic_learner = Learner(self.name, critics, ["critic"], settings)
        self._is_linear = settings.relaxation == "linear"
        self.relaxation = LinearRelaxation() if self._is_linear else OneHotRelaxation(settings.entropy_weight)
        self._noise_rng = make_rng(seed, "actions")
        self._noise = OrnsteinUhlenbeck(actions) if settings.exploration == "ornstein-uhlenbeck" else None
        self._vector = np.zeros((1, actions), np.float32)  # for replay: of the latest actions of one environment
        self._conduct: dict[str, float] = {}

    def compute_preferences(self, observation: Any) -> NDArray:
        """Return outputs of the actor behind the greedy policy, before the mask, float32 (actions,)."""
        return self._best_actor.compute(self._encoder.encode(observation))

    @property
    def _best_actor(self) -> Network:
        return self.target_actor if self.settings.average_actor else self.actor

    def act(self, batch: Moments) -> Any:
        """Return the argmax of the actor's outputs with noise, or a random action, by the settings, int64 (n,)."""
        preferences = outputs = self.actor.evaluate(self._encoder.encode_batch(batch.observation))
        if self._noise is not None:
            outputs = preferences + self._noise.sample(self._noise_rng).astype(np.float32)
        epsilon = compute_epsilon(self.settings, self._schedule.steps) if self._noise is None else 0.0
        policy = compute_exploration(outputs, batch.action_mask, epsilon=epsilon)
        action = self._arrays.draw_choices(policy)
        self._vector = self.relaxation.encode(outputs, action)
        soft = compute_exploration(preferences, batch.action_mask, temperature=1.0)
        self._conduct = measure_conduct(soft, preferences, batch.action_mask, action)
        return action

    def make_policy(self) -> Policy:
        """Make the greedy policy of the averaged actor."""
        return GreedyPolicy(self._encoder, self._best_actor, Memory())

    def observe(self, batch: Decisions) -> Mapping[str, float]:
        """Store the decisions, then make the updates that are due."""
        over = batch.terminated | batch.truncated
        vector = self._vector if self._is_linear else self.relaxation.encode(batch.next_action_mask + 0.0, batch.action)
        self.replay.add(self.make_experience(batch)._replace(action=vector), batch.env, over)
        if self._noise is not None and over[0]:
            self._noise.reset()
        conduct, epsilon = self._conduct, compute_epsilon(self.settings, self._schedule.steps)
        return {"epsilon": epsilon, **self.make_due_updates(batch.duration), **conduct}

    def begin_episodes(self, num_envs: int = 1, device: torch.device | None = None) -> None:
        """Begin episodes. Raises `AgentSettingsError` for several environments with correlated noise or `linear`."""
        for name, allowed in (("exploration", "epsilon-greedy"), ("relaxation", "one-hot")):
            if (value := getattr(self.settings, name)) != allowed and device is not None:
                raise AgentSettingsError(name, value, f"{allowed!r} in many environments at once")
        super().begin_episodes(num_envs, device)

    def move(self, device: torch.device) -> None:
        """Move networks and optimisers to a device."""
        for learner in (self._actor_learner, self._critic_learner):
            learner.move(device)

    def update(self, batch: Experience) -> Mapping[str, float]:
        """Make one gradient step of the critic and one of the actor, each after its warm-up."""
        metrics: dict[str, float] = {}
        if self._schedule.steps > self.settings.warmup:
            metrics["loss"] = self._critic_learner.minimise(self.compute_critic_loss(batch))
            metrics["gradient_norm"] = self._critic_learner.gradient_norm
            self.target_critic.blend(self.critic, self.settings.target_rate)
        if self._schedule.steps > self.settings.actor_warmup:
            metrics["actor_loss"] = self._actor_learner.minimise(self.compute_actor_loss(batch))
            self.target_actor.blend(self.actor, self.settings.target_rate)
        return metrics

    def compute_critic_loss(self, batch: Experience) -> torch.Tensor:
        """Return the mean of loss(R + b Q'(s', mu'(s')) - Q(s, a)) over a batch of arrays or tensors."""
        observation, _, action, reward, bootstrap, next_observation, next_mask = map(torch.as_tensor, batch)
        with torch.no_grad():
            next_action = self.relaxation.relax(self.target_actor(next_observation), next_mask)
            next_value = self.target_critic(torch.cat((next_observation, next_action), dim=1)).squeeze(1)
            targets = reward + bootstrap * next_value
        value = self.critic(torch.cat((observation, action), dim=1)).squeeze(1)
        return compute_td_loss(value, targets, self.settings.loss)

    def compute_actor_loss(self, batch: Experience) -> torch.Tensor:
        """Return minus the critic's mean value of the actor's choices over a batch of arrays or tensors."""
        observation, mask = torch.as_tensor(batch.observation), torch.as_tensor(batch.mask)
        return self.relaxation.compute_actor_loss(self.critic, observation, self.actor(observation), mask)
