"""Flat agents, their runs, and actions repeated in many copies of a room. Several studies share them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from hrl_escape.agents.many_envs import EndedDecisions
from hrl_escape.agents.registry import get_recipe
from hrl_escape.agents.state import StateTree
from hrl_escape.agents.training.many_envs import VectorManyEnvs
from hrl_escape.settings import read_record, replace_settings
from studies.statistics import find_lasting
from studies.store import Line

__all__ = ["FlatLearner", "FlatRun", "RepeatedStreams", "TENTHS", "count_untrained", "read_learner"]

TENTHS = 10
ARCHIVE = "archive"
"""Name of the learner that is not an agent."""


@dataclass(frozen=True)
class FlatLearner:
    """A learner over primitives.

    Attributes:
        label: in tables.
        agent: name, or `ARCHIVE`.
        settings: fields to change.
        streams: copies of the room that it learns in at once; 0 for one ordinary environment.
        repeat: repetitions of each chosen action, in primitives; only with streams.
    """

    label: str
    agent: str
    settings: dict[str, Any] = field(default_factory=dict)
    streams: int = 64
    repeat: int = 1


@dataclass(frozen=True)
class FlatRun(Line):
    """Result of a run.

    Attributes:
        agent: label of the learner.
        buttons: of the room.
        seed: of training; chooses the room where the study has several.
        fewest: primitives of the best known escape.
        budget: primitives; a run that ended early has spent what its last evaluation says.
        first_escape: primitives, of all streams together, at the end of the first training episode that escaped, or
            None without one.
        curve: (primitives, efficiency) of each evaluation of the greedy policy.
        escapes: share of training episodes that escaped, in each tenth of the run, or None if none ended.
        corners: share of the primitives in corners (beyond 0.8 of the way from the middle to two walls, 4 % of the
            floor), in each tenth; empty of one ordinary environment.
        entropy: of the policy that trains, nats, in each tenth; empty where the agent logs none.
        seconds: of processor time.
        key: hash of everything that decides the numbers.
    """

    agent: str
    buttons: int
    seed: int
    fewest: int
    budget: int
    first_escape: int | None
    curve: tuple[tuple[int, float], ...]
    escapes: tuple[float | None, ...]
    corners: tuple[float, ...]
    entropy: tuple[float, ...]
    seconds: float
    key: str

    PLACE = ("agent", "buttons", "seed", "budget")

    @property
    def efficiency(self) -> float:
        """Mean of the evaluations in the last fifth."""
        return float(np.mean([value for at, value in self.curve if at >= 0.8 * self.budget]))

    @property
    def spent(self) -> int:
        """Primitives that it trained for."""
        return self.curve[-1][0]

    def find_threshold(self, least: float) -> int | None:
        """Primitives at the first of two evaluations in a row of at least this efficiency, or None."""
        return find_lasting(self.curve, least)


class RepeatedStreams:
    """Many environments that repeat every action for some primitives.

    A decision lasts `repeat` primitives, or to the end of its episode; streams decide at their own pace.

    Args:
        env: vector environment of one room, with tensors.
        repeat: primitives of a decision, 1 or more.
        gamma: discount per primitive.
    """

    def __init__(self, env: Any, repeat: int, gamma: float) -> None:
        self._env, self._inner, self._repeat = env, VectorManyEnvs(env, gamma), repeat
        self.count, self.gamma = env.num_envs, gamma
        self.observation_space, self.action_space = env.single_observation_space, env.single_action_space

    @property
    def device(self) -> torch.device:
        """Device of all tensors."""
        return self._inner.device

    @property
    def observation(self) -> Tensor:
        """Observations now, (streams, ...)."""
        return self._inner.observation

    @property
    def action_mask(self) -> Tensor:
        """Actions legal now, bool (streams, actions)."""
        return self._inner.action_mask

    @property
    def is_waiting(self) -> Tensor:
        """Streams whose last decision is over, bool (streams,)."""
        return (self._left == 0) & self._inner.is_waiting

    def describe(self) -> Mapping[str, Any]:
        """Arguments that decide the numbers, as JSON values."""
        return {**self._env.unwrapped.describe(), "repeat": self._repeat}

    def reset(self, seeds: int) -> None:
        """Begin all episodes anew."""
        self._inner.reset(seeds)
        zero = torch.zeros(self.count, dtype=torch.int64, device=self.device)
        self._left, self._action, self._duration = zero, zero.clone(), zero.clone()
        self._begun = self.observation
        self._sums = torch.zeros((2, self.count), device=self.device)

    def step(self, action: Tensor) -> EndedDecisions:
        """Run one primitive in every stream; decisions that ended with it are in `where`."""
        asked = self.is_waiting
        self._action = torch.where(asked, action, self._action)
        self._left = torch.where(asked, self._repeat, self._left)
        self._duration = torch.where(asked, 0, self._duration)
        self._sums[:, asked] = 0.0
        self._begun = torch.where(asked[:, None], self.observation, self._begun)
        done = self._inner.step(self._action)
        reward = torch.where(done.where, done.reward, 0.0)
        self._sums += torch.stack((reward, reward * self.gamma ** self._duration.float()))
        self._duration, over = self._duration + done.where.long(), (done.terminated | done.truncated) & done.where
        self._left = torch.where(over, 0, self._left - done.where.long())
        ended = done.where & (self._left == 0)
        return done._replace(where=ended, observation=self._begun, action=self._action, reward=self._sums[0].clone(),
                             discounted_reward=self._sums[1].clone(), duration=self._duration.clamp(min=1))

    def state_dict(self) -> StateTree | None:
        """Running episodes and decisions, so that an evaluation does not end them."""
        inner = self._inner.state_dict()
        own = {name: getattr(self, f"_{name}") for name in ("left", "action", "duration", "begun", "sums")}
        return None if inner is None else {"inner": inner, **own}

    def load_state_dict(self, state: StateTree) -> None:
        """Go on where `state_dict` was taken."""
        self._inner.load_state_dict(state["inner"])
        for name in ("left", "action", "duration", "begun", "sums"):
            setattr(self, f"_{name}", torch.from_numpy(np.array(state[name])).to(self.device))


def count_untrained(learner: FlatLearner) -> int:
    """Most primitives before a learner's first update; 0 of one ordinary environment, where that is soon.

    A decision takes all its repeats until an episode ends, so that first escapes up to here are the untrained policy's.
    """
    recipe: Any = None if learner.agent == ARCHIVE or not learner.streams else get_recipe(learner.agent)
    if not hasattr(recipe, "rollout_per_env"):
        return 0
    settings: Any = replace_settings(recipe, learner.settings)
    return max(settings.rollout, settings.rollout_per_env * learner.streams) * learner.repeat


def read_learner(table: Mapping[str, Any], **changes: Any) -> FlatLearner:
    """A learner from its table in `study.toml`, which may hold more."""
    fields = {field.name for field in dataclasses.fields(FlatLearner)}
    return read_record(FlatLearner, {name: value for name, value in table.items() if name in fields} | changes)
