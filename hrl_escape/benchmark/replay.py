"""Replay of test rooms by a frozen agent, one reproducible episode each."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.evaluation import compute_episode_seed, play_episode
from hrl_escape.benchmark.agent_archive import RoomResult, RoomView
from hrl_escape.benchmark.agent_env import make_agent_env
from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.benchmark.score_range import compute_score_range
from hrl_escape.errors import ConfigError
from hrl_escape.sets.instance_set import InstanceSet

PlayerMaker = Callable[[gymnasium.Env, StateRecorder], Agent]
"""Makes the agent for an environment."""


class CheckedResult(NamedTuple):
    """Published result of a room, and the result of playing the room again."""

    stated: RoomResult
    found: RoomResult

    @property
    def is_equal(self) -> bool:
        """Equal to the last bit."""
        return self.stated == self.found


def make_view_env(view: RoomView, rooms: InstanceSet, schedule: Mapping[str, int] | None = None
                  ) -> tuple[gymnasium.Env, StateRecorder]:
    """Make an environment over a set of rooms with the observation and actions of a view; see `make_agent_env`."""
    name = "random-options" if view.choices == "options" else "random"
    return make_agent_env(AgentSpec(name, options=view.options), rooms, view.observation, schedule)


def play_rooms(view: RoomView, rooms: InstanceSet, numbers: Iterable[int], make_player: PlayerMaker
               ) -> Iterator[RoomResult]:
    """Play one episode in each of some rooms of a test set; the other rooms do not affect the result.

    Args:
        view: observation and actions of the agent.
        rooms: the test set.
        numbers: of the rooms to play.
        make_player: makes the agent.
    """
    seeds = {number: compute_episode_seed(0, "evaluation", number) for number in numbers}
    env, recorder = make_view_env(view, rooms, {str(seed): number for number, seed in seeds.items()})
    room: Any = env.unwrapped
    with closing(env), tempfile.TemporaryDirectory() as cache:
        player = make_player(env, recorder)
        for number, seed in seeds.items():
            primitives, decisions, total, escaped = 0, 0, 0.0, False
            for step, info in play_episode(player, env, seed):
                primitives, decisions, total = primitives + step.duration, decisions + 1, total + step.summed_reward
                escaped = bool(info["is_success"])
            known = compute_score_range([(room.instance, recorder.states[0])], AgentSpec(), Path(cache))
            yield RoomResult(number, escaped, primitives, decisions, total, float(known.fewest[0]))


def replay(results: Sequence[RoomResult], view: RoomView, rooms: InstanceSet, count: int, seed: int,
           make_player: PlayerMaker) -> list[CheckedResult]:
    """Play some rooms again and compare the results.

    Args:
        results: published results, in order.
        view: observation and actions of the agent.
        rooms: the test set.
        count: number of rooms, drawn by `seed`.
        seed: an author of the results must not be able to predict it.
        make_player: makes the agent.

    Raises:
        ConfigError: there are fewer results than `count`.
    """
    if not 1 <= count <= len(results):
        raise ConfigError("rooms", count, f"from 1 to {len(results)}, the number of results")
    numbers = sorted(np.random.default_rng(seed).choice(len(results), count, replace=False).tolist())
    found = play_rooms(view, rooms, numbers, make_player)
    return [CheckedResult(results[number], each) for number, each in zip(numbers, found, strict=True)]
