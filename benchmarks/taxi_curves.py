"""Learning curves of MAXQ-0 and HAMQ on Taxi, against the public ones of Bai and Russell (2017).

Examples:
    python -m benchmarks.taxi_curves --seeds 2 --episodes 4096

Moves slip with probability 0.2, passenger and destination differ, episodes are cut at 128 primitives, as in
`aijunbai/maxq-op` (`data/*.out`, 200 runs each). Prints one line of a table for each number of training episodes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

import numpy as np
import tyro

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.algorithms.task_hierarchies.hamq import Hamq
from hrl_escape.agents.algorithms.task_hierarchies.maxq_q import MaxqQ
from hrl_escape.agents.training.evaluation import evaluate
from tests.agents.hierarchy.taxi_program import drive, read
from tests.agents.hierarchy.taxi_tasks import make_taxi_tasks
from tests.agents.running import interact
from tests.classic.taxi import Taxi

RATES = {"gamma": 1.0, "learning_rate": 1.0, "learning_rate_power": 0.6, "epsilon_start": 0.3, "epsilon_end": 0.1,
         "epsilon_steps": 100_000}
TESTS = 100
PUBLIC = {
    1: ("-131.2", "-109.0", "-110.3"),
    256: ("-129.5", "-92.5", "-73.4"),
    1024: ("-99.9", "-53.9", "-15.4"),
    4096: ("-13.3", "2.04", "2.40"),
    16384: ("-0.49", "2.90", "2.46"),
}
"""Training episodes -> published return of MAXQ-0, HAMQ and HAMQ-INT."""


def make_maxq(env: Taxi, seed: int) -> Agent:
    """MAXQ-0 with Dietterich's state abstraction."""
    return MaxqQ(env.observation_space, env.action_space, seed, MaxqQ.Settings(**RATES), make_taxi_tasks())


def make_hamq(env: Taxi, seed: int, internal: bool = False) -> Agent:
    """HAMQ with a program that leaves open where to go and each move."""
    return Hamq(env.observation_space, env.action_space, seed, Hamq.Settings(internal=internal, **RATES), drive,
                read=read)


AGENTS: dict[str, Callable[[Taxi, int], Agent]] = {
    "maxq-q": make_maxq,
    "hamq": make_hamq,
    "hamq, internal": lambda env, seed: make_hamq(env, seed, internal=True),
}


def measure(make: Callable[[Taxi, int], Agent], seed: int, points: list[int]) -> Iterator[float]:
    """Mean return of test episodes after each number of training episodes."""
    env = Taxi(noisy=True, horizon=128)
    agent, ended = make(env, seed), 0
    for transition in interact(agent, env, 10**9, seed):
        ended += transition.terminated or transition.truncated
        if ended in points and (transition.terminated or transition.truncated):
            yield float(np.mean(evaluate(agent, Taxi(noisy=True, horizon=128), TESTS, seed).returns))
        if ended == points[-1]:
            return


@dataclasses.dataclass(frozen=True)
class Args:
    """Options."""

    seeds: int = 2
    """Seeds a column."""
    episodes: int = 4096
    """Training a seed."""


def main(args: Args) -> None:
    """Print the table."""
    points = [point for point in PUBLIC if point <= args.episodes]
    runs = {name: [measure(make, seed, points) for seed in range(args.seeds)] for name, make in AGENTS.items()}
    for point in points:
        means = [[next(run) for run in each] for each in runs.values()]
        cells = [f"{np.mean(each):.1f} ({public})" for each, public in zip(means, PUBLIC[point], strict=True)]
        print(f"| {point:,} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Args))
