"""HAC on the inverted pendulum of its authors, with one to three levels.

    python -m benchmarks.hac_pendulum                          # ten seeds of each number of levels
    python -m benchmarks.hac_pendulum --levels 2 --seeds 0 1   # two runs
    python -m benchmarks.hac_pendulum --table                  # tables of the finished runs

The task has the constants of the authors' program, and MuJoCo's step of a hinge. Training goals are near the top, and
100 test episodes without noise begin anywhere but there and end within the tolerance of rest at the top. The settings
follow the program (`PUBLISHED`), except that 128 pendulums step together, and that after each step every level makes
4 updates from minibatches of 256. There, one pendulum moves, and 40 updates from minibatches of 1,024 follow an
episode. Finished runs are kept, a line each, in the file `--out`, by default `benchmarks/hac-pendulum.jsonl`; the
command continues a stopped run.

Levy, Konidaris, Platt and Saenko (2019); github.com/andrew-j-levy/Hierarchical-Actor-Critc-HAC-.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from benchmarks.finished_runs import run_missing
from benchmarks.point_mazes import Measuring, format_mean
from hrl_escape.agents import train
from hrl_escape.agents.decisions import Moments, Policy
from studies.statistics import LEAST_RUNS, compare_signs

MASS, LENGTH, RADIUS, DAMPING, GRAVITY, TORQUE = 1.0, 0.5, 0.05, 0.1, 9.81, 2.0
"""Ball at the end of a pole without mass: kg, m, m, N m s, m/s^2, and largest torque, N m."""
INERTIA = MASS * (LENGTH**2 + 0.4 * RADIUS**2)
TIME_STEP, REPEATS, MOST_ACTIONS = 0.002, 10, 1_000
"""Step of the simulation, s, steps of an action, and actions of an episode."""
TOLERANCE = np.array((np.deg2rad(9.5), 0.6))
"""Largest differences from a goal that counts as reached, rad and rad/s."""
GOALS, MOST_SPEED = np.array((np.deg2rad(16), 0.6)), 15.0
"""Training goals are drawn up to this far from rest at the top; speeds are clipped in goals."""
PENDULUMS, PRIMITIVES, EVALUATIONS, TESTS = 128, 1_048_576, 8, 100
"""Pendulums that step together, primitives of a run, evaluations after equal parts of it, and their episodes."""
ATTEMPTS = {1: MOST_ACTIONS, 2: 32, 3: 10}
"""Levels -> H, choices of a level for a goal."""
PAIRS = ((2, 1), (3, 1), (3, 2))
"""Numbers of levels that are compared."""
PUBLISHED: dict[str, Any] = {
    "gamma": 0.98, "goal_tolerances": TOLERANCE.tolist(), "hidden": [64, 64, 64], "learning_rate": 1e-3,
    "scale_observations": False, "warmup": 0, "subgoal_tests": 0.3, "hindsight_goals": 3, "random_share": 0.2,
    "noise": 0.1}
"""Settings of the authors' program."""
UPDATES: dict[str, Any] = {"batch_size": 256, "updates_per_step": 4 / PENDULUMS, "max_updates": 4}
"""Settings of the updates."""


