"""Tests in rooms that no training saw: an episode in each."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import gymnasium
import numpy as np

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.evaluation import compute_episode_seed, evaluate
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.agent_env import make_agent_env
from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.benchmark.statistics import compute_mean_efficiency
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.vector_env import EscapeRoomVectorEnv
from hrl_escape.errors import ComparisonError
from hrl_escape.options.batched.env import BatchedOptionsEnv
from hrl_escape.options.memory import VectorDecisionMemory
from hrl_escape.planning.best_known import find_best_known, list_start_states
from hrl_escape.sets.benchmark import Benchmark, load_benchmark
from hrl_escape.sets.instance_set import InstanceSet
from studies.study import ROOT

__all__ = ["Streams", "UnseenRooms", "count_fewest", "find_benchmark", "get_unseen", "make_streams", "make_unseen",
           "play_agent", "play_unseen", "stream_rooms", "train_agent"]


Streams: TypeAlias = EscapeRoomVectorEnv | BatchedOptionsEnv | VectorDecisionMemory
"""Many rooms at once."""


class UnseenRooms(NamedTuple):
    """Test rooms, and the fewest known primitives out of each."""

    rooms: InstanceSet
    fewest: tuple[float, ...]


def count_fewest(room: RoomInstance) -> float:
    """Primitives of the best known escape, from the first start.

    Raises:
        ComparisonError: none is known.
    """
    found = find_best_known(room, list_start_states(room)[0]).primitives
    if found is None:
        raise ComparisonError(f"room {room.id} has no known escape")
    return float(found)


def make_unseen(rooms: InstanceSet) -> UnseenRooms:
    """Rooms to be tested in."""
    return UnseenRooms(rooms, tuple(map(count_fewest, rooms)))


MANIFESTS = ROOT / "marks/manifests"
"""Benchmarks of version 0.3 that only studies use: `marks-1` to `marks-4`, without roots."""


def find_benchmark(name: str) -> Benchmark:
    """Load a benchmark of the package, or one that only studies use."""
    own = MANIFESTS / f"{name}.json"
    return load_benchmark(own if own.is_file() else name)


@lru_cache(maxsize=8)
def get_unseen(benchmark: str, rung: str, tested: int) -> UnseenRooms:
    """The first test rooms of a rung."""
    return make_unseen(find_benchmark(benchmark)[rung].test[:tested])


@lru_cache(maxsize=1)
def make_streams(benchmark: str, rung: str, size: int, count: int, agent: str) -> Streams:
    """The first training rooms of a rung, many at once, kept for the next run in them.

    Args:
        benchmark: name.
        rung: name.
        size: number of training rooms.
        count: number of streams; where rooms are fewer, several are the same.
        agent: by label, says what is chosen among; objects are observed.
    """
    return stream_rooms(find_benchmark(benchmark)[rung].train[:size], count, agent)


def stream_rooms(rooms: InstanceSet, count: int, agent: str, observation: str = "objects") -> Streams:
    """Rooms, many at once; see `make_streams`."""
    spec = AgentSpec.parse(agent)
    view = spec.options.to_dict()
    has_memory = view.pop("memory")
    many = rooms.make_vec(count, options=view if spec.chooses_options else False, observation=observation,
                          compile=True)
    if not has_memory:
        return many
    assert isinstance(many, BatchedOptionsEnv)  # as who remembers decisions chooses options
    return VectorDecisionMemory(many)


def train_agent(spec: AgentSpec, train_in: gymnasium.Env | Streams, primitives: int, seed: int
                ) -> tuple[Agent, int | None]:
    """Train an agent without evaluations; returns it, and the primitives at its first escape, None without one."""
    result = train(spec, train_in, primitives=primitives, seed=seed, eval_episodes=0, progress=False)
    assert result.agent is not None  # a run without a folder gives its agent back
    return result.agent, result.first_escape


def play_agent(spec: AgentSpec, unseen: UnseenRooms, train_in: InstanceSet | Streams, seed: int = 0,
               primitives: int = 1) -> tuple[float, float]:
    """Train an agent in some rooms and play the others; who does not learn is only tested. See `play_unseen`."""

    def make_player(env: gymnasium.Env, recorder: StateRecorder) -> Agent:
        if spec.is_reference:
            return make_reference(spec.name, env, recorder)
        own = make_agent_env(spec, train_in, "objects")[0] if isinstance(train_in, InstanceSet) else train_in
        player, _ = train_agent(spec, own, primitives, seed)
        if isinstance(own, gymnasium.Env):
            own.close()
        return player

    return play_unseen(spec, unseen, make_player)


def play_unseen(view: AgentSpec, unseen: UnseenRooms, make_player: Callable[[gymnasium.Env, StateRecorder], Agent],
                observation: str = "objects") -> tuple[float, float]:
    """Play an episode in each room; returns the mean efficiency and the share of escapes, to four digits.

    Args:
        view: says what is chosen among.
        unseen: the rooms; with more fewest primitives than rooms, these come again in the same order.
        make_player: makes who plays, given the environment over these rooms and its recorder.
        observation: by name.
    """
    tested = len(unseen.fewest)
    order = {str(compute_episode_seed(0, "evaluation", number)): number for number in range(tested)}
    env, recorder = make_agent_env(view, unseen.rooms, observation, order)
    try:
        found = evaluate(make_player(env, recorder), env, tested)
    finally:
        env.close()
    efficiency = compute_mean_efficiency(found.escaped, found.lengths, unseen.fewest, is_expected=False)
    return round(efficiency, 4), round(float(np.mean(found.escaped)), 4)
