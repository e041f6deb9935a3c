"""Evaluation of frozen weights on fixed episode seeds, repeatable to the last bit.

Evaluation neither learns nor explores. Returns are undiscounted sums of primitive rewards; lengths are
given in primitives and in decisions, which differ by the options' durations.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import (
    Agent,
    SMDPTransition,
    check_actions,
    check_observation,
    make_transition,
    read_action_mask,
    read_success,
    set_option_discount,
)
from hrl_escape.settings import Range, read_argument
from hrl_escape.step_info import read_share

LONGEST_EPISODE = 100_000
"""Most primitives of an episode without a time limit."""
_COUNT = Annotated[int, Range(1)]


@dataclass(frozen=True)
class Evaluation:
    """Returns and lengths of episodes played with frozen weights."""

    primitives: int  #: trained for when it was made
    decisions: int  #: trained for
    returns: tuple[float, ...]  #: undiscounted return of each episode
    lengths: tuple[int, ...]  #: primitives of each episode
    decision_counts: tuple[int, ...]  #: decisions of each episode
    successes: tuple[bool | None, ...]  #: whether each succeeded, or None if the environment reports no success
    progress: tuple[float | None, ...]
    """Share of the task done at best in each: the largest `info["progress"]` if given, else its success."""
    seconds: float = field(default=0.0, compare=False)  #: wall time; left out of comparisons between results

    @property
    def mean_return(self) -> float:
        """Mean undiscounted return of an episode."""
        return statistics.fmean(self.returns)

    @property
    def escaped(self) -> NDArray[np.bool_]:
        """Success of each episode, bool (episodes,); False too where the environment reports none."""
        return np.array(self.successes, dtype=np.bool_)

    @property
    def success_rate(self) -> float | None:
        """Share of episodes that succeeded, of those that report it, or None if none does."""
        return _compute_reported_mean(self.successes)

    @property
    def mean_progress(self) -> float | None:
        """Mean over episodes of the most progress in each, 0 to 1, or None if none reports any."""
        return _compute_reported_mean(self.progress)

    @property
    def mean_length(self) -> float:
        """Mean primitives of an episode."""
        return statistics.fmean(self.lengths)


def _compute_reported_mean(values: Sequence[float | None]) -> float | None:
    reported = [value for value in values if value is not None]
    return statistics.fmean(reported) if reported else None


def compute_episode_seed(seed: int, purpose: str, episode: int) -> int:
    """Seed of an episode, as a pure function: episode n needs none of the episodes before it."""
    return int(np.random.SeedSequence([seed, *purpose.encode(), episode]).generate_state(1)[0])


def list_layers(env: gymnasium.Env) -> Iterator[Any]:
    """Yield an environment and everything that it wraps, outermost first; of a `SequenceEnv`, every part."""
    while isinstance(env, gymnasium.Wrapper):
        yield env
        for part in getattr(env, "parts", (env.env,))[1:]:
            yield from list_layers(part)
        env = env.env
    yield env


def count_planning(env: gymnasium.Env) -> tuple[int, float]:
    """Planner calls, and seconds in planners, of all environments of options in `env` since they were made.

    They are in the attribute `planning_total` of an `OptionsEnv`.
    """
    totals = [layer.planning_total for layer in list_layers(env) if hasattr(layer, "planning_total")]
    return sum(total.planner_calls for total in totals), sum(total.planner_seconds for total in totals)


def play_episode(agent: Agent, env: gymnasium.Env, seed: int, max_primitives: int = LONGEST_EPISODE
                 ) -> Iterator[tuple[SMDPTransition, dict[str, Any]]]:
    """Play one greedy episode from `reset(seed=seed)`, yielding each transition with its `info`.

    The seed also fixes the draws of a stochastic policy. The episode stops at `max_primitives` at the
    latest.
    """
    policy, primitives = agent.make_policy(), 0
    policy.begin_episode(np.random.default_rng(seed))
    for transition, info in walk_episode(env, seed, check_actions(agent, env.action_space), agent.gamma, policy.choose):
        policy.note_outcome(transition)
        primitives += transition.duration
        yield transition, info
        if primitives >= max_primitives:
            return


def walk_episode(env: gymnasium.Env, seed: int, actions: int, gamma: float,
                 choose: Callable[[Any, NDArray[np.bool_]], Any]) -> Iterator[tuple[SMDPTransition, dict[str, Any]]]:
    """Step through one episode from `reset(seed=seed)`, yielding each transition at this gamma with its `info`.

    `choose` maps (observation, action mask) to an action. It is called after the previous decision was yielded.
    """
    set_option_discount(env, gamma)
    observation, info = env.reset(seed=seed)
    check_observation(observation, "at the episode's start")
    mask = read_action_mask(info, actions)
    is_over = False
    while not is_over:
        action = choose(observation, mask)
        step = env.step(action)
        transition = make_transition(observation, action, mask, step, gamma)
        yield transition, step[4]
        observation, mask = transition.next_observation, transition.next_action_mask
        is_over = transition.terminated or transition.truncated


def evaluate(agent: Agent, env: gymnasium.Env, episodes: int, seed: int = 0, primitives: int = 0, decisions: int = 0,
             max_primitives: int = LONGEST_EPISODE, trials: int = 1) -> Evaluation:
    """Play greedy episodes with seeds that depend only on `seed` and the episode's number.

    Args:
        agent: acts greedily with frozen weights.
        env: the environment; its own state is overwritten.
        episodes: number of episodes, at least 1.
        seed: fixes the episodes; the same for all agents that are compared.
        primitives: primitives trained for, kept with the result.
        decisions: decisions trained for, kept with the result.
        max_primitives: longest episode in an environment without a time limit.
        trials: parts of an episode that count as episodes of their own, such as the rooms of a sequence, numbered by
            `info["trial"]`. A trial that an episode does not reach is a failure of no length.

    Raises:
        ConfigError: a number is not whole, or is out of its range.
    """
    episodes, trials, max_primitives = (read_argument(_COUNT, name, value) for name, value in (
        ("episodes", episodes), ("trials", trials), ("max_primitives", max_primitives)))
    seed = read_argument(int, "seed", seed)
    started = time.perf_counter()
    sums = [each for episode in range(episodes)
            for each in _sum_trials(agent, env, seed, episode, trials, max_primitives)]
    return _make_evaluation(primitives, decisions, sums, time.perf_counter() - started)


def evaluate_trials(agent: Agent, env: gymnasium.Env, episodes: int, trials: int, seed: int = 0, primitives: int = 0,
                    decisions: int = 0, after_episode: Callable[[], object] = lambda: None) -> tuple[Evaluation, ...]:
    """Evaluate each trial of episodes with several, as in a `SequenceEnv`; arguments as for `evaluate`."""
    sums = []
    for episode in range(episodes):
        sums.append(_sum_trials(agent, env, seed, episode, trials))
        after_episode()
    return tuple(_make_evaluation(primitives, decisions, each) for each in zip(*sums, strict=True))


class _Sums:
    """Sums over one episode, or one trial of it."""

    def __init__(self) -> None:
        self.total, self.length, self.count = 0.0, 0, 0
        self._progress: float | None = None
        self._info: Mapping[str, Any] = {"is_success": False}  # of a trial that the episode does not reach

    def add(self, transition: SMDPTransition, info: Mapping[str, Any]) -> None:
        """Count a decision's reward, primitives and progress."""
        self.total += transition.summed_reward
        self.length += transition.duration
        self.count += 1
        self._info = info
        share = read_share(info, "progress")
        if share is not None:
            self._progress = max(self._progress or 0.0, share)

    @property
    def success(self) -> bool | None:
        """Success at the latest decision."""
        return read_success(self._info)

    @property
    def progress(self) -> float | None:
        """Most progress so far, or else the success."""
        if self._progress is not None:
            return self._progress
        return None if (success := self.success) is None else float(success)


def _sum_trials(agent: Agent, env: gymnasium.Env, seed: int, episode: int, trials: int,
                max_primitives: int = LONGEST_EPISODE) -> list[_Sums]:
    sums = [_Sums() for _ in range(trials)]
    for transition, info in play_episode(agent, env, compute_episode_seed(seed, "evaluation", episode),
                                         max_primitives):
        sums[info["trial"] if trials > 1 else 0].add(transition, info)
    return sums


def _make_evaluation(primitives: int, decisions: int, sums: Sequence[_Sums], seconds: float = 0.0) -> Evaluation:
    return Evaluation(primitives, decisions, tuple(each.total for each in sums), tuple(each.length for each in sums),
                      tuple(each.count for each in sums), tuple(each.success for each in sums),
                      tuple(each.progress for each in sums), seconds)
