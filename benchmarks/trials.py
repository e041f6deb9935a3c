"""How long do 16 training seeds take at once, and how long one after another? Are the results the same?

Run: `python benchmarks/trials.py` (some two minutes on two idle cores). Both ways train the same seeds in the
same room in one run; wall and CPU seconds are printed, their ratios, and where seeds part: batched products round in
another order, which sooner or later tips the choice between two actions of nearly the same value, and from there on a
seed is another draw from the same distribution. Exits with 1 if at once takes more than a third of the wall time of
the sequence (for smdp-dqn), or if a seed parts in the first tenth of its budget.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium
import torch

import hrl_escape  # noqa: F401  # registers the environments
from hrl_escape.agents import TrainResult, train
from hrl_escape.options.options_env import OptionsEnv

NEEDED = {"smdp-dqn": 1 / 3}
SOON = 0.1
"""Share of the budget in which no seed may part."""


def find_parting(one: TrainResult, other: TrainResult) -> float:
    """Share of the budget at the first evaluation that differs; 1 where none does."""
    for mine, theirs in zip(one.evaluations, other.evaluations, strict=False):
        if mine != theirs:
            return mine.primitives / one.primitives
    return 1.0


def describe_end(results: list[TrainResult]) -> str:
    """Mean and range of the last evaluations."""
    ends = [result.evaluations[-1].mean_return for result in results]
    return f"{statistics.fmean(ends):.1f} ({min(ends):.0f} to {max(ends):.0f})"


def measure(work: Callable[[], list[TrainResult]]) -> tuple[list[TrainResult], float, float]:
    """Results, wall seconds, and CPU seconds of this process and its children."""
    cpu, wall = sum(os.times()[:4]), time.perf_counter()
    results = work()
    return results, time.perf_counter() - wall, sum(os.times()[:4]) - cpu


def train_in_turn(name: str, env: gymnasium.Env, trials: int, **budget: Any) -> list[TrainResult]:
    """Train the seeds one after another."""
    return [train(name, env, seed=seed, **budget) for seed in range(trials)]


def main() -> int:
    """Measure each agent both ways."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--agents", nargs="+", default=["smdp-dqn"], help="names, such as smdp-sarsa or dqn")
    parser.add_argument("--trials", type=int, default=16)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--primitives", type=int, default=20_000, help="budget of a trial")
    parser.add_argument("--eval-episodes", type=int, default=5)
    parser.add_argument("--preset", default="paper-two-button")
    parser.add_argument("--recipe", default="corrected")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    failed = False
    for name in arguments.agents:
        env: gymnasium.Env = gymnasium.make("hrl_escape/EscapeRoom-v0", config=arguments.preset, observation="features")
        if name.startswith("smdp-"):
            env = OptionsEnv(env)
        budget = {"primitives": arguments.primitives, "eval_episodes": arguments.eval_episodes,
                  "recipe": arguments.recipe}
        train(name, env, primitives=300, eval_episodes=0)  # kernels compiled, the room's tables made
        together, wall, cpu = measure(
            partial(train, name, env, trials=arguments.trials, workers=arguments.workers, **budget))
        print(f"{name}: {arguments.trials} at once in {arguments.workers} processes {wall:.1f} s, {cpu:.1f} CPU s",
              flush=True)
        alone, wall_alone, cpu_alone = measure(partial(train_in_turn, name, env, arguments.trials, **budget))
        parting = [find_parting(one, other) for one, other in zip(together, alone, strict=True)]
        print(f"{name}: one after another {wall_alone:.1f} s, {cpu_alone:.1f} CPU s; at once takes "
              f"{wall / wall_alone:.2f} of the time, {cpu / cpu_alone:.2f} of the CPU", flush=True)
        print(f"{name}: evaluations are the same up to {statistics.median(parting):.0%} of the budget (median; least "
              f"{min(parting):.0%}); last ones {describe_end(together)} at once, {describe_end(alone)} in sequence")
        failed |= min(parting) < SOON or wall / wall_alone > NEEDED.get(name, 1.0)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
