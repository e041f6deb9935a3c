"""Deep deterministic policy gradient on discrete actions, through a relaxation.

Lillicrap et al. (2016). The actor gives one number per action and the environment gets the argmax. The critic sees the
action that ran as a one-hot vector, so that the actor can follow an exact expectation.
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

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.agents.components.exploration import (
    OrnsteinUhlenbeck,
    choose_best,
    compute_choice_entropy,
    compute_epsilon,
    make_rng,
    mask_values,
    sample_legal,
)
from hrl_escape.agents.components.networks import Learner, compute_td_loss, make_generator, make_network
from hrl_escape.agents.components.replay import (
    Experience,
    ReplaySettings,
    ReplayStreamAgent,
    UpdateSchedule,
    make_experience,
)
from hrl_escape.agents.keras_rl_2019.keras_rl import LinearRelaxation
from hrl_escape.agents.state import Kept
from hrl_escape.errors import AgentSettingsError
from hrl_escape.settings import Range


@dataclass(frozen=True)
class DDPGSettings(ReplaySettings):
    """Relaxation of discrete actions, exploration, replay and targets of `ddpg`; `warmup` is the critic's."""

    relaxation: Literal["one-hot", "linear"] = "one-hot"
    """Action vector that the critic sees. `one-hot`: the action that ran, so that the actor can follow its expected
    value under the softmax of its outputs. `linear`: the actor's unbounded outputs with their noise, as in the
    paper."""
    exploration: Literal["epsilon-greedy", "ornstein-uhlenbeck"] = "epsilon-greedy"
    """`epsilon-greedy`: a random legal action with probability epsilon. `ornstein-uhlenbeck`: noise with memory on the
    actor's outputs."""
    target_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.005
    """Share of the online networks blended into the target networks at each update."""
    average_actor: bool = True
    """The greedy policy is the target actor's, whose weights are an average of the actor's recent ones (Polyak and
    Juditsky 1992): the argmax of an actor that is still learning changes from one update to the next."""
    replay_capacity: Annotated[int, Range(1)] = 100_000
    """Decisions kept for replay."""
    actor_warmup: Annotated[int, Range(0)] = 1_000
    """Steps of the clock before the actor's first update."""
    entropy_weight: Annotated[float, Range(0)] = 0.3
    """Weight of the actor's entropy in its loss, in scaled rewards; `one-hot` only. It keeps the softmax's gradient
    alive and leaves the argmax of the best policy where it is."""


