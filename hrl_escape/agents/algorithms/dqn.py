"""Deep Q-network over decisions of any duration: double, masked, n-step.

Mnih et al. (2015) with double estimation (van Hasselt, Guez and Silver 2016) on SMDP backups of n decisions (Sutton
1988; Hessel et al. 2018). A useless decision costs one reward and one discount, little beside the values' range, so
the greedy policy hangs on small differences: it holds what it found better where the target stands still long enough
to be fitted and n decisions carry values ahead of it (`benchmarks/README.md`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

import gymnasium
import torch

from hrl_escape.agents.agent import SMDPTransition, StateTree
from hrl_escape.agents.components.action_value_agent import ActionValueAgent, ActionValueSettings
from hrl_escape.agents.components.distillation import DeepBonusSettings, make_bonus
from hrl_escape.agents.components.replay import Experience, NStep
from hrl_escape.settings import Range

__all__ = ["DQN", "DQNSettings"]


@dataclass(frozen=True)
class DQNSettings(DeepBonusSettings, ActionValueSettings):
    """Settings of `dqn`."""

    double: bool = True
    """The online network chooses the next action, the target network values it."""
    n_step: Annotated[int, Range(1)] = 3
    """Decisions joined into one backup; above 1 it is off-policy by the share of exploration."""
    target_rate: Annotated[float, Range(0, 1, open_low=True)] = 1.0
    """Share of the online network blended into the target network at each of its updates; 1 copies it."""
    target_every: Annotated[int, Range(1)] = 200
    """Updates of the online network to one of the target network."""
    average_rate: Annotated[float, Range(0, 1)] = 0.005
    """Share of the online network blended, at each update, into the averaged network that the greedy policy follows;
    0 keeps none."""


class DQN(ActionValueAgent):
    """Minimise over theta the mean of loss(R + b Q_target(s', o*) - Q_theta(s, o)), o* = argmax of Q_theta(s', .).

    R = sum gamma^i r_i, b = gamma^k (1 - terminated), the argmax over actions legal at s'. With `n_step` n, R and b are
    those of n decisions joined. Without `double`, o* is the argmax of Q_target.
    """

    name: ClassVar[str] = "dqn"
    Settings: ClassVar[type] = DQNSettings
    settings: DQNSettings

    def __init__(
        self,
        observation_space: gymnasium.Space,
        action_space: gymnasium.Space,
        seed: int,
        settings: DQNSettings | None = None,
    ) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        self._n_step = NStep(self.settings.n_step)
        self._bonus = make_bonus(observation_space, seed, self.settings, self.settings, self.name)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Store the decision, then make the updates that are due."""
        experience = self.make_experience(transition, self._bonus.visit(transition.next_observation))
        for joined in self._n_step.push(experience, transition.terminated or transition.truncated):
            self.replay.add(joined)
        return self.learn_from_replay(transition)

    def compute_targets(self, batch: Experience, next_action: int | None) -> torch.Tensor:
        """R + b Q_target(s', o*), o* = argmax over legal o of Q_theta(s', o)."""
        del next_action  # off policy
        next_values = self.target(batch.next_observation)
        next_choice = self.online(batch.next_observation) if self.settings.double else next_values
        best = next_choice.masked_fill(~batch.next_mask, -torch.inf).argmax(dim=1, keepdim=True)
        return batch.reward + batch.bootstrap * next_values.gather(1, best).squeeze(1)

    def state_dict(self) -> StateTree:
        """Unfinished n-step backups and the bonus's memory beside networks, replay, counters and generators."""
        return super().state_dict() | {"n_step": self._n_step.state_dict(), "bonus": self._bonus.state_dict()}

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`."""
        super().load_state_dict(state)
        self._n_step.load_state_dict(state["n_step"])
        self._bonus.load_state_dict(state["bonus"])
