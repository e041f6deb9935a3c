"""Deep deterministic policy gradient on discrete actions, through a continuous relaxation.

Lillicrap et al. (2016). The actor gives one number per action and the environment gets the argmax,
as the paper used it. The recipe `paper` is keras-rl 0.4.2's DDPGAgent as the published program configured it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from hrl_escape.agents.agent import SMDPTransition, StateTree, compute_backup, count_actions, count_steps
from hrl_escape.agents.exploration import (
    EpsilonSettings,
    OrnsteinUhlenbeck,
    choose_best,
    compute_epsilon,
    make_rng,
    sample_legal,
)
from hrl_escape.agents.networks import (
    Learner,
    NetworkSettings,
    ObservationEncoder,
    compute_td_loss,
    make_forward,
    make_generator,
    make_network,
)
from hrl_escape.agents.replay import Experience, ReplayBuffer
from hrl_escape.agents.settings import LearningSettings, Range

__all__ = ["DDPG", "DDPGSettings", "relax"]


@dataclass(frozen=True)
class DDPGSettings(NetworkSettings, EpsilonSettings, LearningSettings):
    """Settings of `ddpg`."""

    learning_rate: Annotated[float, Range(0, open_low=True)] = 3e-4
    """Step size of Adam, for actor and critic."""
    relaxation: Literal["one-hot", "linear"] = "one-hot"
    """What the critic sees of an action. `one-hot`: the action that ran, so that the actor can follow the value it
    expects over the softmax of its outputs. `linear`: the actor's unbounded outputs with their noise, as in the
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
    batch_size: Annotated[int, Range(1)] = 64
    """Decisions in an update."""
    warmup: Annotated[int, Range(0)] = 500
    """Steps of the clock before the critic's first update."""
    actor_warmup: Annotated[int, Range(0)] = 1_000
    """Steps of the clock before the actor's first update."""
    updates_per_step: Annotated[float, Range(0)] = 0.25
    """Updates for each step of the clock."""
    entropy_weight: Annotated[float, Range(0)] = 0.3
    """Weight of the actor's entropy in its loss, in scaled rewards; `one-hot` only. It keeps the softmax's gradient
    alive and leaves the argmax of the best policy where it is."""
    loss: Literal["huber", "squared"] = "huber"
    """The critic's loss: Huber with threshold 1 (in scaled rewards), or half the squared error."""


PAPER = DDPGSettings(
    discounting="decision",
    bootstrap_on_truncation=False,
    clock="decision",
    hidden=(16, 16, 16),
    initialisation="glorot",
    learning_rate=1e-3,
    adam_epsilon=1e-7,
    max_grad_norm=1.0,
    scale_observations=False,
    reward_scale=1.0,
    relaxation="linear",
    exploration="ornstein-uhlenbeck",
    target_rate=0.001,
    average_actor=False,
    batch_size=32,
    warmup=1_000,
    actor_warmup=100,
    updates_per_step=1.0,
    entropy_weight=0.0,
    loss="squared",
)


