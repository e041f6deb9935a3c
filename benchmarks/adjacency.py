"""HIRO and HRAC in Four Rooms: any goal, goals learned to be near, and goals that are near.

Examples:
    python -m benchmarks.adjacency --seeds 10 --primitives 10000
"""

from __future__ import annotations

import dataclasses

import numpy as np
import tyro

from hrl_escape.agents.algorithms.task_hierarchies.hiro_finite import HiroFinite
from hrl_escape.agents.algorithms.task_hierarchies.hrac_finite import HracFinite
from hrl_escape.agents.hierarchy.goal_space import GoalSpace
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.inference import compare_pairs
from tests.classic.exact import find_fewest_primitives
from tests.classic.four_rooms import EAST_HALLWAY, GRID, FourRooms, count_primitives_between, walk_greedily

CELLS = np.array(GRID.cells, np.float64)
SHIFTS = np.array([(down, right) for down in range(-4, 5) for right in range(-4, 5) if down or right], np.float64)
SPACE = GoalSpace(lambda cell: CELLS[cell], SHIFTS, is_relative=True)
HORIZON = 100


@dataclasses.dataclass(frozen=True)
class Args:
    """Options."""

    seeds: int = 10
    """Seeds a row."""
    primitives: int = 10_000
    """Training a seed."""
    first_seed: int = 0
    """Lowest seed."""


def make_agent(kind: str, env: FourRooms, seed: int, primitives: int) -> HiroFinite:
    """`hiro-finite`, or `hrac-finite` with learned or exact adjacency, all with one set of settings."""
    settings = HiroFinite.Settings(window=4, epsilon_steps=primitives // 2)
    given = (env.observation_space, env.action_space, seed, settings, SPACE)
    if kind == "any goal":
        return HiroFinite(*given)
    return HracFinite(*given, count_primitives_between if kind == "exact" else None)


def run(kind: str, seed: int, primitives: int) -> tuple[float, float]:
    """Share of every fourth cell that the greedy policy leaves from, and the fewest primitives over those it takes."""
    env = FourRooms(EAST_HALLWAY, "none", horizon=HORIZON)
    agent = make_agent(kind, env, seed, primitives)
    train(agent, env, primitives=primitives, seed=seed, eval_episodes=0, progress=False)
    starts = env.first[::4]
    shortest = find_fewest_primitives(env.make_tables())[starts]
    steps, arrived = np.array([walk_greedily(agent, env, start) for start in starts]).T
    return float(arrived.mean()), float(shortest.sum() / steps.sum())


def main(args: Args) -> None:
    """Print a table, and differences over the same seeds."""
    seeds = range(args.first_seed, args.first_seed + args.seeds)
    print("| goals | cells it gets out from | efficiency |\n|---|---|---|")
    found = {}
    for kind in ("any goal", "learned", "exact"):
        arrived, efficiency = np.array([run(kind, seed, args.primitives) for seed in seeds]).T
        found[kind] = efficiency
        print(f"| {kind} | {arrived.mean():.2f} | {efficiency.mean():.2f} ({efficiency.min():.2f} to "
              f"{efficiency.max():.2f}) |", flush=True)
    for first, second in (("learned", "any goal"), ("exact", "any goal"), ("exact", "learned")):
        test = compare_pairs([found[first] - found[second]])
        print(f"{first} less {second}: {test.difference:+.3f} ({test.low:+.3f} to {test.high:+.3f})")


if __name__ == "__main__":
    main(tyro.cli(Args))
