"""SAC, TD3 and PPO against Stable-Baselines3 on Box actions.

    python -m benchmarks.continuous_control                       # control tasks: hours on a core
    python -m benchmarks.continuous_control --tasks Pendulum-v1 --learners sac sb3-sac --seeds 3 --primitives 5000
    python -m benchmarks.continuous_control --table               # means and differences of the finished runs
    python -m benchmarks.continuous_control --rates               # primitives learned from in a second, minutes

Both libraries run at their default settings for the same number of primitives: SAC and TD3 have networks of 256 x 256,
minibatches of 256 and an update per primitive, or one in `--every` primitives. Warm-ups differ: 1,000 random primitives
here, 100 there, so `--warmup` sets both. `final` is the mean return of ten greedy episodes at the end of the budget,
the same ones for all; published numbers have more `--episodes`. Seconds are CPU time. Finished runs are kept, a line
each, in the file `--out`; the command continues a stopped run.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch

from benchmarks.finished_runs import run_missing
from hrl_escape.agents import train
from hrl_escape.agents.training.evaluation import compute_episode_seed
from hrl_escape.benchmark.inference import ALPHA, compare_pairs
from studies.statistics import compare_signs

TASKS = {"Pendulum-v1": 20_000, "LunarLanderContinuous-v3": 100_000, "BipedalWalker-v3": 300_000}
"""Task -> primitives of a run."""
LEARNERS = ("sac", "td3", "ppo", "sb3-sac", "sb3-td3", "sb3-ppo")
EPISODES, WARMUP, LEAST = 10, 1_000, 10
"""Episodes of the last evaluation, random primitives at the beginning, and fewest runs of each for a verdict."""
RATED, COUNTS, MOST_OF_PEER, SHORT = "hrl_escape/PointMaze-v1", (1, 64, 4_096), 64, 100
"""Environment of `--rates`, how many of them, most of Stable-Baselines3, which steps them one by one, and random
primitives at the beginning."""


def run_own(name: str, task: str, seed: int, primitives: int, warmup: int, every: int, episodes: int) -> float:
    """Train an agent of this package; returns the mean return at the end."""
    settings = {} if name == "ppo" else {"warmup": warmup, "updates_per_step": 1 / every}
    result = train(name, gymnasium.make(task), primitives=primitives, seed=seed, settings=settings,
                   eval_every=primitives, eval_episodes=episodes, progress=False, observed=False)
    return result.evaluations[-1].mean_return


def run_peer(name: str, task: str, seed: int, primitives: int, warmup: int, every: int, episodes: int) -> float:
    """Train an agent of Stable-Baselines3; returns the mean return at the end, in the same episodes as ours."""
    more: dict[str, Any] = {} if name == "sb3-ppo" else {"learning_starts": warmup, "train_freq": every}
    model = make_peer(name, gymnasium.make(task), seed=seed, **more)
    model.learn(primitives)
    env, returns = gymnasium.make(task), np.zeros(episodes)
    for episode in range(episodes):
        seen, _ = env.reset(seed=compute_episode_seed(0, "evaluation", episode))
        is_over = False
        while not is_over:
            seen, reward, terminated, truncated, _ = env.step(model.predict(seen, deterministic=True)[0])
            returns[episode] += float(reward)
            is_over = terminated or truncated
    return float(returns.mean())


def make_peer(name: str, env: Any, policy: str = "MlpPolicy", **settings: Any) -> Any:
    """Make an agent of Stable-Baselines3."""
    import stable_baselines3

    return getattr(stable_baselines3, name.removeprefix("sb3-").upper())(policy, env, device="cpu", **settings)


def measure_rate(learner: str, count: int) -> float:
    """Primitives that an agent learns from in a second of CPU time at its defaults, in some mazes at once."""
    if learner == "sb3-ppo":
        settings: dict[str, Any] = {"n_steps": 2_048 // count}
    elif learner.startswith("sb3-"):
        settings = {"learning_starts": SHORT}
    else:
        settings = {} if learner == "ppo" else {"warmup": SHORT}

    def run(primitives: int) -> int:
        if learner.startswith("sb3-"):
            from stable_baselines3.common.vec_env import DummyVecEnv

            envs = DummyVecEnv([lambda: gymnasium.make(RATED)] * count)
            return make_peer(learner, envs, "MultiInputPolicy", **settings).learn(primitives).num_timesteps
        env = gymnasium.make(RATED) if count == 1 else gymnasium.make_vec(RATED, num_envs=count)
        return train(learner, env, primitives=primitives, settings=settings, eval_episodes=0, progress=False,
                     observed=False).primitives

    budget = max(2_048, 32 * count)
    run(2 * SHORT)  # modules and kernels are loaded
    started = time.process_time()
    return run(budget) / (time.process_time() - started)


def show_rates(learners: Iterable[str]) -> None:
    """Measure and print the rates of learners, ours in up to 4,096 environments."""
    print("| learner |" + "".join(f" {count:,} |" for count in COUNTS) + "\n|---" + "|---" * len(COUNTS) + "|")
    for learner in learners:
        rates = [f"{measure_rate(learner, count):,.0f}" if count <= MOST_OF_PEER or "-" not in learner else ""
                 for count in COUNTS]
        print(f"| {learner} | {' | '.join(rates)} |", flush=True)


def list_runs(args: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield what identifies every run."""
    for seed in range(args.seeds):
        for task in args.tasks:
            for learner in args.learners:
                yield {"task": task, "learner": learner, "seed": seed, "primitives": args.primitives or TASKS[task],
                       "every": 1 if learner.endswith("ppo") else args.every}


