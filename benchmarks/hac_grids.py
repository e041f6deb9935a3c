"""HAC in the two grids of its authors, with one to three levels.

    python -m benchmarks.hac_grids                                  # ten seeds of each grid and number of levels
    python -m benchmarks.hac_grids --grids rooms --levels 2 3       # fewer
    python -m benchmarks.hac_grids --table                          # tables of the finished runs

An episode asks for the way between two drawn cells of an empty grid of 10 x 10, or of Four Rooms. After equal parts of
the budget, the policy without exploration is evaluated in 100 episodes, the same ones for all. `success` is the share
that arrives within the horizon, `area` its mean over the evaluations, and `steps` the mean length at the end. One level
is Q-learning with goals in hindsight. `hac-finite` learns each choice for `hindsight_goals` other goals, HierQ of the
paper for all. Finished runs are kept, a line each, in the file `--out`, by default `benchmarks/hac-grids.jsonl`; the
command continues a stopped run.

Levy, Konidaris, Platt and Saenko (2019).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray

from benchmarks.finished_runs import run_missing
from benchmarks.hac_pendulum import PAIRS, show_gaps
from benchmarks.point_mazes import format_mean
from hrl_escape.agents import train
from hrl_escape.agents.algorithms.task_hierarchies.hac_finite import HacFinite
from hrl_escape.agents.hierarchy.goal_space import GoalSpace, GoalView
from tests.classic.four_rooms import GRID
from tests.classic.grid import Grid

GRIDS = {"open": Grid(["." * 10] * 10), "rooms": GRID}
HORIZON, PRIMITIVES, EVALUATIONS, TESTS = 200, 60_000, 10, 100
"""Primitives of an episode and of a run, evaluations after equal parts of it, and their episodes."""
ATTEMPTS = {1: HORIZON, 2: 14, 3: 6}
"""Levels -> H, choices of a level for a goal: about as many primitives of all levels together."""
SETTINGS: dict[str, Any] = {"learning_rate": 1.0, "hindsight_goals": 20}


class GridTask(gymnasium.Env):
    """Walk from one cell to another; observations are both, (2,).

    Args:
        grid: cells and walls.
    """

    def __init__(self, grid: Grid) -> None:
        self.grid, cells = grid, len(grid)
        self.observation_space, self.action_space = spaces.MultiDiscrete([cells, cells]), spaces.Discrete(4)
        self._state, self._steps = np.zeros(2, np.int64), 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None
              ) -> tuple[NDArray[np.int64], dict[str, Any]]:
        """Draw two different cells."""
        super().reset(seed=seed)
        self._state, self._steps = self.np_random.choice(len(self.grid), 2, replace=False), 0
        return self._state.copy(), {}

    def step(self, action: int) -> tuple[NDArray[np.int64], float, bool, bool, dict[str, Any]]:
        """Move north, south, west or east; the reward is -1, and 0 at the goal."""
        self._state[0] = self.grid.move(int(self._state[0]), int(action))
        self._steps += 1
        terminated = bool(self._state[0] == self._state[1])
        truncated = self._steps >= HORIZON and not terminated
        return self._state.copy(), float(terminated) - 1.0, terminated, truncated, {"is_success": terminated}


def make_goals(grid: Grid) -> GoalSpace:
    """Make a goal of every cell; levels see the cell where they are, and the highest one pursues the episode's goal."""
    cells = np.arange(float(len(grid)))[:, None]
    return GoalSpace(lambda seen: seen[:1].astype(np.float64), cells, find_desired=lambda seen: int(seen[1]),
                     view=GoalView(spaces.Discrete(len(grid)), lambda seen: int(seen[0])))


def run(grid: str, levels: int, seed: int, primitives: int, tests: int = TESTS) -> list[tuple[int, float, float]]:
    """Train HAC; returns primitives, success rate and mean length of an episode for each evaluation after the first."""
    env = GridTask(GRIDS[grid])
    agent = HacFinite(env.observation_space, env.action_space, seed,
                      HacFinite.Settings(levels=levels, attempts=ATTEMPTS[levels], **SETTINGS), make_goals(env.grid))
    result = train(agent, env, primitives=primitives, seed=seed, eval_every=primitives // EVALUATIONS,
                   eval_env=GridTask(env.grid), eval_episodes=tests, progress=False, observed=False)
    return [(each.primitives, float(each.success_rate or 0.0), round(each.mean_length, 1))
            for each in result.evaluations if each.primitives]


def select(rows: Sequence[dict[str, Any]], grid: str, levels: int) -> dict[int, NDArray[np.float64]]:
    """Return success after a tenth and at the end, area and steps of each seed, (4,)."""
    found = {}
    for row in rows:
        if (row["grid"], row["levels"]) == (grid, levels):
            success = [score[1] for score in row["scores"]]
            found[row["seed"]] = np.array((success[0], success[-1], np.mean(success), row["scores"][-1][2]))
    return found


def summarise(rows: Sequence[dict[str, Any]]) -> str:
    """A table with a line for each grid and number of levels: means with 95 % bootstrap intervals over seeds."""
    lines = ["| grid | levels | H | runs | success after a tenth | success at the end | area | steps | CPU s a run |",
             "|---|---|---|---|---|---|---|---|---|"]
    for grid in GRIDS:
        for levels, attempts in ATTEMPTS.items():
            if not (found := select(rows, grid, levels)):
                continue
            cells = [format_mean(values, digits) for values, digits in zip(
                np.array(list(found.values())).T, (2, 2, 2, 1), strict=True)]
            cpu = np.mean([row["seconds"] for row in rows if (row["grid"], row["levels"]) == (grid, levels)])
            lines.append(f"| {grid} | {levels} | {attempts} | {len(found)} | {' | '.join(cells)} | {cpu:.0f} |")
    return "\n".join(lines)


def compare(rows: Sequence[dict[str, Any]]) -> str:
    """A table of differences in area between levels, of the same seeds, as one family of sign-flip tests (Holm)."""
    gaps = {}
    for grid in GRIDS:
        for more, fewer in PAIRS:
            runs = [select(rows, grid, levels) for levels in (more, fewer)]
            both = runs[0].keys() & runs[1].keys()
            gaps[f"{grid} | {more} - {fewer}"] = [runs[0][seed][2] - runs[1][seed][2] for seed in both]
    return show_gaps("grid | levels", "in area", gaps, digits=3)


def main() -> None:
    """Run what is missing, then print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--grids", nargs="+", choices=GRIDS, default=list(GRIDS))
    parser.add_argument("--levels", nargs="+", type=int, choices=ATTEMPTS, default=list(ATTEMPTS))
    parser.add_argument("--seeds", nargs="+", type=int, default=list(range(10, 20)))
    parser.add_argument("--primitives", type=int, default=PRIMITIVES)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("hac-grids.jsonl"))
    parser.add_argument("--table", action="store_true")
    args = parser.parse_args()
    torch.set_num_threads(1)
    cells = [{"grid": grid, "levels": levels, "seed": seed, "primitives": args.primitives}
             for seed in args.seeds for grid in args.grids for levels in args.levels]
    rows = run_missing(args.out, () if args.table else cells, lambda **cell: {"scores": run(**cell)})
    rows = [row for row in rows if row["primitives"] == args.primitives]
    print(summarise(rows), compare(rows), sep="\n\n")


if __name__ == "__main__":
    main()
