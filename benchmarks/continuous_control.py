"""SAC, TD3 and PPO against Stable-Baselines3 on Box actions.

    python -m benchmarks.continuous_control                       # control tasks: hours on a core
    python -m benchmarks.continuous_control --tasks Pendulum-v1 --learners sac sb3-sac --seeds 3 --primitives 5000
    python -m benchmarks.continuous_control --table               # means of the finished runs

Both libraries run at their default settings for the same number of primitives: networks of 256 x 256, minibatches of
256, an update per primitive. Warm-ups differ: 1,000 random primitives here, 100 there, so `--warmup` sets both. `final`
is the mean return of ten greedy episodes at the end of the budget, the same ones for all. Seconds are CPU time.
Finished runs are kept, a line each, in the file `--out`; the command continues a stopped run.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch

from hrl_escape.agents import train
from hrl_escape.agents.training.evaluation import compute_episode_seed

TASKS = {"Pendulum-v1": 20_000, "LunarLanderContinuous-v3": 100_000, "BipedalWalker-v3": 300_000}
"""Task -> primitives of a run."""
LEARNERS = ("sac", "td3", "ppo", "sb3-sac", "sb3-td3", "sb3-ppo")
EPISODES = 10
"""Episodes of the last evaluation."""


def run_own(name: str, task: str, seed: int, primitives: int, warmup: int) -> float:
    """Train an agent of this package; returns the mean return at the end."""
    settings = {} if name == "ppo" else {"warmup": warmup}
    result = train(name, gymnasium.make(task), primitives=primitives, seed=seed, settings=settings,
                   eval_every=primitives, eval_episodes=EPISODES, progress=False, observed=False)
    return result.evaluations[-1].mean_return


def run_peer(name: str, task: str, seed: int, primitives: int, warmup: int) -> float:
    """Train an agent of Stable-Baselines3; returns the mean return at the end, in the same episodes as ours."""
    import stable_baselines3

    kind = getattr(stable_baselines3, name.removeprefix("sb3-").upper())
    more = {} if name == "sb3-ppo" else {"learning_starts": warmup}
    model = kind("MlpPolicy", gymnasium.make(task), seed=seed, device="cpu", **more)
    model.learn(primitives)
    env, returns = gymnasium.make(task), np.zeros(EPISODES)
    for episode in range(EPISODES):
        seen, _ = env.reset(seed=compute_episode_seed(0, "evaluation", episode))
        is_over = False
        while not is_over:
            seen, reward, terminated, truncated, _ = env.step(model.predict(seen, deterministic=True)[0])
            returns[episode] += float(reward)
            is_over = terminated or truncated
    return float(returns.mean())


def list_runs(args: argparse.Namespace) -> Iterator[tuple[str, str, int, int]]:
    """Yield task, learner, seed and primitives of every run."""
    for seed in range(args.seeds):
        for task in args.tasks:
            for learner in args.learners:
                yield task, learner, seed, args.primitives or TASKS[task]


def show(rows: list[dict[str, Any]]) -> None:
    """Print mean, spread and CPU time of each cell."""
    cells = defaultdict(list)
    for row in rows:
        cells[row["task"], row["primitives"], row["learner"]].append(row)
    print("| task | primitives | learner | runs | final, each | mean | CPU s a run |\n|---|---|---|---|---|---|---|")
    for (task, primitives, learner), found in sorted(cells.items()):
        finals = [row["final"] for row in found]
        print(f"| {task} | {primitives:,} | {learner} | {len(found)} | {', '.join(f'{each:.4g}' for each in finals)} | "
              f"{statistics.fmean(finals):.4g} | {statistics.fmean(row['seconds'] for row in found):.0f} |")


def main() -> None:
    """Run what is missing, then print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=list(TASKS))
    parser.add_argument("--learners", nargs="+", default=list(LEARNERS))
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--primitives", type=int, default=0)
    parser.add_argument("--warmup", type=int, default=1_000)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("continuous-control.jsonl"))
    parser.add_argument("--table", action="store_true")
    args = parser.parse_args()
    torch.set_num_threads(1)
    rows = [json.loads(line) for line in args.out.read_text().splitlines()] if args.out.exists() else []
    known = {(row["task"], row["learner"], row["seed"], row["primitives"]) for row in rows}
    for task, learner, seed, primitives in () if args.table else list_runs(args):
        if (task, learner, seed, primitives) in known:
            continue
        started = time.process_time()
        run = run_peer if learner.startswith("sb3-") else run_own
        final = run(learner, task, seed, primitives, args.warmup)
        row = {"task": task, "learner": learner, "seed": seed, "primitives": primitives, "warmup": args.warmup,
               "final": final, "seconds": round(time.process_time() - started, 1)}
        rows.append(row)
        with args.out.open("a") as file:
            file.write(json.dumps(row) + "\n")
    show(rows)


if __name__ == "__main__":
    main()
