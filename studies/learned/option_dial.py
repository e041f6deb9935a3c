"""The option-quality dial: a learned option beside a planned one that fails with a known probability.

One call of an option is worth gamma^k if its goal holds after the k primitives that it took, and 0 if not. A planned
option that fails with probability f, see `OptionDegradation`, is worth 1 - f times the planned one; so a learned option
has a place on that curve: it is worth a planned option that fails so often. A detour counts as failing would.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import isotonic_regression

from hrl_escape.agents.training.evaluation import compute_episode_seed
from hrl_escape.benchmark.inference import LEVEL, compute_interval
from hrl_escape.benchmark.statistics import compute_mean
from hrl_escape.errors import ComparisonError, ConfigError, OptionError
from hrl_escape.options.options_env import OptionsEnv

__all__ = ["DialPlace", "measure_option", "place_on_dial"]


class DialPlace(NamedTuple):
    """Place of an option on the dial.

    Attributes:
        failure: probability of failing at which a planned option is worth as much, in [0, 1]: 0 for one that is worth
            no less than the planned one.
        low: lower end of its interval.
        high: upper end.
    """

    failure: float
    low: float
    high: float


def measure_option(env: OptionsEnv, option: str, is_reached: Callable[[Any, Mapping[str, Any]], bool], calls: int,
                   seed: int = 0) -> NDArray[np.float64]:
    """Call an option at the start of episodes and tell what each call is worth.

    Args:
        env: the environment in which the option is an action. Its `gamma` discounts primitives of the lowest level.
        option: name of the action.
        is_reached: (observation, info) after the call -> whether the option's goal holds.
        calls: number of episodes.
        seed: fixes them.

    Returns:
        float64 (calls,): gamma^k where the goal holds after the call's k primitives, else 0; 0 where it may not start.

    Raises:
        OptionError: no action has that name.
        ConfigError: no calls.
    """
    if option not in env.action_names:
        raise OptionError(f"no action is called {option!r}: there are {', '.join(env.action_names)}")
    if calls < 1:
        raise ConfigError("calls", calls, "1 or more")
    index, worth = env.action_names.index(option), np.zeros(calls)
    for call in range(calls):
        _, info = env.reset(seed=compute_episode_seed(seed, "dial", call))
        if info["action_mask"][index]:
            observation, _, _, _, info = env.step(index)
            worth[call] = info["discount"] if is_reached(observation, info) else 0.0
    return worth


def place_on_dial(curve: Mapping[float, ArrayLike], worth: ArrayLike, seed: int = 0, level: float = LEVEL
                  ) -> DialPlace:
    """Find how often a planned option must fail to be worth as much as a learned one.

    Args:
        curve: probability of failing -> what calls of the planned option are worth, of as many calls as there are. It
            is made monotone, and linear between its points.
        worth: what the learned option is worth, one number a run.
        seed: fixes the draws of the interval, which is that of the mean over runs; the curve counts as known.
        level: confidence of the interval; 1 - 0.05 / n where n options are compared, or the best of n is picked.

    Raises:
        ComparisonError: fewer than two points, or no run.
    """
    scores = np.asarray(worth, np.float64).ravel()
    if len(curve) < 2 or not scores.size:
        raise ComparisonError(f"a place on the dial needs two points and one run, not {len(curve)} and {scores.size}")
    failures = np.array(sorted(curve))
    means = isotonic_regression([np.mean(np.asarray(curve[failure], np.float64)) for failure in failures],
                                increasing=False).x

    def find(value: float) -> float:
        return float(np.interp(value, means[::-1], failures[::-1]))

    low, high = compute_interval(compute_mean, [scores], (0.0, 1.0), np.random.default_rng(seed), level=level)
    return DialPlace(find(float(scores.mean())), find(float(high)), find(float(low)))
