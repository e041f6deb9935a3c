"""Base of agents that learn from replay and act in a Box, with hindsight where observations have goals."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import gymnasium
import torch

from hrl_escape.agents.agent import GoalRule
from hrl_escape.agents.components.box_actions import BoxActions
from hrl_escape.agents.components.goal_replay import GoalReplay
from hrl_escape.agents.components.replay import ReplayAgent
from hrl_escape.agents.decisions import Decisions, Moments


class BoxAgent(ReplayAgent):
    """Base class: random actions during the warm-up, then the actions of `explore`.

    Replay holds points of the cube [-1, 1]^n.

    Args:
        goal_rule: reward and termination of an environment with goals, for `hindsight_goals`.

    Attributes:
        box: bounds of the actions.
    """

    acts_in = ("box",)
    replay: Any

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int, settings: Any,
                 goal_rule: GoalRule | None = None) -> None:
        self._goal_rule = goal_rule
        super().__init__(observation_space, action_space, seed, settings)

    @property
    def box(self) -> BoxActions:
        """Bounds of the actions."""
        assert self._box is not None
        return self._box

    def make_replay(self, num_envs: int, device: torch.device | None) -> None:
        """Make an empty replay for some environments."""
        super().make_replay(num_envs, device)
        if self.settings.hindsight_goals:
            self.replay = GoalReplay(self._arrays, self.replay.capacity, self._encoder, self.box.size, num_envs,
                                     self._goal_rule, self.settings.hindsight_goals, self.settings.reward_scale)

    @abstractmethod
    def explore(self, batch: Moments) -> Any:
        """Choose points of the cube with exploration, (n, size)."""

    def act(self, batch: Moments) -> Any:
        """Return actions in the Box, float32 (n, ...)."""
        if self._schedule.is_warm:
            return self.box.scale(self.explore(batch))
        return self.box.scale(2 * self._arrays.draw_uniform(len(batch.env), self.box.size) - 1)

    def observe(self, batch: Decisions) -> Mapping[str, float]:
        """Store the decisions, then make the updates that are due."""
        experience = self.make_experience(batch)._replace(action=self.box.unscale(batch.action))
        if self.settings.hindsight_goals:
            self.replay.add_decisions(batch, experience, experience.action)
        else:
            self.replay.add(experience, batch.env, batch.terminated | batch.truncated)
        return self.make_due_updates(batch.duration)
