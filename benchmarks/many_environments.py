"""Learning from many environments at once: does it learn the same, and how many primitives are learned in a second?

    python -m benchmarks.many_environments curves              # CartPole at 1, 8, 64 and 512 environments, beside SB3
    python -m benchmarks.many_environments rates               # one room at 1 to 4,096, beside SB3
    python -m benchmarks.many_environments options             # options a second, beside the single environment
    python -m benchmarks.many_environments pixels              # frames of the robot's camera, beside Bullet's
    python -m benchmarks.many_environments curves --quick      # seconds: shows that everything runs

`ppo` at its default settings, Stable-Baselines3's PPO (`sb3`) at its own, with 1 and 8 environments. Seconds are of the
process's own processor time, on one thread. Finished runs are kept, a line each, in the file `--out`; the command goes
on where it was stopped.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch

import hrl_escape  # noqa: F401  # registers the rooms
from benchmarks.classic_control import Peer
from hrl_escape.agents import evaluate, train

CURVES, RATES = "CartPole-v1", "hrl_escape/PaperTwoButton-v1"
OPTIONS = "hrl_escape/PaperTwoButtonOptions-v1"
BUDGET, EVALUATIONS, EPISODES = 100_000, 10, 10
PEERS = (1, 8)
PICTURED = ("PaperTwoButton", "Clutter")
RATE_SETTINGS: dict[str, dict[str, Any]] = {"10 epochs": {}, "4 epochs": {"epochs": 4}}


def train_ours(count: int, seed: int, budget: int) -> list[float]:
    """Mean returns of `ppo` in CartPole after each share of the budget."""
    env: Any = gymnasium.make(CURVES) if count == 1 else gymnasium.make_vec(CURVES, num_envs=count)
    result = train("ppo", env, primitives=budget, seed=seed, eval_every=budget // EVALUATIONS, eval_episodes=EPISODES,
                   progress=False)
    at, returns = result.curve()
    marks = [budget * (n + 1) // EVALUATIONS for n in range(EVALUATIONS)]
    return [float(returns[min(int(np.searchsorted(at, mark)), len(at) - 1)]) for mark in marks]


def train_peer(count: int, seed: int, budget: int) -> list[float]:
    """The same of Stable-Baselines3's PPO."""
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env

    model = PPO("MlpPolicy", make_vec_env(CURVES, n_envs=count, seed=seed), seed=seed, device="cpu")
    scores: list[float] = []
    eval_env = gymnasium.make(CURVES)
    for _ in range(EVALUATIONS):
        model.learn(budget // EVALUATIONS, reset_num_timesteps=False)
        scores.append(evaluate(Peer(model), eval_env, EPISODES, seed=0).mean_return)
    return scores


def measure_ours(count: int, budget: int, settings: dict[str, Any]) -> float:
    """Primitives of a room that `ppo` learns from in a second of processor time."""
    env: Any = (gymnasium.make(RATES, observation="features") if count == 1 else
                gymnasium.make_vec(RATES, num_envs=count, output="torch", observation="features"))
    started = time.process_time()
    result = train("ppo", env, primitives=budget, eval_episodes=0, progress=False, settings=settings)
    return result.primitives / (time.process_time() - started)


def measure_peer(count: int, budget: int) -> float:
    """The same of Stable-Baselines3's PPO."""
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env

    env = make_vec_env(lambda: gymnasium.make(RATES, observation="features"), n_envs=count)
    model = PPO("MlpPolicy", env, n_steps=2048 // count, device="cpu")
    started = time.process_time()
    model.learn(budget)
    return model.num_timesteps / (time.process_time() - started)


def measure_options(contender: str, count: int, quick: bool) -> float:
    """Masked random options that end in a second of processor time."""
    arguments = {"observation": "features", "include_primitives": False}
    rng, steps = np.random.default_rng(0), 20 if quick else 60
    if contender == "single":
        env: Any = gymnasium.make(OPTIONS, **arguments)
        _, info = env.reset(seed=0)
        started = 0.0
        for number in range(50 + 10 * steps):
            if number == 50:  # kernels are loaded, and some plans remembered
                started = time.process_time()
            *_, terminated, truncated, info = env.step(int(rng.choice(np.flatnonzero(info["action_mask"]))))
            if terminated or truncated:
                _, info = env.reset()
        return 10 * steps / (time.process_time() - started)
    env = gymnasium.make_vec(OPTIONS, num_envs=count, output="torch", autoreset_mode="SameStep",
                             compile=contender.endswith("compiled"), **arguments)
    if contender == "vector environment":
        _, info = env.reset(seed=0)
        started = time.process_time()
        for _ in range(steps // 5):
            *_, info = env.step(torch.multinomial(info["action_mask"].float(), 1).squeeze(1))
        return count * (steps // 5) / (time.process_time() - started)
    streams: Any = env.unwrapped
    streams, ended = streams.get_streams(), 0
    streams.reset(0)
    for _ in range(2):  # kernels are compiled or loaded
        streams.step(torch.multinomial(streams.action_mask.float(), 1).squeeze(1))
    started = time.process_time()
    for _ in range(steps):
        ended += int(streams.step(torch.multinomial(streams.action_mask.float(), 1).squeeze(1)).where.sum())
    return ended / (time.process_time() - started)


def measure_pixels(contender: str, count: int, room: str, quick: bool) -> float:
    """Frames of the robot's camera, 84 x 84, that are taken in a second of processor time."""
    rounds = 2 if quick else 5
    if contender == "single":
        view: dict[str, Any] = {"render_mode": "rgb_array", "camera": "robot", "render_size": (84, 84)}
        env: Any = gymnasium.make(f"hrl_escape/{room}-v1", **view)
        env.reset(seed=0)
        env.render()
        started = time.process_time()
        for _ in range(20 * rounds):
            env.render()
        return 20 * rounds / (time.process_time() - started)
    env = gymnasium.make_vec(f"hrl_escape/{room}-v1", num_envs=count).unwrapped
    env.reset(seed=0)
    env.take_pictures()
    started = time.process_time()
    for _ in range(rounds):
        env.take_pictures()
    return rounds * count / (time.process_time() - started)


def list_runs(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """What each run is, without its outcome."""
    if arguments.what == "curves":
        return [{"what": "curves", "contender": contender, "count": count, "seed": seed}
                for seed in arguments.seeds
                for contender, counts in (("ppo", arguments.counts), ("sb3", PEERS)) for count in counts]
    if arguments.what == "options":
        return [{"what": "options", "contender": contender, "count": count, "round": number}
                for number in range(arguments.rounds)
                for contender, counts in (("single", [1]), ("vector environment", arguments.counts),
                                          ("own pace", arguments.counts), ("own pace, compiled", arguments.counts))
                for count in counts]
    if arguments.what == "pixels":
        return [{"what": "pixels", "contender": contender, "count": count, "round": number, "room": room}
                for number in range(arguments.rounds) for room in PICTURED
                for contender, counts in (("single", [1]), ("batch", arguments.counts))
                for count in counts]
    return [{"what": "rates", "contender": contender, "count": count, "round": number}
            for number in range(arguments.rounds)
            for contender, counts in (*((name, arguments.counts) for name in RATE_SETTINGS), ("sb3", PEERS))
            for count in counts]


def execute(run: dict[str, Any], quick: bool) -> dict[str, Any]:
    """Outcome of a run."""
    count, peer = run["count"], run["contender"] == "sb3"
    if run["what"] == "curves":
        budget = BUDGET // 50 if quick else BUDGET
        return {"scores": (train_peer if peer else train_ours)(count, run["seed"], budget)}
    if run["what"] == "options":
        return {"rate": measure_options(run["contender"], count, quick)}
    if run["what"] == "pixels":
        return {"rate": measure_pixels(run["contender"], count, run["room"], quick)}
    budget = 4_096 if quick or peer or count <= 8 else 64 * count
    rate = measure_peer(count, budget) if peer else measure_ours(count, budget, RATE_SETTINGS[run["contender"]])
    return {"rate": rate}


def summarise(rows: list[dict[str, Any]], what: str) -> str:
    """A table with a line for each contender and number of environments."""
    groups: dict[tuple[str, int], list[dict[str, Any]]] = {}
    for row in rows:
        if row["what"] == what:
            groups.setdefault((row["contender"], row["count"]), []).append(row)
    if what != "curves":
        median = {key: float(np.median([row["rate"] for row in found])) for key, found in groups.items()}
        peer, unit = {"rates": ("sb3", "primitives"), "options": ("single", "options"),
                      "pixels": ("single", "frames")}[what]
        base = median.get((peer, 1), float("nan"))
        lines = [f"| contender | environments | {unit} a second | to {peer} with one |", "|---|---|---|---|"]
        return "\n".join([*lines, *(f"| {name} | {count:,} | {rate:,.0f} | {rate / base:.1f} |"
                                    for (name, count), rate in median.items())])
    lines = ["| contender | environments | runs | at a tenth | at three tenths | half | end | end at 475 |",
             "|---|---|---|---|---|---|---|---|"]
    for (name, count), found in sorted(groups.items()):
        scores = np.array([row["scores"] for row in found])
        means = " | ".join(f"{scores[:, at].mean():.0f}" for at in (0, 2, 4, -1))
        held = f"{(scores[:, -1] >= 475).sum()} of {len(found)}"
        lines.append(f"| {name} | {count:,} | {len(found)} | {means} | {held} |")
    return "\n".join(lines)


def main() -> None:
    """Run what is missing, then print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["curves", "rates", "options", "pixels"])
    parser.add_argument("--counts", nargs="+", type=int, help="numbers of environments")
    parser.add_argument("--seeds", nargs="+", type=int, default=list(range(10)))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--out", type=Path, default=Path("many_environments.jsonl"), help="where runs are kept")
    parser.add_argument("--quick", action="store_true", help="small budgets, one seed")
    arguments = parser.parse_args()
    if arguments.counts is None:
        arguments.counts = {"curves": [1, 8, 64, 512], "rates": [1, 8, 64, 512, 4096], "options": [256, 2048],
                            "pixels": [64]}[
            arguments.what]
    if arguments.quick:
        arguments.seeds, arguments.rounds = arguments.seeds[:1], 1
    torch.set_num_threads(1)
    rows = [json.loads(line) for line in arguments.out.read_text().splitlines()] if arguments.out.exists() else []
    for run in list_runs(arguments):
        if not any(row.items() >= run.items() for row in rows):
            rows.append(run | execute(run, arguments.quick))
            with arguments.out.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
            print(rows[-1], flush=True)
    for room in PICTURED if arguments.what == "pixels" else [None]:
        print(*([] if room is None else [f"\n{room}\n"]), sep="", end="")
        print(summarise([row for row in rows if row.get("room") == room], arguments.what))


if __name__ == "__main__":
    main()
