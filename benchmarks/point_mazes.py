"""Goal hierarchies, their ablations, and flat agents with and without hindsight in point mazes.

    python -m benchmarks.point_mazes --mazes u medium                 # ten seeds of each learner
    python -m benchmarks.point_mazes --learners hiro --seeds 0 1      # two runs
    python -m benchmarks.point_mazes --trials                         # the settings of `TRIALS`, on seeds from 100
    python -m benchmarks.point_mazes --table                          # tables and figure of the finished runs
    python -m benchmarks.point_mazes --exploration                    # how often random goals escape a room

256 mazes step together, or 1,024 large ones. After each step, every learner makes 4 updates of each of its levels, from
minibatches of 256 and with networks of 64 x 64. After equal parts of the budget, the policy without noise runs 128
episodes, the same ones for every learner and seed. `success` is the share that reaches the goal, `area` the mean of it
over the evaluations, and `steps` the mean length of an episode. Seconds are CPU time. Finished runs are kept, a line
each, in the file `--out`, by default `benchmarks/point-mazes.jsonl`; the command continues a stopped run.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import torch

import hrl_escape  # noqa: F401  # registers the environments
from benchmarks.finished_runs import run_missing
from hrl_escape.agents import train
from hrl_escape.agents.agent import Agent
from hrl_escape.agents.decisions import Moments, Policy
from hrl_escape.agents.training.callbacks import Callback
from hrl_escape.agents.training.results import Evaluation
from hrl_escape.benchmark.inference import compare_pairs, correct_by_holm
from hrl_escape.env.continuous_vector_env import EscapeRoomContinuousVectorEnv
from hrl_escape.env.presets import continuous_four_rooms
from studies.statistics import compute_sign_flip_p


class Scale(NamedTuple):
    """Size of a run.

    Attributes:
        num_envs: mazes that step together.
        primitives: of all mazes together.
        evaluations: after equal parts of the primitives.
    """

    num_envs: int
    primitives: int
    evaluations: int


EPISODES, FIGURE = 128, Path(__file__).parents[1] / "docs/images/point-mazes.svg"
"""Episodes of an evaluation, and the file of the curves."""
SCALES = {"u": Scale(256, 49_152, 3), "medium": Scale(256, 98_304, 3), "large": Scale(1_024, 1_048_576, 8),
          "four-rooms": Scale(256, 98_304, 3)}
"""Maze -> size of its runs."""
COMMON: dict[str, Any] = {"hidden": [64, 64], "batch_size": 256, "max_batch_size": 256, "max_updates": 4,
                          "scale_observations": True}
SLOW, FAST = {"learning_rate": 3e-4, "target_rate": 0.005}, {"learning_rate": 1e-3, "target_rate": 0.05}
GOALS = {"goal_range": [1.5, 1.5]}
TRIALS: dict[str, tuple[dict[str, Any], ...]] = {
    "hiro": (GOALS | FAST, GOALS | SLOW), "hrac": tuple(GOALS | FAST | {"adjacency_bins": bins} for bins in (6, 9, 24)),
    "hac": ({"learning_rate": 1e-3}, {"learning_rate": 3e-4}),
    "td3": (FAST, SLOW), "td3-hindsight": (FAST, SLOW), "sac": (FAST, SLOW), "sac-hindsight": (FAST, SLOW)}
"""Settings that were tried for each learner on seeds from 100. The first of each are those of the study."""
CHANGES: dict[str, dict[str, Any]] = {
    "td3-hindsight": {"hindsight_goals": 4}, "sac-hindsight": {"hindsight_goals": 4},
    "hiro-uncorrected": {"correction": False}, "hac-untested": {"subgoal_tests": 0.0}}
"""Settings that make a variant of the agent before the hyphen; ablations keep the agent's settings."""
LEARNERS = ("hiro", "hiro-uncorrected", "hrac", "hac", "hac-untested", "td3", "td3-hindsight", "sac", "sac-hindsight")
CURVES = ("hiro", "hrac", "hac", "td3-hindsight", "td3", "sac-hindsight")
"""Learners in the figure."""
PAIRS = (("hiro", "hiro-uncorrected"), ("hrac", "hiro"), ("hac", "hac-untested"), ("hac", "hiro"),
         ("hiro", "td3-hindsight"), ("hiro", "sac-hindsight"), ("hac", "td3-hindsight"), ("td3-hindsight", "td3"),
         ("sac-hindsight", "sac"))
"""Learners that are compared seed by seed."""


def measure(policy: Policy, maze: str) -> tuple[float, float]:
    """Run the first episode of each of many mazes; returns success rate and mean length in steps."""
    env = gymnasium.make_vec("hrl_escape/PointMaze-v1", num_envs=EPISODES, maze=maze)
    seen, _ = env.reset(seed=1_000)
    policy.begin_episode(np.random.default_rng(0), EPISODES)
    rows, none = torch.arange(EPISODES), torch.ones((EPISODES, 0), dtype=torch.bool)
    over, won, steps = torch.zeros(EPISODES, dtype=torch.bool), torch.zeros(EPISODES), torch.zeros(EPISODES)
    while not bool(over.all()):
        flat = torch.cat([seen[name] for name in sorted(seen)], dim=1)
        seen, _, terminated, truncated, _ = env.step(policy.act(Moments(rows, flat, none)))
        steps += ~over
        won += terminated & ~over
        over |= terminated | truncated
    return round(float(won.mean()), 4), round(float(steps.mean()), 1)


