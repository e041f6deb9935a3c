"""Deep Q-network over decisions of any duration: double, masked, optionally n-step.

Mnih et al. (2015) with double estimation (van Hasselt, Guez and Silver 2016) on SMDP backups. The
recipe `paper` is keras-rl 0.4.2's DQNAgent as the published program configured it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from hrl_escape.agents.agent import SMDPTransition, StateTree, compute_backup, count_actions, count_steps
from hrl_escape.agents.bonuses import BonusSettings, CountBonus
from hrl_escape.agents.exploration import (
    ExplorationSettings,
    choose_best,
    compute_epsilon,
    make_rng,
    sample_action,
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
from hrl_escape.agents.replay import Experience, NStep, ReplayBuffer
from hrl_escape.agents.settings import LearningSettings, Range
from hrl_escape.agents.stacking import JointLearner, NetworkStack, finish_updates
from hrl_escape.agents.updates import Metrics, Updates, run_alone
from hrl_escape.errors import DivergenceError

__all__ = ["DQN", "DQNSettings", "DQNTogether", "compute_dqn_targets"]


@dataclass(frozen=True)
class DQNSettings(BonusSettings, NetworkSettings, ExplorationSettings, LearningSettings):
    """Settings of `dqn`."""

    learning_rate: Annotated[float, Range(0, open_low=True)] = 3e-4
    """Step size of Adam."""
    double: bool = True
    """The online network chooses the next action, the target network values it."""
    target_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.01
    """Share of the online network blended into the target network at each update; 1 does without a target network."""
    replay_capacity: Annotated[int, Range(1)] = 50_000
    """Decisions kept for replay."""
    batch_size: Annotated[int, Range(1)] = 64
    """Decisions in an update."""
    warmup: Annotated[int, Range(0)] = 500
    """Steps of the clock before the first update."""
    updates_per_step: Annotated[float, Range(0)] = 0.25
    """Updates for each step of the clock; an option of 16 primitives is followed by 16 times as many."""
    n_step: Annotated[int, Range(1)] = 1
    """Decisions joined into one backup; above 1 it is off-policy by the share of exploration."""
    loss: Literal["huber", "squared"] = "huber"
    """Huber loss with threshold 1 (in scaled rewards), or half the squared error."""


PAPER = DQNSettings(
    discounting="decision",
    bootstrap_on_truncation=False,
    clock="decision",
    exploration="boltzmann",
    hidden=(16, 16, 16),
    initialisation="glorot",
    learning_rate=1e-3,
    adam_epsilon=1e-7,
    max_grad_norm=0.0,
    scale_observations=False,
    reward_scale=1.0,
    batch_size=32,
    warmup=1_000,
    updates_per_step=1.0,
    loss="squared",
)


class DQN:
    """Minimise over theta the mean of loss(R + b Q_target(s', o*) - Q_theta(s, o)), o* = argmax of Q_theta(s', .).

    R = sum gamma^i r_i, b = gamma^k (1 - terminated), the argmax over actions legal at s'. With `n_step` n, R and b are
    those of n decisions joined. Without `double`, o* is the argmax of Q_target.
    """

    Settings: ClassVar[type] = DQNSettings
    recipes: ClassVar[Mapping[str, DQNSettings]] = {
        "corrected": DQNSettings(),
        "paper": PAPER,
        "smdp-paper": replace(PAPER, hidden=(3, 3, 3)),  # the program's width with meta-actions on
    }

    def __init__(
        self,
        observation_space: gymnasium.Space,
        action_space: gymnasium.Space,
        seed: int,
        settings: DQNSettings | None = None,
    ) -> None:
        self.settings = settings = settings or DQNSettings()
        actions = count_actions(action_space, "dqn")
        self._encoder = ObservationEncoder(observation_space, settings.scale_observations)
        generator = make_generator(make_rng(seed, "weights"))
        self.online = make_network(self._encoder, actions, settings, generator)
        self.target = make_network(self._encoder, actions, settings, generator).requires_grad_(False)
        self.target.blend(self.online, 1.0)
        self._forward = make_forward(self.online)
        self._learner = Learner("dqn", {"online": self.online, "target": self.target}, ["online"], settings)
        self.replay = ReplayBuffer(settings.replay_capacity, self._encoder.shape, self._encoder.dtype, actions)
        self._n_step = NStep(settings.n_step)
        self._bonus = CountBonus(observation_space, settings, "dqn")
        self._action_rng, self._replay_rng = make_rng(seed, "actions"), make_rng(seed, "replay")
        self._steps, self._updates_due = 0, 0.0

    @property
    def gamma(self) -> float:
        """Discount per primitive."""
        return self.settings.gamma

    def compute_values(self, observation: Any) -> NDArray:
        """Q(s, .) at an observation, in units of return, float32 (actions,)."""
        return self._forward(self._encoder.encode(observation)) / self.settings.reward_scale

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Explore as the settings say."""
        values = self.compute_values(observation)
        return sample_action(values, action_mask, self.settings, self._steps, self._action_rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The legal action of highest value."""
        return choose_best(self.compute_values(observation), action_mask)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Store the decision, then make the updates that are due."""
        return run_alone(self.learn(transition), self._update)

    def learn(self, transition: SMDPTransition) -> Updates:
        """As `observe`; hands out each update as rows of its replay."""
        reward, bootstrap = compute_backup(transition, self.settings)
        reward += self._bonus.visit(transition.next_observation)
        experience = Experience(
            self._encoder.encode(transition.observation),
            transition.action_mask,
            transition.action,
            reward * self.settings.reward_scale,
            bootstrap,
            self._encoder.encode(transition.next_observation),
            transition.next_action_mask,
        )
        for joined in self._n_step.push(experience, transition.terminated or transition.truncated):
            self.replay.add(joined)
        steps = count_steps(transition, self.settings)
        self._steps += steps
        metrics: Metrics = {"epsilon": compute_epsilon(self.settings, self._steps)}
        if self._steps > self.settings.warmup and len(self.replay):
            self._updates_due += steps * self.settings.updates_per_step
            while self._updates_due >= 1:
                self._updates_due -= 1
                metrics |= yield self.replay.draw(self.settings.batch_size, self._replay_rng)
        return metrics

    def _update(self, rows: NDArray[np.int64]) -> Metrics:
        loss, values = self.compute_loss(self.replay.take(rows))
        value = self._learner.minimise(loss)
        self._blend()
        return {"loss": value, "value": values.mean().item() / self.settings.reward_scale}

    def _blend(self) -> None:
        self.target.blend(self.online, self.settings.target_rate)

    def compute_loss(self, batch: Experience) -> tuple[torch.Tensor, torch.Tensor]:
        """The loss over a batch of numpy arrays, and Q_theta(s, o), (batch,), without gradient."""
        return compute_dqn_loss(self.online, self.target, batch, self.settings)

    @staticmethod
    def make_together(agents: Sequence[DQN]) -> DQNTogether:
        """What makes the updates of several such agents at once."""
        return DQNTogether(agents)

    def state_dict(self) -> StateTree:
        """Networks, optimiser, replay, counters, generators."""
        return {
            "learner": self._learner.state_dict(),
            "replay": self.replay.state_dict(),
            "n_step": self._n_step.state_dict(),
            "bonus": self._bonus.state_dict(),
            "steps": self._steps,
            "updates_due": self._updates_due,
            "action_rng": self._action_rng.bit_generator.state,
            "replay_rng": self._replay_rng.bit_generator.state,
        }

    def load_state_dict(self, state: StateTree) -> None:
        """Restore what `state_dict` gave."""
        self._learner.load_state_dict(state["learner"])
        self.replay.load_state_dict(state["replay"])
        self._n_step.load_state_dict(state["n_step"])
        self._bonus.load_state_dict(state["bonus"])
        self._steps, self._updates_due = int(state["steps"]), float(state["updates_due"])
        self._action_rng.bit_generator.state = state["action_rng"]
        self._replay_rng.bit_generator.state = state["replay_rng"]


class DQNTogether:
    """The updates of several DQN agents, of the same settings, as one; see `updates.Together`."""

    def __init__(self, agents: Sequence[DQN]) -> None:
        self._agents = agents
        self._learner = JointLearner([agent._learner for agent in agents])

    def update(self, requests: Sequence[NDArray[np.int64]]) -> list[Metrics | DivergenceError]:
        """One update of each from rows of its own replay."""
        agents, settings = self._agents, self._agents[0].settings
        online = NetworkStack([agent.online for agent in agents], with_gradient=True)
        target = NetworkStack([agent.target for agent in agents])
        batch = ReplayBuffer.take_together([agent.replay for agent in agents], requests)
        losses, values = compute_dqn_loss(online, target, batch, settings)
        outcomes = self._learner.minimise(losses, online)
        return finish_updates(outcomes, values, settings.reward_scale, [agent._blend for agent in agents])


def compute_dqn_loss(
    online: Callable[[torch.Tensor], torch.Tensor],
    target: Callable[[torch.Tensor], torch.Tensor],
    batch: Experience,
    settings: DQNSettings,
) -> tuple[torch.Tensor, torch.Tensor]:
    """The mean loss over a batch, and Q_theta(s, o) without gradient.

    Args:
        online: Q_theta of observations.
        target: Q_target of observations.
        batch: numpy arrays (batch, ...), or (trials, batch, ...) for stacked networks.
        settings: kind of target and loss.

    Returns:
        (), (batch,), or (trials,), (trials, batch).
    """
    observation, _, action, reward, bootstrap, next_observation, next_mask = map(torch.from_numpy, batch)
    with torch.no_grad():
        next_values = target(next_observation)
        next_choice = online(next_observation) if settings.double else next_values
        targets = compute_dqn_targets(reward, bootstrap, next_choice, next_values, next_mask)
    values = online(observation).gather(-1, action.unsqueeze(-1)).squeeze(-1)
    return compute_td_loss(values, targets, settings.loss), values.detach()


def compute_dqn_targets(
    reward: torch.Tensor,
    bootstrap: torch.Tensor,
    next_choice: torch.Tensor,
    next_values: torch.Tensor,
    next_mask: torch.Tensor,
) -> torch.Tensor:
    """R + b Q(s', argmax over legal o' of choice(s', o')).

    Args:
        reward: float32 (..., batch), R.
        bootstrap: float32 (..., batch), b.
        next_choice: (..., batch, actions), values that choose the next action.
        next_values: (..., batch, actions), values that judge it.
        next_mask: bool (..., batch, actions), legal at s'.

    Returns:
        float32 (..., batch).
    """
    best = next_choice.masked_fill(~next_mask, -torch.inf).argmax(dim=-1, keepdim=True)
    return reward + bootstrap * next_values.gather(-1, best).squeeze(-1)