class DDPG:
    """Critic: minimise the mean of loss(R + b Q'(s', mu'(s')) - Q(s, a)). Actor: maximise the mean of Q(s, mu(s)).

    R = sum gamma^i r_i, b = gamma^k (1 - terminated), primes are target networks. The action that runs is the
    argmax of the actor's outputs over legal actions. With `relaxation="one-hot"`, a and mu' are one-hot vectors of
    legal actions, and the actor maximises the mean of sum over legal o of pi(o | s) Q(s, o), pi the softmax of its
    outputs: with few actions that sum is exact (Christodoulou 2019), where a drawn relaxation (Jang, Gu and Poole 2017;
    Lowe et al. 2017) only estimates its gradient.
    """

    Settings: ClassVar[type] = DDPGSettings
    recipes: ClassVar[Mapping[str, DDPGSettings]] = {
        "corrected": DDPGSettings(),
        "paper": PAPER,
        "smdp-paper": replace(PAPER, hidden=(4, 4, 4)),  # the program's width with meta-actions on
    }

    def __init__(
        self,
        observation_space: gymnasium.Space,
        action_space: gymnasium.Space,
        seed: int,
        settings: DDPGSettings | None = None,
    ) -> None:
        self.settings = settings = settings or DDPGSettings()
        self._actions = actions = count_actions(action_space, "ddpg")
        self._encoder = encoder = ObservationEncoder(observation_space, settings.scale_observations)
        generator = make_generator(make_rng(seed, "weights"))
        self.actor = make_network(encoder, actions, settings, generator)
        self.critic = make_network(encoder, 1, settings, generator, extra_inputs=actions)
        self.target_actor = make_network(encoder, actions, settings, generator).requires_grad_(False)
        self.target_critic = make_network(encoder, 1, settings, generator, actions).requires_grad_(False)
        self.target_actor.blend(self.actor, 1.0)
        self.target_critic.blend(self.critic, 1.0)
        self._explore = make_forward(self.actor)
        self._exploit = make_forward(self.target_actor) if settings.average_actor else self._explore
        actors = {"actor": self.actor, "target_actor": self.target_actor}
        critics = {"critic": self.critic, "target_critic": self.target_critic}
        self._actor_learner = Learner("ddpg", actors, ["actor"], settings)
        self._critic_learner = Learner("ddpg", critics, ["critic"], settings)
        self.replay = ReplayBuffer(
            settings.replay_capacity, encoder.shape, encoder.dtype, actions, action_shape=(actions,)
        )
        self._action_rng, self._replay_rng = make_rng(seed, "actions"), make_rng(seed, "replay")
        self._noise = OrnsteinUhlenbeck(actions)
        self._steps, self._updates_due = 0, 0.0
        self._relaxed = np.zeros(actions, np.float32)  # what the replay keeps of the last action

    @property
    def gamma(self) -> float:
        """Discount per primitive."""
        return self.settings.gamma

    def compute_preferences(self, observation: Any) -> NDArray:
        """What the greedy policy takes the argmax of at an observation, before the mask, float32 (actions,)."""
        return self._exploit(self._encoder.encode(observation))

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """The argmax of the actor's outputs with noise, or a random action, as the settings say."""
        outputs = self._explore(self._encoder.encode(observation))
        if self.settings.exploration == "ornstein-uhlenbeck":
            outputs = outputs + self._noise.sample(self._action_rng).astype(np.float32)
            action = choose_best(outputs, action_mask)
        elif self._action_rng.random() < compute_epsilon(self.settings, self._steps):
            action = sample_legal(action_mask, self._action_rng)
        else:
            action = choose_best(outputs, action_mask)
        if self.settings.relaxation == "linear":
            self._relaxed = outputs
        else:
            self._relaxed = np.zeros(self._actions, np.float32)
            self._relaxed[action] = 1
        return action

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The argmax of `compute_preferences` over legal actions."""
        return choose_best(self.compute_preferences(observation), action_mask)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Store the decision, then make the updates that are due."""
        settings = self.settings
        reward, bootstrap = compute_backup(transition, settings)
        self.replay.add(
            Experience(
                self._encoder.encode(transition.observation),
                transition.action_mask,
                self._relaxed,
                reward * settings.reward_scale,
                bootstrap,
                self._encoder.encode(transition.next_observation),
                transition.next_action_mask,
            )
        )
        if transition.terminated or transition.truncated:
            self._noise.reset()
        steps = count_steps(transition, settings)
        self._steps += steps
        metrics: dict[str, float] = {"epsilon": compute_epsilon(settings, self._steps)}
        if self._steps > min(settings.warmup, settings.actor_warmup):
            self._updates_due += steps * settings.updates_per_step
            while self._updates_due >= 1:
                self._updates_due -= 1
                metrics |= self._update()
        return metrics

    def _update(self) -> dict[str, float]:
        batch = self.replay.sample(self.settings.batch_size, self._replay_rng)
        metrics: dict[str, float] = {}
        if self._steps > self.settings.warmup:
            metrics["loss"] = self._critic_learner.minimise(self.compute_critic_loss(batch))
            self.target_critic.blend(self.critic, self.settings.target_rate)
        if self._steps > self.settings.actor_warmup:
            metrics["actor_loss"] = self._actor_learner.minimise(self.compute_actor_loss(batch))
            self.target_actor.blend(self.actor, self.settings.target_rate)
        return metrics

    def compute_critic_loss(self, batch: Experience) -> torch.Tensor:
        """The critic's loss over a batch of numpy arrays."""
        observation, _, action, reward, bootstrap, next_observation, next_mask = map(torch.from_numpy, batch)
        with torch.no_grad():
            next_action = relax(self.target_actor(next_observation), next_mask, self.settings.relaxation)
            next_value = self.target_critic(torch.cat((next_observation, next_action), dim=1)).squeeze(1)
            targets = reward + bootstrap * next_value
        value = self.critic(torch.cat((observation, action), dim=1)).squeeze(1)
        return compute_td_loss(value, targets, self.settings.loss)

    def compute_actor_loss(self, batch: Experience) -> torch.Tensor:
        """Minus the mean of what the actor's choice is worth to the critic, less the weighted entropy."""
        observation, mask = torch.from_numpy(batch.observation), torch.from_numpy(batch.mask)
        outputs = self.actor(observation)
        if self.settings.relaxation == "linear":
            return -self.critic(torch.cat((observation, outputs), dim=1)).mean()
        log_policy = functional.log_softmax(outputs.masked_fill(~mask, -1e9), dim=1)
        policy = log_policy.exp()
        entropy = -(policy * log_policy).sum(dim=1).mean()
        value = (policy * self._compute_values(observation)).sum(dim=1).mean()
        return -value - self.settings.entropy_weight * entropy

    @torch.no_grad()
    def _compute_values(self, observation: torch.Tensor) -> torch.Tensor:
        """Q(s, o) of every action, (batch, actions)."""
        batch, actions = len(observation), self._actions
        pairs = torch.cat((observation.repeat_interleave(actions, 0), torch.eye(actions).repeat(batch, 1)), dim=1)
        return self.critic(pairs).view(batch, actions)

    def state_dict(self) -> StateTree:
        """Networks, optimisers, replay, counters, noise, generators."""
        return {
            "actor": self._actor_learner.state_dict(),
            "critic": self._critic_learner.state_dict(),
            "replay": self.replay.state_dict(),
            "steps": self._steps,
            "updates_due": self._updates_due,
            "relaxed": self._relaxed,
            "noise": self._noise.state,
            "action_rng": self._action_rng.bit_generator.state,
            "replay_rng": self._replay_rng.bit_generator.state,
        }

    def load_state_dict(self, state: StateTree) -> None:
        """Restore what `state_dict` gave."""
        self._actor_learner.load_state_dict(state["actor"])
        self._critic_learner.load_state_dict(state["critic"])
        self.replay.load_state_dict(state["replay"])
        self._steps, self._updates_due = int(state["steps"]), float(state["updates_due"])
        self._relaxed, self._noise.state = np.array(state["relaxed"]), np.array(state["noise"])
        self._action_rng.bit_generator.state = state["action_rng"]
        self._replay_rng.bit_generator.state = state["replay_rng"]


def relax(outputs: torch.Tensor, mask: torch.Tensor, relaxation: str) -> torch.Tensor:
    """The action vector that the critic sees for an actor's outputs.

    Args:
        outputs: (batch, actions), the actor's.
        mask: bool (batch, actions), legal actions.
        relaxation: `linear` gives the outputs themselves; `one-hot` the best legal action.

    Returns:
        float32 (batch, actions).
    """
    if relaxation == "linear":
        return outputs
    best = outputs.masked_fill(~mask, -torch.inf).argmax(dim=1)
    return functional.one_hot(best, outputs.shape[1]).to(outputs.dtype)
