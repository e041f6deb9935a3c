"""Replay with hindsight for one environment or thousands: goals are replaced when decisions are drawn.

Andrychowicz et al. (2017), strategy `future`: with probability k / (k + 1) a drawn decision gets a goal that was
achieved by it or later in its episode, and reward and termination are computed again. Decisions of one environment
are stored in consecutive places of its own row, so the later ones are found without a search.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.spaces.utils import flatdim

from hrl_escape.agents.agent import GoalRule
from hrl_escape.agents.components.arrays import Arrays
from hrl_escape.agents.components.networks import ObservationEncoder, is_goal_space, split_goals
from hrl_escape.agents.components.replay import Experience
from hrl_escape.agents.decisions import Decisions
from hrl_escape.agents.state import Stateful
from hrl_escape.errors import AgentSettingsError, StepContractError


def read_goals(space: gymnasium.Space, observation: Any, name: str) -> torch.Tensor:
    """Return a goal of n observations, `achieved_goal` or `desired_goal`, (n, size), in their own units."""
    if isinstance(observation, torch.Tensor):
        return split_goals(space, observation)[name]
    return torch.from_numpy(np.stack([np.asarray(each[name]).reshape(-1) for each in observation]))


def apply_rule(rule: Any, achieved: torch.Tensor, desired: torch.Tensor, dtype: torch.dtype) -> torch.Tensor:
    """Return a function of `GoalRule` for n pairs of goals, (n,).

    It is called once with all goals, as Gymnasium-Robotics' `compute_reward` allows, and row by row if its result has
    no entry for each.
    """
    pairs = achieved.cpu().numpy(), desired.cpu().numpy()
    result = np.asarray(rule(*pairs, {}))
    if result.shape != (len(achieved),):
        result = np.array([rule(*pair, {}) for pair in zip(*pairs, strict=True)])
    return torch.from_numpy(result).to(achieved.device, dtype)


class GoalReplay(Stateful):
    """The last decisions of each environment, drawn evenly, with goals of `goal_rule` replaced in hindsight.

    Args:
        arrays: source of randomness, and library of the batches.
        capacity: number of decisions of all environments together.
        encoder: of the observations, a Dict with goals.
        actions: number of components of an action.
        num_envs: number of environments.
        rule: reward and termination as functions of the goals.
        goals: replaced goals for each original one.
        scale: factor on rewards.

    Raises:
        AgentSettingsError: the environment has no goals.
    """

    STATE = ("_rows", "_count", "_begin", "_end")

    def __init__(self, arrays: Arrays, capacity: int, encoder: ObservationEncoder, actions: int, num_envs: int,
                 rule: GoalRule | None, goals: int, scale: float) -> None:
        if rule is None or not is_goal_space(encoder.space):
            raise AgentSettingsError(
                "hindsight_goals", goals, "0, because the environment has no goals. Goals require a Dict of "
                "observation, achieved_goal and desired_goal, and the methods compute_reward and "
                "compute_terminated, as in Gymnasium-Robotics")
        self._arrays, self._encoder, self._rule, self._share = arrays, encoder, rule, goals / (goals + 1)
        self._scale, self._length = scale, max(2, capacity // num_envs)
        size = flatdim(encoder.space["achieved_goal"])
        place = self._length * num_envs

        def zeros(*shape: int) -> torch.Tensor:
            return torch.zeros((place, *shape), device=arrays.device)

        self._rows = {"observation": zeros(*encoder.shape), "action": zeros(actions), "discount": zeros(),
                      "reward": zeros(), "bootstrap": zeros(), "terminated": zeros(), "truncated": zeros(),
                      "next_observation": zeros(*encoder.shape), "achieved": zeros(size).double(),
                      "desired": zeros(size).double()}
        self._count = torch.zeros(num_envs, dtype=torch.int64, device=arrays.device)  # decisions of each environment
        self._begin = torch.zeros_like(self._count)  # number of the first decision of its episode
        self._end = torch.full((place,), -1, device=arrays.device)  # last number of the episode, -1 while it runs

    def __len__(self) -> int:
        return int(self._count.clamp(max=self._length).sum())

    def begin_episodes(self) -> None:
        """Begin an episode in every environment; decisions of unfinished episodes keep their goals."""
        self._begin.copy_(self._count)

    def add_decisions(self, batch: Decisions, experience: Experience, unit: Any) -> None:
        """Store decisions with their backups; `unit` is the action as a point of the cube, (n, size).

        Raises:
            StepContractError: a decision ran several primitives; goals achieved inside it are unknown.
        """
        longest = int(batch.duration.max())
        if longest > 1:
            raise StepContractError(f"a decision ran {longest} primitives; hindsight_goals need decisions of one "
                                    "primitive. Set hindsight_goals to 0")
        env = torch.as_tensor(batch.env)
        place = env * self._length + self._count[env] % self._length
        over = torch.as_tensor(batch.terminated | batch.truncated)
        space = self._encoder.space
        given = {"observation": experience.observation, "action": unit, "discount": batch.discount,
                 "reward": experience.reward, "bootstrap": experience.bootstrap, "terminated": batch.terminated,
                 "truncated": batch.truncated, "next_observation": experience.next_observation,
                 "achieved": read_goals(space, batch.next_observation, "achieved_goal"),
                 "desired": read_goals(space, batch.next_observation, "desired_goal")}
        for name, rows in self._rows.items():
            rows[place] = torch.as_tensor(given[name]).to(rows.dtype)
        self._end[place] = -1
        ended = env[over]
        for each, begin, last in zip(ended.tolist(), self._begin[ended].tolist(), self._count[ended].tolist(),
                                     strict=True):
            numbers = torch.arange(max(begin, last - self._length + 1), last + 1, device=env.device)
            self._end[each * self._length + numbers % self._length] = last
        self._count[env] += 1
        self._begin[ended] = self._count[ended]

    def sample(self, batch: int) -> Experience:
        """Draw backups of one decision, (batch, ...), most of them with goals achieved later."""
        draw, length = self._arrays.draw_uniform, self._length
        stored = self._count.clamp(max=length)
        row = torch.as_tensor(draw(4, batch))
        ends = stored.cumsum(0)
        number = (row[0].double() * ends[-1]).long().clamp(max=int(ends[-1]) - 1)
        env = torch.searchsorted(ends, number, right=True)
        age = number - ends[env] + stored[env]  # 0 for the oldest decision of the environment
        own = self._count[env] - stored[env] + age
        place = env * length + own % length
        last = self._end[place]
        later = own + (row[1].double() * (last - own + 1)).long().clamp(min=0)
        later = torch.minimum(later, last.clamp(min=0))
        is_replaced = (row[2] < self._share) & (last >= 0)
        found = {name: rows.index_select(0, place) for name, rows in self._rows.items()}
        goal = self._rows["achieved"][env * length + later % length]
        return self._relabel(found, goal, is_replaced)

    def _relabel(self, found: dict[str, torch.Tensor], goal: torch.Tensor, is_replaced: torch.Tensor) -> Experience:
        """Replace some goals, and compute reward and termination again; ends for other reasons stay ends."""
        reward, bootstrap = found["reward"], found["bootstrap"]
        rows = is_replaced.nonzero().squeeze(1)
        if len(rows):
            achieved, desired, goal = found["achieved"][rows], found["desired"][rows], goal[rows]
            rule, dtype = self._rule, torch.float32
            reward[rows] = apply_rule(rule.compute_reward, achieved, goal, dtype) * self._scale
            reached = apply_rule(rule.compute_terminated, achieved, goal, torch.bool)
            otherwise = (found["terminated"][rows] > 0) & ~apply_rule(rule.compute_terminated, achieved, desired,
                                                                    torch.bool)
            bootstrap[rows] = found["discount"][rows] * ~(reached | otherwise)
            encoded = self._encoder.encode_goals(goal)
            for name in ("observation", "next_observation"):
                found[name][rows, -encoded.shape[1]:] = encoded
        none = torch.ones((len(reward), 0), dtype=torch.bool, device=reward.device)
        return Experience(found["observation"], none, found["action"], reward, bootstrap, found["next_observation"],
                          none)
