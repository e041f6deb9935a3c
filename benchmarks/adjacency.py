"""HIRO and HRAC in Four Rooms: any goal, goals learned to be near, and goals that are near.

Examples:
    python -m benchmarks.adjacency --seeds 10 --primitives 20000
"""

from __future__ import annotations

import dataclasses

import numpy as np
import tyro
from numpy.typing import NDArray

from hrl_escape.agents.algorithms.given.hiro import Hiro
from hrl_escape.agents.algorithms.given.hrac import Hrac
from hrl_escape.agents.hierarchy.goal_space import GoalSpace
from hrl_escape.agents.training.train import train
from hrl_escape.comparison.inference import compare_pairs
from tests.classic.exact import find_fewest_primitives
from tests.classic.four_rooms import EAST_HALLWAY, GRID, FourRooms
from tests.classic.tabular import State

CELLS = np.array(GRID.cells, np.float64)
SHIFTS = np.array([(down, right) for down in range(-4, 5) for right in range(-4, 5) if down or right], np.float64)
SPACE = GoalSpace(lambda cell: CELLS[cell], SHIFTS, is_relative=True)
DISTANCES = {(*CELLS[start].tolist(), *CELLS[end].tolist()): steps for end in range(len(GRID))
             for start, steps in enumerate(find_fewest_primitives(FourRooms(end, "none").make_tables()))}
HORIZON = 100


@dataclasses.dataclass(frozen=True)
class Args:
    """Options."""

    seeds: int = 10
    """Seeds a row."""
    primitives: int = 20_000
    """Training a seed."""
    first_seed: int = 0
    """Lowest seed."""


def count_steps(start: NDArray[np.float64], ends: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fewest primitives from a cell to others; inf to places that are walls."""
    return np.array([DISTANCES.get((*start.tolist(), *end), np.inf) for end in np.asarray(ends).tolist()])


def make_agent(kind: str, env: FourRooms, seed: int, primitives: int) -> Hiro:
    """`hiro`, or `hrac` with learned or exact adjacency, all with one set of settings."""
    settings = Hiro.Settings(window=4, epsilon_steps=primitives // 2)
    given = (env.observation_space, env.action_space, seed, settings, SPACE)
    return Hiro(*given) if kind == "any goal" else Hrac(*given, count_steps if kind == "exact" else None)


def run(kind: str, seed: int, primitives: int) -> tuple[float, float]:
    """Share of every fourth cell that the greedy policy leaves from, and the fewest primitives over those it takes."""
    env = FourRooms(EAST_HALLWAY, "none", horizon=HORIZON)
    agent = make_agent(kind, env, seed, primitives)
    train(agent, env, primitives=primitives, seed=seed, eval_episodes=0, progress=False)
    starts, steps, arrived = env.first[::4], 0, 0
    shortest = find_fewest_primitives(env.make_tables())[starts]
    for start in starts:
        env.reset(seed=0)
        env.set_state(State(start))
        cell, rng, over, terminated = start, np.random.default_rng(start), False, False
        while not over:
            cell, _, terminated, truncated, _ = env.step(agent.act_greedy(cell, np.ones(4, np.bool_), rng))
            steps, over = steps + 1, terminated or truncated
        arrived += terminated
    return arrived / len(starts), float(shortest.sum() / steps)


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
