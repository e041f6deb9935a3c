"""Many environments at once: how many primitives are learned from in a second, options run, pictures taken?

    python -m benchmarks.many_environments rates               # one room at 1 to 4,096, against SB3
    python -m benchmarks.many_environments rates --counts 4096 --threads 2    # both cores at work
    python -m benchmarks.many_environments options             # options a second, against the single environment
    python -m benchmarks.many_environments decisions           # options a second that are learned from
    python -m benchmarks.many_environments pixels              # frames of the robot's camera, against Bullet's
    python -m benchmarks.many_environments rates --device cuda --counts 4096 65536 --contenders "1 epoch"
    python -m benchmarks.many_environments rates --quick       # seconds: shows that everything runs

`ppo` at its default settings except epochs, `dqn` at its own, where it learns from a primitive 16 times, and
with the minibatches of Mnih et al. (2015), 8 times; Stable-Baselines3's PPO (`sb3`) at its own (10 epochs), with 1 and
8 environments. Whether as much is learned from equally many primitives is the question of
`benchmarks.learning_curves` and `benchmarks.environments_scaled`. Rates are of processor time, and of wall time, which
is the one to read with several threads. A run warms up before it is timed, which excludes compilation. Finished runs
are kept, a line each, in the file `--out`; the command continues a stopped run.
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
from hrl_escape.agents import train
from hrl_escape.options.memory import VectorDecisionMemory

RATES = "hrl_escape/PaperTwoButton-v1"
CHOOSING = ("PaperTwoButton", "ArmTwoButton")
PEERS = (1, 8)
PICTURED = ("PaperTwoButton", "Clutter")
COMPILED = 512
"""Smallest number of environments with compiled rooms: fewer do not spend enough to be worth it."""
RATED: dict[str, tuple[str, dict[str, Any]]] = {
    "10 epochs": ("ppo", {}), "4 epochs": ("ppo", {"epochs": 4}), "1 epoch": ("ppo", {"epochs": 1}), "dqn": ("dqn", {}),
    "dqn, 8 times": ("dqn", {"batch_size": 32})}
"""Contender -> agent and settings."""
DECIDED: dict[str, tuple[str, dict[str, Any]]] = {
    "smdp-ppo, 1 epoch": ("features", {"epochs": 1}), "smdp-ppo, 10 epochs": ("features", {}),
    "objects and memory, 1 epoch": ("objects", {"epochs": 1, "network": "objects"})}
"""Contender -> observation and settings; of rows of objects with a memory."""


def measure_ours(contender: str, count: int, budget: int, threads: int, device: str = "cpu") -> dict[str, float]:
    """Primitives of a room that an agent learns from in a second."""
    agent, settings = RATED[contender]
    env: Any = (gymnasium.make(RATES, observation="features") if count == 1 else
                gymnasium.make_vec(RATES, num_envs=count, output="torch", observation="features",
                                   compile=count >= COMPILED, device=device))

    def run(primitives: int) -> int:
        return train(agent, env, primitives=primitives, eval_episodes=0, progress=False, settings=settings,
                     threads=threads).primitives

    run(min(budget, 8 * 2048))
    started, clock = time.process_time(), time.perf_counter()
    primitives = run(budget)
    return _tell_rates(primitives, started, clock)


def measure_peer(count: int, budget: int, threads: int, device: str = "cpu") -> dict[str, float]:
    """The same of Stable-Baselines3's PPO."""
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env

    env = make_vec_env(lambda: gymnasium.make(RATES, observation="features"), n_envs=count)
    model = PPO("MlpPolicy", env, n_steps=2048 // count, device=device)
    torch.set_num_threads(threads)
    started, clock = time.process_time(), time.perf_counter()
    model.learn(budget)
    torch.set_num_threads(1)
    return _tell_rates(model.num_timesteps, started, clock)


def measure_decisions(contender: str, count: int, room: str, budget: int, device: str = "cpu") -> dict[str, float]:
    """Decisions that `smdp-ppo` learns from in a second, and the primitives that they run."""
    observation, settings = DECIDED[contender]
    env: Any = gymnasium.make_vec(f"hrl_escape/{room}Options-v1", num_envs=count, output="torch", device=device,
                                  observation=observation, include_primitives=False, compile=count >= 256)
    streams = env.unwrapped.get_many_envs()
    streams = VectorDecisionMemory(streams) if observation == "objects" else streams

    def run(primitives: int) -> tuple[int, int]:
        done = train("smdp-ppo", streams, primitives=primitives, eval_episodes=0, progress=False,
                     settings=settings)
        return done.decisions, done.primitives

    run(budget // 4)
    started, clock = time.process_time(), time.perf_counter()
    decisions, primitives = run(budget)
    rates = _tell_rates(decisions, started, clock)
    return rates | {"primitives": primitives / decisions * rates["wall"]}


def measure_options(contender: str, count: int, room: str, quick: bool, device: str = "cpu") -> dict[str, float]:
    """Masked random options that end in a second.

    Compiled rooms take 600 steps. They begin alike and are out of step after some 60, when options end evenly.
    """
    name, arguments = f"hrl_escape/{room}Options-v1", {"observation": "features", "include_primitives": False}
    rng, steps = np.random.default_rng(0), 20 if quick else 60
    if contender == "single":
        env: Any = gymnasium.make(name, **arguments)
        _, info = env.reset(seed=0)
        started, clock = 0.0, 0.0
        for number in range(50 + 10 * steps):
            if number == 50:  # kernels are loaded, and some plans remembered
                started, clock = time.process_time(), time.perf_counter()
            *_, terminated, truncated, info = env.step(int(rng.choice(np.flatnonzero(info["action_mask"]))))
            if terminated or truncated:
                _, info = env.reset()
        return _tell_rates(10 * steps, started, clock)
    env = gymnasium.make_vec(name, num_envs=count, output="torch", autoreset_mode="SameStep",
                             compile=contender.endswith("compiled"), device=device, **arguments)
    if contender == "vector environment":
        _, info = env.reset(seed=0)
        started, clock = time.process_time(), time.perf_counter()
        for _ in range(steps // 5):
            *_, info = env.step(torch.multinomial(info["action_mask"].float(), 1).squeeze(1))
        return _tell_rates(count * (steps // 5), started, clock)
    streams: Any = env.unwrapped
    streams, ended = streams.get_many_envs(), 0
    streams.reset(0)
    for _ in range(2):  # kernels are compiled or loaded
        streams.step(torch.multinomial(streams.action_mask.float(), 1).squeeze(1))
    started, clock = time.process_time(), time.perf_counter()
    for _ in range(10 * steps if contender.endswith("compiled") else steps):
        ended += int(streams.step(torch.multinomial(streams.action_mask.float(), 1).squeeze(1)).where.sum())
    return _tell_rates(ended, started, clock)


def _tell_rates(count: int, started: float, clock: float) -> dict[str, float]:
    """So many in a second of processor time, and of wall time, since then."""
    return {"rate": count / (time.process_time() - started), "wall": count / (time.perf_counter() - clock)}


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
    what, counts = arguments.what, arguments.counts
    if what == "options":
        contenders = [("single", [1]), ("vector environment", counts), ("own pace", counts),
                      ("own pace, compiled", counts)]
    elif what == "pixels":
        contenders = [("single", [1]), ("batch", counts)]
    elif what == "decisions":
        contenders = [(name, counts) for name in DECIDED]
    else:
        contenders = [*((name, counts) for name in RATED), ("sb3", PEERS)]
    own = {"threads": arguments.threads} if what == "rates" else {}
    return [{"what": what, "contender": contender, "count": count, "round": number, "device": arguments.device,
             **({} if room is None else {"room": room}), **own}
            for number in range(arguments.rounds) for room in arguments.rooms
            for contender, several in contenders if not arguments.contenders or contender in arguments.contenders
            for count in several]


def execute(run: dict[str, Any], quick: bool) -> dict[str, Any]:
    """Outcome of a run."""
    count, peer, device = run["count"], run["contender"] == "sb3", run["device"]
    if run["what"] == "options":
        return measure_options(run["contender"], count, run["room"], quick, device)
    if run["what"] == "pixels":
        return {"rate": measure_pixels(run["contender"], count, run["room"], quick)}
    budget = 4_096 if quick or peer or count <= 8 else 512 * count
    if run["what"] == "decisions":
        return measure_decisions(run["contender"], count, run["room"], budget, device)
    if peer:
        return measure_peer(count, budget, run["threads"], device)
    return measure_ours(run["contender"], count, budget, run["threads"], device)


def summarise(rows: list[dict[str, Any]], what: str) -> str:
    """A table with a line for each contender and number of environments."""
    groups: dict[tuple[str, int], list[dict[str, Any]]] = {}
    for row in rows:
        if row["what"] == what:
            groups.setdefault((row["contender"], row["count"]), []).append(row)
    median = {key: float(np.median([row["rate"] for row in found])) for key, found in groups.items()}
    peer, unit = {"rates": ("sb3", "primitives"), "options": ("single", "options"),
                  "pixels": ("single", "frames"), "decisions": ("smdp-ppo, 10 epochs", "decisions")}[what]
    base = median.get((peer, 1), float("nan"))
    wall = {key: float(np.median([row["wall"] for row in found]))
            for key, found in groups.items() if "wall" in found[0]}
    lines = [f"| contender | environments | {unit} a second of processor time | to {peer} with one | of wall time |",
             "|---|---|---|---|---|"]
    return "\n".join([*lines, *(f"| {name} | {count:,} | {rate:,.0f} | {rate / base:.1f} | "
                                f"{format(wall[name, count], ',.0f') if (name, count) in wall else ''} |"
                                for (name, count), rate in median.items())])


def main() -> None:
    """Run what is missing, then print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["rates", "options", "decisions", "pixels"])
    parser.add_argument("--counts", nargs="+", type=int, help="numbers of environments")
    parser.add_argument("--rooms", nargs="+", help="rooms of options and pixels")
    parser.add_argument("--contenders", nargs="+", default=(), help="lines of the table to measure; by default all")
    parser.add_argument("--device", default="cpu", help="of rooms and networks: cpu, cuda, ...")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=1, help="threads of torch, for rates")
    parser.add_argument("--out", type=Path, default=Path("many_environments.jsonl"), help="where runs are kept")
    parser.add_argument("--quick", action="store_true", help="small budgets, one round")
    arguments = parser.parse_args()
    if arguments.counts is None:
        arguments.counts = {"rates": [1, 8, 64, 512, 4096], "options": [256, 2048], "pixels": [64],
                            "decisions": [256, 2048]}[arguments.what]
    if arguments.rooms is None:
        arguments.rooms = {"options": CHOOSING, "decisions": CHOOSING[:1], "pixels": PICTURED}.get(
            arguments.what, [None])
    if arguments.quick:
        arguments.rounds = 1
    torch.set_num_threads(1)
    rows = [json.loads(line) for line in arguments.out.read_text().splitlines()] if arguments.out.exists() else []
    for run in list_runs(arguments):
        if not any(row.items() >= run.items() for row in rows):
            rows.append(run | execute(run, arguments.quick))
            with arguments.out.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
            print(rows[-1], flush=True)
    for room in arguments.rooms:
        print(*([] if room is None else [f"\n{room}\n"]), sep="", end="")
        kept = [row for row in rows
                if row.get("room") == room and row.get("threads", arguments.threads) == arguments.threads
                and row["device"] == arguments.device]
        print(summarise(kept, arguments.what))


if __name__ == "__main__":
    main()