class Measuring(Callback):
    """Keeps primitives and measures of each evaluation after the beginning.

    Args:
        measure: returns the measures of a policy.
    """

    def __init__(self, measure: Callable[[Policy], tuple[float, ...]]) -> None:
        self._measure, self.scores = measure, list[tuple[Any, ...]]()

    def on_evaluation(self, agent: Agent, evaluation: Evaluation) -> bool:
        """Evaluate the agent without noise."""
        if evaluation.primitives:
            self.scores.append((evaluation.primitives, *self._measure(agent.make_policy())))
        return False


def run(learner: str, maze: str, seed: int, primitives: int, trial: int = 0) -> list[tuple[Any, ...]]:
    """Train a learner; returns primitives, success rate and steps of each evaluation."""
    base = learner.partition("-")[0]
    settings = COMMON | TRIALS.get(learner, TRIALS[base])[trial] | CHANGES.get(learner, {})
    scale = SCALES[maze]
    env = gymnasium.make_vec("hrl_escape/PointMaze-v1", num_envs=scale.num_envs, maze=maze)
    unused = gymnasium.make("hrl_escape/PointMaze-v1", maze=maze, max_steps=1)
    measuring = Measuring(partial(measure, maze=maze))
    train(base, env, primitives=primitives, seed=seed, settings=settings,
          eval_every=primitives // scale.evaluations, eval_env=unused, eval_episodes=1, callbacks=[measuring],
          progress=False, observed=False)
    return measuring.scores


def explore(random_start: bool, window: int, reach: float) -> float:
    """Return the share of episodes that escape from `continuous-four-rooms` by random goals and a perfect worker.

    Args:
        random_start: of the preset.
        window: steps of a goal; 1 draws velocities evenly instead.
        reach: largest distance of a goal along each axis, m.
    """
    rooms, generator = 512, torch.Generator().manual_seed(0)
    env = EscapeRoomContinuousVectorEnv(rooms, continuous_four_rooms(random_start=random_start), output="torch")
    top = env.velocities.speed * env.velocities.time_step
    seen, _ = env.reset(seed=0)
    goal, (won, over) = seen[:, :2], torch.zeros((2, rooms), dtype=torch.bool)
    for step in itertools.count():
        if bool(over.all()):
            break
        drawn = 2 * torch.rand((rooms, 2), generator=generator) - 1
        if step % window == 0:
            goal = seen[:, :2] + reach * drawn
        rates = drawn if window == 1 else ((goal - seen[:, :2]) / top).clamp(-1, 1)
        seen, _, terminated, truncated, _ = env.step(torch.cat((rates, torch.zeros((rooms, 1))), dim=1))
        won |= terminated & ~over
        over |= terminated | truncated
    return float(won.float().mean())


def select(rows: Sequence[dict[str, Any]], maze: str, learner: str) -> dict[int, np.ndarray]:
    """Return success rate, area and steps of each seed, (3,)."""
    return {row["seed"]: np.array((row["scores"][-1][1], np.mean([score[1] for score in row["scores"]]),
                                   row["scores"][-1][2]))
            for row in rows if (row["maze"], row["learner"]) == (maze, learner)}


def summarise(rows: Sequence[dict[str, Any]]) -> str:
    """A table with a line for each maze and learner: means with 95 % bootstrap intervals over seeds."""
    lines = ["| maze | learner | runs | success at the end | area | steps | success of each seed | CPU s a run |",
             "|---|---|---|---|---|---|---|---|"]
    for maze in SCALES:
        for learner in LEARNERS:
            if not (found := select(rows, maze, learner)):
                continue
            cells = []
            for number, digits in enumerate((2, 2, 0)):
                cells.append(format_mean(np.array([found[seed][number] for seed in sorted(found)]), digits))
            each = " ".join(f"{found[seed][0]:.2f}" for seed in sorted(found))
            cpu = np.mean([row["seconds"] for row in rows if (row["maze"], row["learner"]) == (maze, learner)])
            lines.append(f"| {maze} | {learner} | {len(found)} | {' | '.join(cells)} | {each} | {cpu:.0f} |")
    return "\n".join(lines)


