"""Evaluation: frozen weights, fixed episode seeds, the same numbers however often it is asked.

Nothing here learns or explores. Returns are undiscounted sums of primitive rewards; lengths are
given in primitives and in decisions, which differ by the options' durations.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import numpy as np

from hrl_escape.agents.agent import Agent, SMDPTransition, count_actions, make_transition, read_action_mask

__all__ = ["Evaluation", "compute_episode_seed", "evaluate", "play_episode"]


@dataclass(frozen=True)
class Evaluation:
    """What frozen weights achieved, episode by episode.

    Attributes:
        primitives: primitives trained for when it was made.
        decisions: decisions trained for.
        returns: undiscounted return of each episode.
        lengths: primitives of each episode.
        decision_counts: decisions of each episode.
        successes: whether each succeeded: `info["is_success"]` at its end if given, else `terminated`.
        seconds: wall time of the evaluation; left out of comparisons between results.
    """

    primitives: int
    decisions: int
    returns: tuple[float, ...]
    lengths: tuple[int, ...]
    decision_counts: tuple[int, ...]
    successes: tuple[bool, ...]
    seconds: float = field(default=0.0, compare=False)

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> Evaluation:
        """What `dataclasses.asdict` gave and JSON carried."""
        fields: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in value.items()}
        return cls(**fields)

    @property
    def mean_return(self) -> float:
        """Mean over episodes."""
        return statistics.fmean(self.returns)

    @property
    def success_rate(self) -> float:
        """Share of episodes that succeeded."""
        return statistics.fmean(self.successes)

    @property
    def mean_length(self) -> float:
        """Mean primitives of an episode."""
        return statistics.fmean(self.lengths)


def compute_episode_seed(seed: int, purpose: str, episode: int) -> int:
    """The seed of an episode: a pure function, so that episode n needs none of the ones before it."""
    return int(np.random.SeedSequence([seed, *purpose.encode(), episode]).generate_state(1)[0])


def play_episode(
    agent: Agent, env: gymnasium.Env, seed: int, max_primitives: int = 100_000
) -> Iterator[tuple[SMDPTransition, dict[str, Any]]]:
    """Play one greedy episode; yields each transition with its `info`.

    Args:
        agent: acts with frozen weights.
        env: reset with `seed` first.
        seed: fixes the episode, and the draws of a policy that is random by nature.
        max_primitives: the episode stops here if the environment has no end of its own.
    """
    actions = count_actions(env.action_space, "evaluation")
    rng = np.random.default_rng(seed)
    observation, info = env.reset(seed=seed)
    mask = read_action_mask(info, actions)
    primitives = 0
    while primitives < max_primitives:
        action = agent.act_greedy(observation, mask, rng)
        step = env.step(action)
        transition = make_transition(observation, action, mask, step, agent.gamma)
        primitives += transition.duration
        yield transition, step[4]
        if transition.terminated or transition.truncated:
            return
        observation, mask = transition.next_observation, transition.next_action_mask


def evaluate(
    agent: Agent,
    env: gymnasium.Env,
    episodes: int,
    seed: int = 0,
    primitives: int = 0,
    decisions: int = 0,
    max_primitives: int = 100_000,
) -> Evaluation:
    """Play greedy episodes with seeds that depend only on `seed` and the episode's number.

    Args:
        agent: whose frozen weights act.
        env: the environment; its own state is overwritten.
        episodes: how many, at least 1.
        seed: the same for all agents and training seeds that shall be compared.
        primitives: primitives trained for, to be noted.
        decisions: decisions trained for, to be noted.
        max_primitives: cut of an episode in an environment without one.
    """
    started = time.perf_counter()
    returns, lengths, counts, successes = [], [], [], []
    for episode in range(episodes):
        total, length, count, success = 0.0, 0, 0, False
        episode_seed = compute_episode_seed(seed, "evaluation", episode)
        for transition, info in play_episode(agent, env, episode_seed, max_primitives):
            total += transition.summed_reward
            length += transition.duration
            count += 1
            success = bool(info.get("is_success", transition.terminated))
        returns.append(total)
        lengths.append(length)
        counts.append(count)
        successes.append(success)
    return Evaluation(
        primitives,
        decisions,
        tuple(returns),
        tuple(lengths),
        tuple(counts),
        tuple(successes),
        time.perf_counter() - started,
    )
