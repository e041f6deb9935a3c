"""Many copies of a room, and counts of what happens in them: escapes, their efficiency, the first of them.

`WatchedEnvs` counts for every agent alike, for any kind of decisions: primitives, repeats, planned walks or learned
options. `OptionEnvs` makes frozen options the actions.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import torch
from torch import Tensor

from hrl_escape.agents.agent import set_option_discount
from hrl_escape.agents.components.arrays import draw_rows
from hrl_escape.agents.components.networks import ObservationEncoder
from hrl_escape.agents.components.option_networks import OptionRolloutAgent
from hrl_escape.agents.components.policy_gradient import take_column
from hrl_escape.agents.many_envs import EndedDecisions
from hrl_escape.agents.state import StateTree

__all__ = ["OptionEnvs", "WatchedEnvs"]


class _Around:
    """Parts of many environments that stay as they are around them."""

    def __init__(self, envs: Any) -> None:
        self._envs, self.count, self.observation_space = envs, envs.count, envs.observation_space

    @property
    def gamma(self) -> float:
        """Discount per primitive."""
        return self._envs.gamma

    @property
    def device(self) -> torch.device:
        """Device of all tensors."""
        return self._envs.device

    @property
    def observation(self) -> Tensor:
        """Observations now, (environments, ...)."""
        return self._envs.observation

    def describe(self) -> Mapping[str, Any]:
        """Arguments of the environments, as JSON values."""
        return self._envs.describe()


class WatchedEnvs(_Around):
    """Many environments, and counts of their episodes in equal parts of a budget.

    Args:
        envs: `ManyEnvs`.
        fewest: primitives of the best known escape from the room.
        budget: primitives of the run.
        parts: of the budget.
    """

    def __init__(self, envs: Any, fewest: int, budget: int, parts: int) -> None:
        super().__init__(envs)
        self._fewest, self._budget, self._parts = fewest, budget, parts
        self.action_space = envs.action_space
        self.primitives = 0
        """Primitives of the decisions that ended."""
        self.first_escape: int | None = None
        """These primitives when the first episode escaped."""
        self.totals = torch.zeros((parts, 3), dtype=torch.float64)
        """Episodes that ended in each part, escapes among them, and the sum of their efficiency, (parts, 3)."""

    @property
    def action_mask(self) -> Tensor:
        """Actions legal now, bool (environments, actions)."""
        return self._envs.action_mask

    @property
    def is_waiting(self) -> Tensor:
        """Environments that take an action, bool (environments,)."""
        return self._envs.is_waiting

    def set_option_discount(self, gamma: float) -> None:
        """Set the discount per primitive of environments with options."""
        set_option_discount(self._envs, gamma)

    def state_dict(self) -> None:
        """Episodes are not saved: a run that was stopped is made again."""

    def load_state_dict(self, state: StateTree) -> None:
        """Never called, because there is no state."""

    def reset(self, seeds: int) -> None:
        """Begin all episodes."""
        self._envs.reset(seeds)
        self._lengths = torch.zeros(self.count, dtype=torch.int64, device=self.device)

    def step(self, action: Tensor) -> Any:
        """Run one primitive in every environment, and count."""
        done = self._envs.step(action)
        spent = torch.where(done.where, done.duration, 0)
        self._lengths += spent
        self.primitives += int(spent.sum())
        over = done.where & (done.terminated | done.truncated)
        if bool(over.any()):
            escaped = over & done.terminated & (done.success > 0)
            worth = torch.where(escaped, self._fewest / self._lengths.clamp(min=self._fewest), 0.0)
            part = min(self._parts - 1, (self.primitives - 1) * self._parts // self._budget)
            self.totals[part] += torch.stack((over.sum(), escaped.sum(), worth.sum())).double().cpu()
            if self.first_escape is None and bool(escaped.any()):
                self.first_escape = self.primitives
            self._lengths = torch.where(over, 0, self._lengths)
        return done


class OptionEnvs(_Around):
    """Many environments whose actions are the options that an agent has learned, which no longer change.

    An option ends by its termination, after `longest` primitives, or with the episode.

    Args:
        envs: `ManyEnvs` over primitives, with the observation that the agent was trained with.
        agent: that learned the options.
        longest: most primitives of an option.
    """

    def __init__(self, envs: Any, agent: OptionRolloutAgent, longest: int) -> None:
        super().__init__(envs)
        self._heads, self._longest = agent.heads, longest
        self._encoder = ObservationEncoder(envs.observation_space, agent.settings.scale_observations)
        self.action_space = gymnasium.spaces.Discrete(agent.options)

    @property
    def action_mask(self) -> Tensor:
        """Every option is legal everywhere, bool (environments, options)."""
        return torch.ones((self.count, int(self.action_space.n)), dtype=torch.bool, device=self.device)

    @property
    def is_waiting(self) -> Tensor:
        """Environments whose option has ended, bool (environments,)."""
        return (self._option < 0) & self._envs.is_waiting

    def reset(self, seeds: int) -> None:
        """Begin all episodes; the options' draws follow the seeds."""
        self._envs.reset(seeds)
        self._generator = torch.Generator(self.device).manual_seed(seeds)
        self._option = torch.full((self.count,), -1, device=self.device)
        self._duration, self._begun = torch.zeros_like(self._option), self.observation
        self._sums = torch.zeros((2, self.count), device=self.device)

    def step(self, action: Tensor) -> EndedDecisions:
        """Run one primitive of every option; decisions that ended with it are in `where`."""
        asked = self.is_waiting
        self._option = torch.where(asked, action, self._option)
        self._duration = torch.where(asked, 0, self._duration)
        self._sums[:, asked] = 0.0
        self._begun = torch.where(asked[:, None], self.observation, self._begun)
        option = self._option.clamp(min=0)
        with torch.no_grad():
            seen = self._encoder.encode_many(self.observation)
            log_policy = self._heads.compute_log_policies(seen, option, self._envs.action_mask)
            done = self._envs.step(draw_rows(log_policy.exp(), self._generator))
            betas = take_column(self._heads.compute_betas(self._encoder.encode_many(done.next_observation)), option)
        reward = torch.where(done.where, done.reward, 0.0)
        self._sums += torch.stack((reward, reward * self.gamma ** self._duration.float()))
        self._duration = self._duration + done.where.long()
        draws = torch.rand(self.count, generator=self._generator, device=self.device)
        over = done.terminated | done.truncated | (draws < betas) | (self._duration >= self._longest)
        ended = done.where & over
        self._option = torch.where(ended, -1, self._option)
        every = self.action_mask
        return done._replace(where=ended, observation=self._begun, action=option, reward=self._sums[0].clone(),
                             discounted_reward=self._sums[1].clone(), duration=self._duration.clamp(min=1),
                             next_action_mask=every)
