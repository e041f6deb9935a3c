"""Efficiency of an agent in unseen rooms: one episode in each, against the best known plan."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import gymnasium
import numpy as np
from numpy.typing import ArrayLike

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.evaluation import compute_episode_seed
from hrl_escape.benchmark.agent_env import find_starts, make_agent_env
from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.benchmark.score_range import compute_score_range
from hrl_escape.benchmark.statistics import compute_efficiency
from hrl_escape.sets.instance_set import InstanceSet

__all__ = ["PlayRooms", "measure_efficiencies"]

PlayRooms: TypeAlias = Callable[[gymnasium.Env, StateRecorder], tuple[ArrayLike, ArrayLike]]
"""Plays an episode in each room. Returns whether each escaped, bool (rooms,), and its primitives, (rooms,)."""


def measure_efficiencies(spec: AgentSpec, rooms: InstanceSet, observation: str, cache: Path, play: PlayRooms
                         ) -> tuple[float, ...]:
    """Measure the efficiency of an agent in each of some rooms, to four digits.

    Args:
        spec: of the agent.
        rooms: unseen rooms.
        observation: name of the observation.
        cache: folder of best known plans.
        play: plays in the environment, whose evaluation episodes are in the rooms in order.
    """
    seeds = [compute_episode_seed(0, "evaluation", number) for number in range(len(rooms))]
    env, recorder = make_agent_env(spec, rooms, observation, {str(seed): number for number, seed in enumerate(seeds)})
    try:
        escaped, lengths = play(env, recorder)
        fewest = compute_score_range(find_starts(env, recorder, seeds), spec, cache).fewest
    finally:
        env.close()
    found = np.minimum(compute_efficiency(escaped, lengths, fewest), 1.0)
    return tuple(round(value, 4) for value in found.tolist())
