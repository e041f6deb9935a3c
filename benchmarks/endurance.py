"""Endurance: does memory, do descriptors, do threads stay flat under hours of work?

Run: `python benchmarks/endurance.py --minutes 10` (each kind of work for ten minutes, after a fifth of that to warm
up); exits with 1 if anything grew. `--only rendering viewer` chooses among the kinds of work.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import os
import resource
import threading
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from hrl_escape.agents.training.train import train
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.planner import RoomPlanner

SEEDS = 100_000
WARM_UP = 0.2
"""Share of the time before the first measurement."""


class Held(NamedTuple):
    """Resources of a process: resident memory in MB, open descriptors, threads."""

    memory: float
    descriptors: int
    threads: int

    @classmethod
    def measure(cls) -> Held:
        """What this process holds now."""
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return cls(pages * resource.getpagesize() / 1e6, len(os.listdir("/proc/self/fd")),
                   len(os.listdir("/proc/self/task")))


ALLOWED = Held(16.0, 2, 4)
"""Largest growth that does not count as a leak: allocators and pools settle slowly."""


def step() -> Generator[None]:
    """Random primitives in three environments; a unit is 1,000 of them."""
    names = ("hrl_escape/PaperTwoButton-v1", "hrl_escape/ArmTwoButton-v1", "hrl_escape/Clutter-v1")
    envs: list[Any] = [gymnasium.make(name, disable_env_checker=True) for name in names]
    rng = np.random.default_rng(0)
    for env in envs:
        env.reset(seed=0)
    while True:
        for env in envs:
            for action in rng.integers(env.action_space.n, size=1000).tolist():
                _, _, terminated, truncated, _ = env.step(action)
                if terminated or truncated:
                    env.reset()
            yield


def open_and_close() -> Generator[None]:
    """Environments that are opened, stepped once and closed."""
    for seed in range(SEEDS):
        env = gymnasium.make("hrl_escape/PaperTwoButton-v1", disable_env_checker=True)
        env.reset(seed=seed)
        env.step(0)
        env.close()
        yield


def render() -> Generator[None]:
    """Environments that are opened, rendered and closed."""
    for seed in range(SEEDS):
        name = ("hrl_escape/PaperTwoButton-v1", "hrl_escape/ArmTwoButton-v1")[seed % 2]
        env = gymnasium.make(name, disable_env_checker=True, render_mode="rgb_array")
        env.reset(seed=seed)
        env.render()
        env.close()
        yield


def plan() -> Generator[None]:
    """New rooms, each solved."""
    for seed in range(SEEDS):
        env = EscapeRoomEnv(instance=generate(get_preset("clutter"), seed % 50))
        env.reset(seed=seed)
        RoomPlanner(env.instance).solve(env.get_state())
        env.close()
        yield


def run_options() -> Generator[None]:
    """Random options and primitives; a unit is one episode or 50 decisions."""
    env = OptionsEnv(EscapeRoomEnv(instance=generate(get_preset("paper-two-button"), 0)))
    rng = np.random.default_rng(0)
    for seed in range(SEEDS):
        env.reset(seed=seed)
        for _ in range(50):
            _, _, terminated, truncated, _ = env.step(int(rng.choice(np.flatnonzero(env.action_masks()))))
            if terminated or truncated:
                break
        yield


def learn() -> Generator[None]:
    """Short training runs of a network over options."""
    for seed in range(SEEDS):
        env = OptionsEnv(EscapeRoomEnv(instance=generate(get_preset("paper-two-button"), 0), observation="features"))
        train("smdp-dqn+primitives", env, primitives=300, seed=seed, eval_episodes=0, progress=False)
        env.close()
        yield


def view() -> Generator[None]:
    """Clients of manual mode that come, drive and go."""
    import msgspec
    import viser
    from websockets.sync.client import connect
    from websockets.typing import Origin, Subprotocol

    from hrl_escape.viewer.pages.play import PlayPage
    from hrl_escape.viewer.play.episode import Episode
    from hrl_escape.viewer.server import open_server

    camera = {"type": "ViewerCameraMessage", "wxyz": (1, 0, 0, 0), "position": (0, -20, 20), "fov": 0.9, "near": 0.1,
              "far": 100.0, "image_height": 800, "image_width": 900, "look_at": (0, 0, 0), "up_direction": (0, 0, 1)}
    server = open_server(port=0)
    game = PlayPage(server, Episode(generate(get_preset("paper-two-button"), 0)), stride=0.0)
    thread = threading.Thread(target=game.run)
    thread.start()
    address = f"127.0.0.1:{server.get_port()}"
    try:
        while True:
            with connect(f"ws://{address}/?token={server.guard.token}", origin=Origin(f"http://{address}"),
                         subprotocols=[Subprotocol(f"viser-v{viser.__version__}")], max_size=None,
                         compression=None) as client:
                client.recv(timeout=30)
                client.send(msgspec.msgpack.encode(camera))
                for key in "wszr":
                    game.put(key)
            while server.get_clients():
                time.sleep(0.005)
            yield
    finally:
        game.put("q")
        thread.join()
        server.stop()


def step_batches() -> Generator[None]:
    """Steps of 1,024 rooms at once, compiled, with automatic resets."""
    env = gymnasium.make_vec("hrl_escape/Clutter-v1", num_envs=1024, compile=True)
    env.reset(seed=0)
    rng, count = np.random.default_rng(0), env.single_action_space.n  # type: ignore[attr-defined]  # a Discrete
    try:
        while True:
            env.step(rng.integers(count, size=1024))
            yield
    finally:
        env.close()


WORK: dict[str, Callable[[], Generator[None]]] = {
    "steps": step, "environments": open_and_close, "rendering": render, "planning": plan, "options": run_options,
    "training": learn, "viewer": view, "batched": step_batches,
}


def endure(name: str, minutes: float) -> Held:
    """Work for some time; returns what grew after the warm-up."""
    begun, units, before = time.monotonic(), 0, None
    with contextlib.closing(WORK[name]()) as work:
        for _ in work:
            units += 1
            past = (time.monotonic() - begun) / 60 / minutes
            if before is None and past > WARM_UP:
                before = Held.measure()
            if past > 1.0:
                break
        now = Held.measure()
    before = before or now
    grown = Held(now.memory - before.memory, now.descriptors - before.descriptors, now.threads - before.threads)
    print(f"{name}: {units:,} units in {minutes:g} minutes, {grown.memory:+.1f} MB, "
          f"{grown.descriptors:+d} descriptors, {grown.threads:+d} threads", flush=True)
    return grown


def main() -> int:
    """Run all kinds of work, one after another, and say what grew."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=1.0, help="of each kind of work")
    parser.add_argument("--only", nargs="+", choices=WORK, default=list(WORK), help="kinds of work")
    options = parser.parse_args()
    growths = [endure(name, options.minutes) for name in options.only]
    return int(any(grown > most for growth in growths for grown, most in zip(growth, ALLOWED, strict=True)))


if __name__ == "__main__":
    raise SystemExit(main())
