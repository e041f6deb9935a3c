"""Endurance: a million steps, a thousand open/close cycles, minutes of batched steps: how much memory do they leave?

Run: `python benchmarks/endurance.py` (about two minutes on one core); exits with 1 if memory grew. With
`--batched-minutes 10` the batched engine is stepped for ten minutes besides.
"""

from __future__ import annotations

import argparse
import gc
import resource
import time
from pathlib import Path

import gymnasium
import numpy as np

import hrl_escape  # noqa: F401  registers the environments

ALLOWED_GROWTH_MB = 8.0


def get_memory_mb() -> float:
    """Resident memory of this process in MB."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def run_steps(name: str, steps: int) -> float:
    """Step an environment with random primitives; returns the growth in MB after a warm-up."""
    env = gymnasium.make(name, disable_env_checker=True)
    actions = np.random.default_rng(0).integers(env.action_space.n, size=steps).tolist()  # type: ignore[attr-defined]  # a Discrete
    env.reset(seed=0)
    warm, before, began = steps // 5, 0.0, time.perf_counter()
    for number, action in enumerate(actions):
        if number == warm:
            before = get_memory_mb()
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()
    growth = get_memory_mb() - before
    print(f"{name}: {steps} steps, {steps / (time.perf_counter() - began):,.0f} a second, {growth:+.1f} MB")
    env.close()
    return growth


def run_cycles(name: str, cycles: int) -> float:
    """Open, reset, step and close an environment many times; returns the growth in MB after a warm-up."""
    before, began = 0.0, time.perf_counter()
    for cycle in range(cycles):
        if cycle == cycles // 5:
            before = get_memory_mb()
        env = gymnasium.make(name, disable_env_checker=True)
        env.reset(seed=cycle)
        env.step(0)
        env.close()
    growth = get_memory_mb() - before
    each = (time.perf_counter() - began) / cycles * 1e3
    print(f"{name}: {cycles} open/close cycles, {each:.1f} ms each, {growth:+.1f} MB")
    return growth


def run_batch(name: str, rooms: int, minutes: float) -> float:
    """Step a batch of rooms, compiled, with random primitives and automatic resets; returns the growth in MB."""
    env = gymnasium.make_vec(name, num_envs=rooms, compile=True)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    count = env.single_action_space.n  # type: ignore[attr-defined]  # a Discrete
    env.step(np.zeros(rooms, dtype=np.int64))  # compiles
    end, before, steps, warm = time.monotonic() + 60 * minutes, 0.0, 0, time.monotonic() + 12 * minutes
    while time.monotonic() < end:
        if before == 0.0 and time.monotonic() > warm:
            before = get_memory_mb()
        env.step(rng.integers(count, size=rooms))
        steps += rooms
    growth = get_memory_mb() - before
    print(f"{name}: {steps:,} batched steps in {minutes:g} minutes, {growth:+.1f} MB after the first fifth")
    env.close()
    return growth


def main() -> int:
    """Run all and say whether memory grew."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--cycles", type=int, default=1000)
    parser.add_argument("--batched-minutes", type=float, default=0.0, help="of stepping 1,024 rooms at once")
    options = parser.parse_args()
    names = ("hrl_escape/PaperTwoButton-v0", "hrl_escape/ArmTwoButton-v0", "hrl_escape/Clutter-v0")
    growth = [run_steps(name, options.steps // len(names)) for name in names]
    growth.append(run_cycles("hrl_escape/PaperTwoButton-v0", options.cycles))
    if options.batched_minutes:
        growth.append(run_batch("hrl_escape/Clutter-v0", 1024, options.batched_minutes))
    return int(max(growth) > ALLOWED_GROWTH_MB)


if __name__ == "__main__":
    raise SystemExit(main())
