"""Learning Taxi under one set of rates, whoever learns: for checks against its exact optimum."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.training.evaluation import evaluate
from tests.agents.running import interact
from tests.classic.taxi import Taxi

DYNAMICS = {"still": {}, "noisy": {"noisy": True}, "fickle": {"fickle": True}, "both": {"noisy": True, "fickle": True}}
"""Name -> arguments of `Taxi`."""


def measure_taxi(
    make: Callable[[Taxi, int, dict[str, Any]], Agent], dynamics: str, episodes: int, seed: int, tests: int
) -> tuple[float, float]:
    """Mean return of so many greedy episodes after training, and its standard error.

    `make` is given the environment, the seed and the rates: constant where nothing is left to chance.
    """
    env = Taxi(**DYNAMICS[dynamics])
    rates = {"learning_rate": 0.25} if dynamics == "still" else {"learning_rate": 1.0, "learning_rate_power": 0.6}
    agent = make(env, seed, {"gamma": 1.0, "epsilon_start": 0.3, "epsilon_end": 0.1, **rates})
    ended = 0
    for transition in interact(agent, env, 10**9, seed):
        ended += transition.terminated or transition.truncated
        if ended == episodes:
            break
    returns = evaluate(agent, env, tests, seed).returns
    return float(np.mean(returns)), float(np.std(returns) / tests**0.5)


def compare_ten_seeds(
    name: str, make: Callable[[Taxi, int, dict[str, Any]], Agent], dynamics: str, episodes: int, tests: int,
    optimum: float,
) -> tuple[float, float]:
    """Mean of `measure_taxi` over ten seeds less the optimum, and its standard error; prints the row of the table."""
    means, errors = zip(*(measure_taxi(make, dynamics, episodes, seed, tests) for seed in range(10)), strict=True)
    mean, error = float(np.mean(means)), float(np.sqrt(np.square(errors).sum()) / len(errors))
    print(f"{name}, {dynamics}: {mean:.2f} +- {error:.2f}, optimum {optimum:.2f}")
    return mean - optimum, error