class OneHotRelaxation:
    """The action vector is one-hot.

    The actor maximises the mean of sum over legal o of pi(o | s) Q(s, o), pi the softmax of its outputs: with few
    actions that sum is exact (Christodoulou 2019), where a drawn relaxation (Jang, Gu and Poole 2017; Lowe et al. 2017)
    only estimates its gradient.

    Args:
        entropy_weight: of the actor's entropy in its loss.
    """

    def __init__(self, entropy_weight: float) -> None:
        self._entropy_weight = entropy_weight

    def encode(self, outputs: NDArray[np.float32], action: int) -> NDArray[np.float32]:
        """The vector that replay keeps, (actions,)."""
        vector = np.zeros_like(outputs)
        vector[action] = 1
        return vector

    def relax(self, outputs: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
        """The best legal actions for an actor's outputs, all (batch, actions)."""
        best = outputs.masked_fill(~mask, -torch.inf).argmax(dim=1)
        return functional.one_hot(best, outputs.shape[1]).to(outputs.dtype)

    def compute_actor_loss(self, critic: Callable[[torch.Tensor], torch.Tensor], observation: torch.Tensor,
                           outputs: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
        """Minus the mean of sum over legal o of pi(o | s) Q(s, o), less the weighted entropy of pi."""
        log_policy = functional.log_softmax(outputs.masked_fill(~mask, -1e9), dim=1)
        policy = log_policy.exp()
        entropy = -(policy * log_policy).sum(dim=1).mean()
        batch, actions = outputs.shape
        with torch.no_grad():
            vectors = torch.eye(actions, device=outputs.device).repeat(batch, 1)
            pairs = torch.cat((observation.repeat_interleave(actions, 0), vectors), dim=1)
            values = critic(pairs).view(batch, actions)
        return -(policy * values).sum(dim=1).mean() - self._entropy_weight * entropy


class DDPG(ReplayStreamAgent):
    """Critic: minimise the mean of loss(R + b Q'(s', mu'(s')) - Q(s, a)). Actor: maximise the mean of Q(s, mu(s)).

    R = sum gamma^i r_i, b = gamma^k (1 - terminated), primes are target networks. The action that runs is the argmax of
    the actor's outputs over legal actions; the relaxation turns it into the vector a that the critic sees.
    """

    settings: DDPGSettings
    STATE = (Kept("_actor_learner", "actor"), Kept("_critic_learner", "critic"), "_vector",
             Kept("_noise.state", "noise"))

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
        is_linear = settings.relaxation == "linear"
        self.relaxation = LinearRelaxation() if is_linear else OneHotRelaxation(settings.entropy_weight)
        self._noise = OrnsteinUhlenbeck(actions) if settings.exploration == "ornstein-uhlenbeck" else None
        self._vector = np.zeros(actions, np.float32)  # of the last action, as replay keeps it
        self._conduct: dict[str, float] = {}

    def compute_preferences(self, observation: Any) -> NDArray:
        """Outputs of the actor behind the greedy policy at an observation, before the mask, float32 (actions,)."""
        actor = self.target_actor if self.settings.average_actor else self.actor
        return actor.compute(self._encoder.encode(observation))

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """The argmax of the actor's outputs with noise, or a random action, as the settings say."""
        preferences = outputs = self.actor.compute(self._encoder.encode(observation))
        if self._noise is not None:
            outputs = preferences + self._noise.sample(self._action_rng).astype(np.float32)
        epsilon = compute_epsilon(self.settings, self._schedule.steps)
        is_random = self._noise is None and self._action_rng.random() < epsilon
        action = sample_legal(action_mask, self._action_rng) if is_random else choose_best(outputs, action_mask)
        self._vector = self.relaxation.encode(outputs, action)
        policy = np.exp(mask_values(preferences, action_mask) - preferences[action_mask].max())
        self._conduct = {"entropy": compute_choice_entropy(policy / policy.sum()),
                         "greedy": float(preferences[action] >= preferences[action_mask].max())}
        return action

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The argmax of `compute_preferences` over legal actions."""
        return choose_best(self.compute_preferences(observation), action_mask)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Store the decision, then make the updates that are due."""
        self.replay.add(make_experience(transition, self._encoder, self.settings)._replace(action=self._vector))
        if self._noise is not None and (transition.terminated or transition.truncated):
            self._noise.reset()
        return self.make_due_updates(transition) | self._conduct

    def begin_streams(self, count: int, device: torch.device) -> None:
        """Begin episodes in all streams; raises `AgentSettingsError` with noise of memory or the paper's relaxation."""
        for name, allowed in (("exploration", "epsilon-greedy"), ("relaxation", "one-hot")):
            if (value := getattr(self.settings, name)) != allowed:
                raise AgentSettingsError(name, value, f"{allowed!r} in many environments at once")
        super().begin_streams(count, device)

    def move(self, device: torch.device) -> None:
        """Move networks and optimisers to a device."""
        for learner in (self._actor_learner, self._critic_learner):
            learner.move(device)

    def compute_scores(self, encoded: torch.Tensor) -> torch.Tensor:
        """Outputs of the actor, (n, actions)."""
        return self.actor(encoded)

    def update(self, batch: Experience) -> dict[str, float]:
        """One gradient step of the critic and one of the actor, each once it is warm."""
        if batch.action.ndim == 1:  # of streams
            batch = batch._replace(action=functional.one_hot(batch.action, self._actions).float())
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
        """The mean of loss(R + b Q'(s', mu'(s')) - Q(s, a)) over a batch of arrays or tensors."""
        observation, _, action, reward, bootstrap, next_observation, next_mask = map(torch.as_tensor, batch)
        with torch.no_grad():
            next_action = self.relaxation.relax(self.target_actor(next_observation), next_mask)
            next_value = self.target_critic(torch.cat((next_observation, next_action), dim=1)).squeeze(1)
            targets = reward + bootstrap * next_value
        value = self.critic(torch.cat((observation, action), dim=1)).squeeze(1)
        return compute_td_loss(value, targets, self.settings.loss)

    def compute_actor_loss(self, batch: Experience) -> torch.Tensor:
        """Minus the mean value, to the critic, of the actor's choices over a batch of arrays or tensors."""
        observation, mask = torch.as_tensor(batch.observation), torch.as_tensor(batch.mask)
        return self.relaxation.compute_actor_loss(self.critic, observation, self.actor(observation), mask)