def swing(state: NDArray[np.float64], torque: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return angles from the top and speeds after an action, (2, n), by Euler's method with implicit damping."""
    angle, speed = state
    for _ in range(REPEATS):
        moment = torque + MASS * GRAVITY * LENGTH * np.sin(angle) - DAMPING * speed
        speed = speed + TIME_STEP * moment / (INERTIA + TIME_STEP * DAMPING)
        angle = angle + TIME_STEP * speed
    return np.stack((angle, speed))


def draw_state(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Draw states at least 45 degrees from the top, almost at rest, (2, count)."""
    return np.stack((rng.uniform(np.pi / 4, 7 * np.pi / 4, count), rng.uniform(-0.05, 0.05, count)))


def observe(state: NDArray[np.float64], goal: NDArray[np.float64]) -> dict[str, NDArray[np.float32]]:
    """Return observations of states (2, n) and goals (n, 2): cosine, sine and speed; angle and clipped speed."""
    angle, speed = state
    achieved = np.stack(((angle + np.pi) % (2 * np.pi) - np.pi, speed.clip(-MOST_SPEED, MOST_SPEED)), axis=1)
    return {"achieved_goal": achieved.astype(np.float32), "desired_goal": goal.astype(np.float32),
            "observation": np.stack((np.cos(angle), np.sin(angle), speed), axis=1).astype(np.float32)}


def is_near(achieved: NDArray[np.float32], goal: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which achieved goals (n, 2) are within the tolerance of goals."""
    return np.asarray((np.abs(achieved - goal) <= TOLERANCE).all(axis=1))


class Pendulums(VectorEnv):
    """Swing pendulums up to an angle and a speed, with a torque that is too small to lift them directly.

    Observations are arrays, a Dict with goals; rewards are -1, and 0 at the goal. Episodes reset in the same step.

    Args:
        num_envs: number of pendulums.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}

    def __init__(self, num_envs: int) -> None:
        top = np.array((np.pi, MOST_SPEED), np.float32)
        goals, free = spaces.Box(-top, top), spaces.Box(-np.inf, np.inf, (3,), np.float32)
        self.single_observation_space = spaces.Dict(
            {"achieved_goal": goals, "desired_goal": goals, "observation": free})
        self.single_action_space, self.num_envs = spaces.Box(-TORQUE, TORQUE, (1,), np.float32), num_envs
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._state, self._goal, self._steps = np.zeros((2, num_envs)), np.zeros((num_envs, 2)), np.zeros(num_envs, int)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None
              ) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
        """Begin an episode of each pendulum with a goal of training; a seed is one number for all."""
        super().reset(seed=seed)
        self._begin(np.ones(self.num_envs, dtype=bool))
        return observe(self._state, self._goal), {}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Apply torques, N m, (num_envs, 1), for 0.02 s."""
        self._state = swing(self._state, np.asarray(actions, np.float64)[:, 0].clip(-TORQUE, TORQUE))
        self._steps += 1
        seen = observe(self._state, self._goal)
        reached = is_near(seen["achieved_goal"], self._goal)
        truncated = (self._steps >= MOST_ACTIONS) & ~reached
        over, infos = reached | truncated, dict[str, Any]()
        if over.any():
            infos = {"final_obs": seen, "_final_obs": over, "final_info": {}, "_final_info": over}
            self._begin(over)
            seen = observe(self._state, self._goal)
        return seen, reached - 1.0, reached, truncated, infos

    def _begin(self, which: NDArray[np.bool_]) -> None:
        self._state = np.where(which, draw_state(self.np_random, self.num_envs), self._state)
        drawn = self.np_random.uniform(-GOALS, GOALS, (self.num_envs, 2))
        self._goal, self._steps = np.where(which[:, None], drawn, self._goal), np.where(which, 0, self._steps)


class ShortPendulum(gymnasium.Env):
    """A pendulum whose episodes end after one step, for evaluations that are not used."""

    def __init__(self) -> None:
        self._env = Pendulums(1)
        self.observation_space, self.action_space = self._env.single_observation_space, self._env.single_action_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        return {name: rows[0] for name, rows in self._env.reset(seed=seed)[0].items()}, {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """End the episode."""
        return {name: rows[0] for name, rows in self._env.step(action[None])[0].items()}, -1.0, False, True, {}


def measure(policy: Policy) -> tuple[float]:
    """Return the share of `TESTS` episodes in which a policy reaches rest at the top."""
    rng = np.random.default_rng(1_000)
    state, goal = draw_state(rng, TESTS), np.zeros((TESTS, 2))
    policy.begin_episode(rng, TESTS)
    none, won = torch.ones((TESTS, 0), dtype=torch.bool), np.zeros(TESTS, dtype=bool)
    seen = observe(state, goal)
    for _ in range(MOST_ACTIONS):
        rows = np.flatnonzero(~won)
        if not len(rows):
            break
        flat = torch.from_numpy(np.concatenate([seen[name][rows] for name in sorted(seen)], axis=1))
        action = policy.act(Moments(torch.from_numpy(rows), flat, none[rows]))
        state[:, rows] = swing(state[:, rows], np.asarray(action, np.float64)[:, 0])
        seen = observe(state, goal)
        won |= is_near(seen["achieved_goal"], goal)
    return (float(won.mean()),)


def run(levels: int, seed: int, primitives: int, num_envs: int = PENDULUMS) -> list[tuple[Any, ...]]:
    """Train HAC; returns primitives and success rate of each evaluation."""
    measuring = Measuring(measure)
    settings = PUBLISHED | UPDATES | {"levels": levels, "attempts": ATTEMPTS[levels]}
    train("hac", Pendulums(num_envs), primitives=primitives, seed=seed, settings=settings,
          eval_every=primitives // EVALUATIONS, eval_env=ShortPendulum(), eval_episodes=1, callbacks=[measuring],
          progress=False, observed=False)
    return measuring.scores


def summarise(rows: Sequence[dict[str, Any]]) -> str:
    """A table with a line for each number of levels: means with 95 % bootstrap intervals over seeds."""
    lines = ["| levels | H | runs | success at the end | best of 8 | mean of 8 | best, each seed | CPU s a run |",
             "|---|---|---|---|---|---|---|---|"]
    for levels, attempts in ATTEMPTS.items():
        if not (found := [row for row in rows if row["levels"] == levels]):
            continue
        scores = np.array([[success for _, success in row["scores"]] for row in found])
        best = scores.max(axis=1)
        cells = map(format_mean, (scores[:, -1], best, scores.mean(axis=1)))
        lines.append(f"| {levels} | {attempts} | {len(found)} | {' | '.join(cells)} | "
                     f"{' '.join(f'{each:.2f}' for each in best)} | "
                     f"{np.mean([row['seconds'] for row in found]):.0f} |")
    return "\n".join(lines)


def compare(rows: Sequence[dict[str, Any]]) -> str:
    """A table of differences between levels at the end, of the same seeds, as one family of sign-flip tests (Holm)."""
    ends = {levels: {row["seed"]: row["scores"][-1][1] for row in rows if row["levels"] == levels}
            for levels in ATTEMPTS}
    gaps = {f"{more} - {fewer}": [ends[more][seed] - ends[fewer][seed] for seed in ends[more].keys() & ends[fewer]]
            for more, fewer in PAIRS}
    return show_gaps("levels", "at the end", gaps)


def show_gaps(heads: str, measure: str, gaps: Mapping[str, Sequence[float]], digits: int = 2) -> str:
    """A table of mean differences as one family of sign-flip tests (Holm), or no text below ten pairs.

    Args:
        heads: of the first columns.
        measure: completes "difference".
        gaps: first cells of a line -> differences of the same seeds.
        digits: of a difference, after the point.
    """
    tested = compare_signs({name: own for name, own in gaps.items() if len(own) >= LEAST_RUNS})
    lines = [f"| {heads} | pairs | difference {measure} | interval | p, Holm |", "|---" * (heads.count("|") + 5) + "|"]
    for name, test in tested.items():
        cells = [f"{value:+.{digits}f}" for value in (test.mean, test.low, test.high)]
        lines.append(f"| {name} | {len(gaps[name])} | {cells[0]} | {cells[1]} to {cells[2]} | {test.p:.3f} |")
    return "\n".join(lines) if tested else ""


def main() -> None:
    """Run what is missing, then print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--levels", nargs="+", type=int, choices=ATTEMPTS, default=list(ATTEMPTS))
    parser.add_argument("--seeds", nargs="+", type=int, default=list(range(10)))
    parser.add_argument("--primitives", type=int, default=PRIMITIVES)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("hac-pendulum.jsonl"))
    parser.add_argument("--table", action="store_true")
    args = parser.parse_args()
    torch.set_num_threads(1)
    cells = [{"levels": levels, "seed": seed, "primitives": args.primitives}
             for seed in args.seeds for levels in args.levels]
    rows = run_missing(args.out, () if args.table else cells, lambda **cell: {"scores": run(**cell)})
    rows = [row for row in rows if row["primitives"] == args.primitives]
    print(summarise(rows), compare(rows), sep="\n\n")


if __name__ == "__main__":
    main()
