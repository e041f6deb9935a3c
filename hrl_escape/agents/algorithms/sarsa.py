"""Deep SARSA over decisions of any duration: sampled or expected, online or with replay.

Zhao et al. (2016); expected SARSA is van Seijen et al. (2009).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.agents.algorithms.dqn import ActionValues, ValueAgent, ValueSettings
from hrl_escape.agents.components.exploration import compute_policy, sample_index
from hrl_escape.agents.components.replay import Experience, make_experience
from hrl_escape.agents.keras_rl_2019.keras_rl import LateTerminal
from hrl_escape.errors import AgentSettingsError
from hrl_escape.settings import Range


@dataclass(frozen=True)
class SarsaSettings(ValueSettings):
    """Backup, replay and targets of `sarsa`; without replay it makes one update a decision."""

    target_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.01
    target_every: Annotated[int, Range(1)] = 1
    average_rate: Annotated[float, Range(0, 1)] = 0.0
    expected: bool = True
    """Value s' by its expectation over the policy; otherwise by one action drawn from the policy, the very one
    taken next where there is no replay."""
    replay_capacity: Annotated[int, Range(0)] = 50_000
    """Decisions kept for replay; 0 learns from each decision once, as it comes."""
    late_terminal: bool = False
    """Repeat a mistake of keras-rl 0.4.2: the flag that the episode ended reaches the learner one decision early. The
    last decision but one is valued as if nothing followed, the last bootstraps even from a terminal state. Only
    without replay."""

    def check(self) -> None:
        """Refuse `late_terminal` together with replay, which knows no such mistake."""
        if self.late_terminal and self.replay_capacity:
            raise AgentSettingsError("SarsaSettings.late_terminal", True, "False, or replay_capacity = 0")


class Sarsa(ValueAgent):
    """Minimise the mean of loss(R + b V(s') - Q_theta(s, o)), V(s') = sum over o' of pi(o' | s') Q_target(s', o').

    pi is the exploring policy of the online network at s', over legal actions. With `expected` off, V(s') is
    Q_target(s', o') of one o' drawn from pi. R = sum gamma^i r_i, b = gamma^k (1 - terminated).
    """

    settings: SarsaSettings
    STATE = ("_next_action", "_late_terminal")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: SarsaSettings | None = None) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        self.values = ActionValues(self.name, self._encoder, action_space, seed, self.settings)
        self._next_action: int | None = None  # bootstrapped from, to be taken next
        self._late_terminal = LateTerminal()

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Explore as the settings say, or take the action that the last target was computed with."""
        action, self._next_action = self._next_action, None
        return self._explore(self._encoder.encode(observation), action_mask) if action is None else action

    def _explore(self, encoded: NDArray, action_mask: NDArray[np.bool_]) -> int:
        return self.values.explore(encoded, action_mask, self._schedule.steps, self._action_rng)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Learn from replay, or from this decision as it comes."""
        experience = make_experience(transition, self._encoder, self.settings)
        if self.settings.replay_capacity:
            self.replay.add(experience)
        metrics = self.make_due_updates(transition) | self.values.conduct
        if self.settings.replay_capacity:
            return metrics
        if self.settings.late_terminal:
            for late, taken in self._late_terminal.push(experience, transition, self.settings):
                if self._schedule.is_warm:
                    metrics |= self.update(_as_batch(late), self._choose_next(late) if taken is None else taken)
            return metrics
        next_action = self._choose_next(experience)
        self._next_action = None if transition.terminated or transition.truncated else next_action
        return metrics | (self.update(_as_batch(experience), next_action) if self._schedule.is_warm else {})

    def _choose_next(self, experience: Experience) -> int | None:
        """An action at s' to bootstrap from and to take next; None where the expectation over all is taken."""
        if self.settings.expected:
            return None
        return self._explore(experience.next_observation, experience.next_mask)

    def begin_streams(self, count: int, device: torch.device) -> None:
        """Begin episodes in all streams; raises `AgentSettingsError` without replay."""
        if not self.settings.replay_capacity:
            raise AgentSettingsError("replay_capacity", 0, "at least 1 in many environments at once")
        super().begin_streams(count, device)

    def compute_targets(self, batch: Experience, next_action: int | None = None) -> torch.Tensor:
        """R + b V(s'), (batch,); `next_action` is that taken at s', if known, in a batch of one."""
        next_online, next_mask = self.values.online(batch.next_observation).cpu().numpy(), batch.next_mask.cpu().numpy()
        weights = torch.from_numpy(self._compute_weights(next_online, next_mask, next_action)).to(batch.reward.device)
        return batch.reward + batch.bootstrap * (weights * self.values.target(batch.next_observation)).sum(dim=1)

    def _compute_weights(self, next_online: NDArray, next_mask: NDArray[np.bool_], next_action: int | None
                         ) -> NDArray[np.float32]:
        """Weight of each next action in V(s'), float32 (batch, actions)."""
        one_hot = np.eye(next_online.shape[1], dtype=np.float32)
        if next_action is not None and not self.settings.expected:
            return one_hot[[next_action]]
        next_values = next_online / self.settings.reward_scale
        policy = compute_policy(next_values, next_mask, self.settings, self._schedule.steps)
        if self.settings.expected:
            return policy.astype(np.float32)
        return one_hot[[sample_index(row, self._replay_rng) for row in policy]]


def _as_batch(experience: Experience) -> Experience:
    single = experience._replace(reward=np.float32(experience.reward), bootstrap=np.float32(experience.bootstrap))
    return Experience(*(np.asarray(field)[None] for field in single))
