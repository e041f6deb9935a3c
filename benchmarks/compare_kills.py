"""A comparison killed (SIGKILL) at twenty random moments and resumed, against one that was left alone.

Run: `python benchmarks/compare_kills.py` (about five minutes on two cores); exits with 1 if a number differs.
"""

from __future__ import annotations

import argparse
import dataclasses
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from hrl_escape.experiments.grid import AgentSpec
from hrl_escape.experiments.presets import get_grid
from hrl_escape.files import write_json

AGENTS = ("random", "dqn", "smdp-random", "smdp-q-learning", "smdp-dqn", "smdp-ppo")
TABLES = ("results.csv", "curves.csv")
LONGEST_SECONDS = 14.0
"""A comparison takes some seconds to start, so later moments are needed to meet it at work."""


def start(grid: Path, out: Path) -> subprocess.Popen[bytes]:
    """The comparison as a user runs it."""
    command = [sys.executable, "-m", "hrl_escape.cli", "compare", str(grid), "--out", str(out)]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def run_to_end(grid: Path, out: Path) -> float:
    """Run without disturbance; returns seconds."""
    began = time.perf_counter()
    process = start(grid, out)
    if process.wait():
        sys.exit(f"the comparison ended with code {process.returncode}")
    return time.perf_counter() - began


def run_killed(grid: Path, out: Path, kills: int, rng: np.random.Generator) -> None:
    """Start and kill, again and again: while it starts, while runs train, while results are written."""
    for number in range(kills):
        process = start(grid, out)
        pause = rng.uniform(1.0, LONGEST_SECONDS)
        try:
            process.wait(pause)
            print(f"kill {number + 1}: the comparison was already finished", flush=True)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            finished = len(list(out.glob("runs/*/run_result.json")))
            print(f"kill {number + 1} after {pause:.1f} s: {finished} runs finished so far", flush=True)


def main() -> int:
    """Compare both ways and say whether they differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--primitives", type=int, default=4_000)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    arguments = parser.parse_args()
    grid = dataclasses.replace(get_grid("quickstart"), name="kills", agents=tuple(map(AgentSpec.parse, AGENTS)),
                               runs=arguments.runs, primitives=arguments.primitives)
    with tempfile.TemporaryDirectory() as folder:
        file, alone, killed = (Path(folder) / name for name in ("kills.json", "alone", "killed"))
        write_json(file, grid.to_dict())
        seconds = run_to_end(file, alone)
        print(f"left alone: {seconds:.0f} s", flush=True)
        run_killed(file, killed, arguments.kills, np.random.default_rng(arguments.seed))
        run_to_end(file, killed)
        same = [(alone / name).read_bytes() == (killed / name).read_bytes() for name in TABLES]
    for name, is_same in zip(TABLES, same, strict=True):
        print(f"{name}: {'the same bytes' if is_same else 'DIFFERENT'}")
    return 0 if all(same) else 1


if __name__ == "__main__":
    sys.exit(main())