def draw_curves(rows: Sequence[dict[str, Any]], path: Path = FIGURE) -> None:
    """Draw the success rate of the learners of `CURVES` against primitives, with a panel for each maze.

    A line is the mean over seeds, its area the 95 % bootstrap interval.
    """
    from hrl_escape.figures import LINES, get_figure_class, save_figure

    mazes = [maze for maze in SCALES if any(row["maze"] == maze for row in rows)]
    down = math.ceil(len(mazes) / 2)
    figure = get_figure_class()(figsize=(6.4, 0.6 + 2.4 * down), layout="constrained")
    panels = figure.subplots(down, 2, sharey=True, squeeze=False)
    for axes in panels.flat[len(mazes):]:
        axes.remove()
    for axes, maze in zip(panels.flat, mazes, strict=False):
        for learner, colour in zip(CURVES, LINES, strict=False):
            runs = np.array([row["scores"] for row in rows if (row["maze"], row["learner"]) == (maze, learner)])
            if len(runs):
                low, mean, high = estimate_mean(runs[:, :, 1])
                axes.plot(runs[0, :, 0] / 1_000, mean, color=colour, label=learner, marker=".")
                axes.fill_between(runs[0, :, 0] / 1_000, low, high, color=colour, alpha=0.2, linewidth=0)
        axes.set(title=maze, xlabel="primitives / 1,000", ylim=(0, 1), xlim=(0, None))
    for axes in panels[:, 0]:
        axes.set_ylabel("success rate")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize="small")
    save_figure(path, figure)


def estimate_mean(values: np.ndarray) -> np.ndarray:
    """Low end of a 95 % bootstrap interval, mean, and high end over seeds, (3, ...) of (seeds, ...)."""
    draws = np.random.default_rng(0).integers(len(values), size=(10_000, len(values)))
    low, high = np.percentile(values[draws].mean(axis=1), (2.5, 97.5), axis=0)
    return np.stack((low, values.mean(axis=0), high))


def format_mean(values: np.ndarray, digits: int = 2) -> str:
    """Return the mean of (seeds,) with its interval, for a table."""
    low, mean, high = estimate_mean(values)
    return f"{mean:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


def compare(rows: Sequence[dict[str, Any]]) -> str:
    """A table of differences between two learners with the same seeds, in success at the end and in area.

    Each difference has Student's interval and a sign-flip test. The verdict distinguishes two learners if Holm's
    correction over all lines of the maze leaves p below 0.05.
    """
    lines = ["| maze | first, second | measure | pairs | difference | 95 % interval | p, Holm | verdict |",
             "|---|---|---|---|---|---|---|---|"]
    for maze in SCALES:
        found = []
        for pair in PAIRS:
            runs = [select(rows, maze, learner) for learner in pair]
            seeds = sorted(runs[0].keys() & runs[1].keys())
            for number, name in enumerate(("success", "area") if len(seeds) > 1 else ()):
                gaps = np.array([runs[0][seed][number] - runs[1][seed][number] for seed in seeds])
                p = min(1.0, *(2 * compute_sign_flip_p(gaps, side) for side in ("above", "below")))
                found.append((pair, name, gaps, p))
        for (pair, name, gaps, _), p in zip(found, correct_by_holm([each[-1] for each in found]), strict=True):
            test = compare_pairs([gaps])
            side = "higher" if test.difference > 0 else "lower"
            lines.append(f"| {maze} | {', '.join(pair)} | {name} | {test.pairs} | {test.difference:+.2f} | "
                         f"{test.low:+.2f} to {test.high:+.2f} | {p:.3f} | "
                         f"{f'{pair[0]} {side}' if p < 0.05 else 'no significant difference'} |")
    return "\n".join(lines) if len(lines) > 2 else ""


def main() -> None:
    """Run what is missing, then print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mazes", nargs="+", choices=SCALES, default=["u"])
    parser.add_argument("--learners", nargs="+", choices=LEARNERS, default=list(LEARNERS))
    parser.add_argument("--seeds", nargs="+", type=int)
    parser.add_argument("--trials", action="store_true", help="try all settings of `TRIALS`, on seed 100 by default")
    parser.add_argument("--primitives", type=int, help="budget of a run, instead of the maze's")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("point-mazes.jsonl"))
    parser.add_argument("--table", action="store_true")
    parser.add_argument("--exploration", action="store_true", help="random goals in a room, without learning")
    args = parser.parse_args()
    torch.set_num_threads(1)
    if args.exploration:
        print("| starts | steps of a goal | goals within, m | escaped |\n|---|---|---|---|")
        for random_start in (True, False):
            for window, reach in ((1, 0.0), (20, 2.0), (20, 4.0)):
                share = explore(random_start, window, reach)
                print(f"| {'any cell' if random_start else 'south-west room'} | {window} | {reach} | {share:.1%} |")
        return
    seeds = args.seeds or ([100] if args.trials else list(range(10)))
    cells = [{"maze": maze, "learner": learner, "seed": seed, "trial": trial,
              "primitives": args.primitives or SCALES[maze].primitives}
             for maze in args.mazes for seed in seeds for learner in args.learners
             for trial in (range(len(TRIALS.get(learner, ()))) if args.trials else (0,))]
    rows = run_missing(args.out, () if args.table else cells, lambda **cell: {"scores": run(**cell)})
    rows = [row for row in rows if row["seed"] in seeds and row["trial"] == 0]
    print(summarise(rows), compare(rows), sep="\n\n")
    if args.table:
        draw_curves(rows)


if __name__ == "__main__":
    main()
