"""Deep agents that learn from replay: the schedule of updates, and the state that all of them keep.

A subclass makes its networks, acts, and improves them in `update`. Its clock counts primitives or decisions, as
`LearningSettings.clock` says.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import gymnasium

from hrl_escape.agents.agent import Agent, SMDPTransition, compute_backup, count_actions, count_steps
from hrl_escape.agents.components.exploration import EpsilonSettings, compute_epsilon, make_rng
from hrl_escape.agents.components.networks import NetworkSettings, ObservationEncoder
from hrl_escape.agents.components.replay import Experience, ReplayBuffer
from hrl_escape.agents.settings import LearningSettings
from hrl_escape.agents.state import StateTree
from hrl_escape.settings import Range

__all__ = ["ReplayAgent", "ReplaySettings"]


@dataclass(frozen=True)
class ReplaySettings(NetworkSettings, EpsilonSettings, LearningSettings):
    """Replay, target networks and the schedule of updates."""

    learning_rate: Annotated[float, Range(0, open_low=True)] = 3e-4
    """Step size of Adam."""
    target_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.01
    """Share of the online network blended into the target network at each update; 1 does without a target network."""
    replay_capacity: Annotated[int, Range(1)] = 50_000
    """Decisions kept for replay."""
    batch_size: Annotated[int, Range(1)] = 64
    """Decisions in an update from replay."""
    warmup: Annotated[int, Range(0)] = 500
    """Steps of the clock before the first update."""
    updates_per_step: Annotated[float, Range(0)] = 0.25
    """Updates for each step of the clock; an option of 16 primitives is followed by 16 times as many."""
    loss: Literal["huber", "squared"] = "huber"
    """Loss of action values: Huber with threshold 1 (in scaled rewards), or half the squared error."""


class ReplayAgent(Agent):
    """Base of deep agents with replay.

    Args:
        observation_space: of the environment.
        action_space: Discrete.
        seed: fixes weights, exploration and batches.
        settings: of the agent.
        keeps_vectors: replay holds an action as a vector (actions,) instead of an index.

    Attributes:
        name: of the algorithm, for messages.
        replay: the decisions kept.
    """

    name: ClassVar[str]

    def __init__(
        self,
        observation_space: gymnasium.Space,
        action_space: gymnasium.Space,
        seed: int,
        settings: ReplaySettings | None,
        keeps_vectors: bool = False,
    ) -> None:
        self.settings = settings or self.Settings()
        self._actions = actions = count_actions(action_space, self.name)
        self._encoder = encoder = ObservationEncoder(observation_space, self.settings.scale_observations)
        self.replay = ReplayBuffer(
            self.settings.replay_capacity,
            encoder.shape,
            encoder.dtype,
            actions,
            action_shape=(actions,) if keeps_vectors else (),
        )
        self._action_rng, self._replay_rng = make_rng(seed, "actions"), make_rng(seed, "replay")
        self._steps, self._updates_due = 0, 0.0

    @abstractmethod
    def update(self, batch: Experience) -> Mapping[str, float]:
        """One gradient step on a batch of numpy arrays; returns numbers to log."""

    @property
    def warmup(self) -> int:
        """Steps of the clock before the first update."""
        return self.settings.warmup

    def make_experience(self, transition: SMDPTransition, bonus: float = 0.0) -> Experience:
        """The backup of a decision, in scaled rewards.

        Args:
            transition: the decision.
            bonus: added to its reward, in units of return.
        """
        reward, bootstrap = compute_backup(transition, self.settings)
        return Experience(
            self._encoder.encode(transition.observation),
            transition.action_mask,
            transition.action,
            (reward + bonus) * self.settings.reward_scale,
            bootstrap,
            self._encoder.encode(transition.next_observation),
            transition.next_action_mask,
        )

    def advance_clock(self, transition: SMDPTransition) -> int:
        """Count a decision; returns its steps of the clock."""
        steps = count_steps(transition, self.settings)
        self._steps += steps
        return steps

    def learn_from_replay(self, transition: SMDPTransition) -> dict[str, float]:
        """Make the updates that are due after a decision; returns numbers to log."""
        steps = self.advance_clock(transition)
        metrics = {"epsilon": compute_epsilon(self.settings, self._steps)}
        if self._steps > self.warmup and len(self.replay):
            self._updates_due += steps * self.settings.updates_per_step
            while self._updates_due >= 1:
                self._updates_due -= 1
                metrics |= self.update(self.replay.sample(self.settings.batch_size, self._replay_rng))
        return metrics

    def state_dict(self) -> StateTree:
        """Replay, counters, generators."""
        return {
            "replay": self.replay.state_dict(),
            "steps": self._steps,
            "updates_due": self._updates_due,
            "action_rng": self._action_rng.bit_generator.state,
            "replay_rng": self._replay_rng.bit_generator.state,
        }

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`."""
        self.replay.load_state_dict(state["replay"])
        self._steps, self._updates_due = int(state["steps"]), float(state["updates_due"])
        self._action_rng.bit_generator.state = state["action_rng"]
        self._replay_rng.bit_generator.state = state["replay_rng"]
