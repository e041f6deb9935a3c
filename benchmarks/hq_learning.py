"""HQ-learning in mazes that look alike: how many seeds end with a sequence of reactive policies that arrives.

Examples:
    python -m benchmarks.hq_learning --seeds 10 --primitives 40000
"""

from __future__ import annotations

import dataclasses

import numpy as np
import tyro

from hrl_escape.agents.algorithms.task_hierarchies.hq_learning import HqLearning
from hrl_escape.agents.training.evaluation import evaluate
from tests.agents.running import learn
from tests.classic.winding_maze import WindingMaze


@dataclasses.dataclass(frozen=True)
class Args:
    """Options."""

    seeds: int = 10
    """Seeds a row."""
    primitives: int = 40_000
    """Training a seed."""


def run(turns: int, agents: int, seed: int, primitives: int) -> tuple[float, float]:
    """Success and length of the greedy sequence after training."""
    env = WindingMaze(turns)
    settings = HqLearning.Settings(
        agents=agents, gamma=0.9, learning_rate=0.1, subgoal_learning_rate=0.02, temperature=1.0,
        epsilon_start=0.5, epsilon_end=0.1, epsilon_steps=primitives,
    )  # fmt: skip
    agent = HqLearning(env.observation_space, env.action_space, seed, settings)
    learn(agent, env, primitives, seed)
    evaluation = evaluate(agent, WindingMaze(turns, horizon=100), 1)
    return evaluation.success_rate, evaluation.mean_length


def main(args: Args) -> None:
    """Print a table."""
    print("| turns | optimum | agents | seeds that arrive | their mean length |\n|---|---|---|---|---|")
    for turns, agents in ((1, 1), (1, 2), (1, 3), (2, 3), (2, 4)):
        arrived, lengths = zip(*(run(turns, agents, seed, args.primitives) for seed in range(args.seeds)), strict=True)
        reached = np.array(arrived) > 0
        mean = f"{np.array(lengths)[reached].mean():.1f}" if reached.any() else ""
        print(f"| {turns} | {4 + 6 * turns} | {agents} | {reached.sum()} of {args.seeds} | {mean} |", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Args))