def summarise(rows: list[dict[str, Any]]) -> str:
    """A table with mean, median, spread and CPU time of each cell."""
    cells = defaultdict(list)
    for row in rows:
        cells[row["task"], row["primitives"], row["every"], row["learner"]].append(row)
    lines = ["| task | primitives | learner | runs | final, each | mean | median | CPU s a run |",
             "|---|---|---|---|---|---|---|---|"]
    for (task, primitives, every, learner), found in sorted(cells.items()):
        finals = [row["final"] for row in found]
        budget = f"{primitives:,}" if every == 1 else f"{primitives:,}, an update in {every}"
        lines.append(f"| {task} | {budget} | {learner} | {len(found)} | {' '.join(f'{each:.0f}' for each in finals)} | "
                     f"{statistics.fmean(finals):.0f} | {statistics.median(finals):.0f} | "
                     f"{statistics.fmean(row['seconds'] for row in found):.0f} |")
    return "\n".join(lines)


def compare(rows: list[dict[str, Any]]) -> str:
    """A table of the differences between the libraries in the same seeds, with Student's interval and sign-flip tests.

    Seeds of the two libraries have nothing in common but the evaluation. A verdict needs ten of each.
    """
    finals: dict[Any, dict[str, dict[int, float]]] = defaultdict(lambda: defaultdict(dict))
    for row in rows:
        finals[row["task"], row["primitives"], row["every"]][row["learner"]][row["seed"]] = row["final"]
    lines = ["| task | primitives | agent | pairs | ours - theirs | 95 % interval | p | verdict |",
             "|---|---|---|---|---|---|---|---|"]
    for (task, primitives, _), cell in sorted(finals.items()):
        for name in LEARNERS[: len(LEARNERS) // 2]:
            seeds = sorted(cell[name].keys() & cell[f"sb3-{name}"].keys())
            if len(seeds) < 2:
                continue
            gaps = np.array([cell[name][seed] - cell[f"sb3-{name}"][seed] for seed in seeds])
            p = compare_signs({name: gaps})[name].p
            test, side = compare_pairs([gaps]), "higher" if gaps.mean() > 0 else "lower"
            verdict = "none: few runs" if len(seeds) < LEAST else f"ours {side}" if p < ALPHA else "no difference found"
            lines.append(f"| {task} | {primitives:,} | {name} | {len(seeds)} | {test.difference:+.0f} | "
                         f"{test.low:+.0f} to {test.high:+.0f} | {p:.3f} | {verdict} |")
    return "\n".join(lines)


def main() -> None:
    """Run what is missing, then print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=list(TASKS))
    parser.add_argument("--learners", nargs="+", choices=LEARNERS, default=list(LEARNERS))
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--primitives", type=int, default=0)
    parser.add_argument("--warmup", type=int, default=WARMUP)
    parser.add_argument("--episodes", type=int, default=EPISODES, help="of the evaluation")
    parser.add_argument("--every", type=int, default=1, help="primitives to an update of SAC and TD3")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("continuous-control.jsonl"))
    parser.add_argument("--table", action="store_true")
    parser.add_argument("--rates", action="store_true", help="primitives learned from in a second of CPU time")
    args = parser.parse_args()
    torch.set_num_threads(1)
    if args.rates:
        return show_rates(args.learners)

    def run(learner: str, **cell: Any) -> dict[str, Any]:
        train_it = run_peer if learner.startswith("sb3-") else run_own
        return {"warmup": args.warmup, "episodes": args.episodes,
                "final": train_it(learner, **cell, warmup=args.warmup, episodes=args.episodes)}

    rows = run_missing(args.out, () if args.table else list_runs(args), run)
    print(summarise(rows), compare(rows), sep="\n\n")
    return None


if __name__ == "__main__":
    main()
