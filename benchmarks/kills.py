"""Kills (SIGKILL) at random moments, each resumed by the same command, against one that was left alone.

Run: `python benchmarks/kills.py` (about fifteen minutes on two cores), or `--only train` and so on; exits with 1 if a
number differs. `compare` is a comparison of six agents, `train` one run of smdp-dqn, `study` the study of flat agents.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hrl_escape.agents.training.checkpoint import compute_state_digest, load_checkpoint
from hrl_escape.experiments.grid import AgentSpec
from hrl_escape.experiments.presets import get_grid
from hrl_escape.files import write_json

AGENTS = ("random", "dqn", "smdp-random", "smdp-q-learning", "smdp-dqn", "smdp-ppo")
LONGEST_SECONDS = 3.0
TRAIN = """
import sys, hrl_escape, gymnasium
from hrl_escape.agents import train
env = gymnasium.make("hrl_escape/PaperTwoButtonOptions-v1", observation="features")
train("smdp-dqn", env, primitives=int(sys.argv[1]), seed=0, out=sys.argv[2], checkpoint_seconds=0.5, progress=False)
"""


class Work(NamedTuple):
    """Work that is killed: its command in a folder, its results there, and signs of progress (a glob)."""

    make_command: Callable[[Path], list[str]]
    read: Callable[[Path], Any]
    signs: str


def make_compare(folder: Path) -> list[str]:
    """A comparison of two runs of each agent."""
    grid = dataclasses.replace(get_grid("quickstart"), name="kills", agents=tuple(map(AgentSpec.parse, AGENTS)), runs=2,
                               primitives=3_000)
    write_json(folder.with_suffix(".json"), grid.to_dict())
    return ["-m", "hrl_escape.cli", "compare", str(folder.with_suffix(".json")), "--out", str(folder)]


def read_compare(folder: Path) -> Any:
    """Its tables, to the byte."""
    return [(folder / name).read_bytes() for name in ("results.csv", "curves.csv")]


def make_train(folder: Path) -> list[str]:
    """One run with a checkpoint every half a second."""
    return ["-c", TRAIN, "20000", str(folder)]


def read_train(folder: Path) -> Any:
    """Weights to the bit, and every row of the log without the times in it."""
    rows = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    kept = [{name: value for name, value in row.items() if "second" not in name} for row in rows]
    return compute_state_digest(load_checkpoint(folder / "checkpoint.npz")["agent"]), kept


def make_study(folder: Path) -> list[str]:
    """The study of flat agents with one run of each."""
    return ["-m", "hrl_escape.cli", "experiment", "flat", "--runs", "1", "--primitives", "400", "--out",
            str(folder / "runs"), "--docs", str(folder / "docs")]


def read_study(folder: Path) -> Any:
    """Its raw results, to the byte."""
    return [file.read_bytes() for file in sorted(folder.glob("docs/raw/*.jsonl"))]


WORK = {"compare": Work(make_compare, read_compare, "runs/*/training/log.jsonl"),
        "train": Work(make_train, read_train, "checkpoint.npz"),
        "study": Work(make_study, read_study, "runs/*/runs/*/training/log.jsonl")}


def start(command: list[str]) -> subprocess.Popen[bytes]:
    """Start the work as a user does."""
    return subprocess.Popen([sys.executable, *command], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def run_to_end(command: list[str]) -> float:
    """Run without disturbance; returns seconds."""
    began = time.perf_counter()
    process = start(command)
    if process.wait():
        sys.exit(f"the work ended with code {process.returncode}")
    return time.perf_counter() - began


def find_newest(folder: Path, signs: str) -> int:
    """Time of the last change among the signs of progress, ns; 0 where there is none."""
    times = [0]
    for path in folder.glob(signs):
        with contextlib.suppress(FileNotFoundError):  # written anew meanwhile
            times.append(path.stat().st_mtime_ns)
    return max(times)


def run_killed(command: list[str], folder: Path, signs: str, kills: int, rng: np.random.Generator) -> int:
    """Start and kill, again and again; returns how often it was still at work.

    Every fourth kill comes while it starts, the others up to `LONGEST_SECONDS` after a new sign of progress.
    """
    met = 0
    for number in range(kills):
        before, process = find_newest(folder, signs), start(command)
        while number % 4 and process.poll() is None and find_newest(folder, signs) == before:
            time.sleep(0.02)
        try:
            process.wait(rng.uniform(0.0, LONGEST_SECONDS))
            print(f"  kill {number + 1}: it was already finished", flush=True)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            met += 1
            print(f"  kill {number + 1}: {len(list(folder.glob(signs)))} signs of progress", flush=True)
    return met


def survive(name: str, kills: int, seed: int, folder: Path) -> bool:
    """Do the work alone and killed; returns whether both have the same numbers."""
    work, alone, killed = WORK[name], folder / f"{name}-alone", folder / f"{name}-killed"
    print(f"{name}: left alone {run_to_end(work.make_command(alone)):.0f} s", flush=True)
    met = run_killed(work.make_command(killed), killed, work.signs, kills, np.random.default_rng(seed))
    run_to_end(work.make_command(killed))
    is_same = work.read(alone) == work.read(killed)
    print(f"{name}: {met} kills, {'the same numbers' if is_same else 'DIFFERENT NUMBERS'}", flush=True)
    return is_same


def main() -> int:
    """Kill each kind of work and say whether its numbers differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=WORK, default=list(WORK), help="kinds of work")
    parser.add_argument("--kills", type=int, default=20, help="of each")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        survived = [survive(name, arguments.kills, arguments.seed, Path(folder)) for name in arguments.only]
    return 0 if all(survived) else 1


if __name__ == "__main__":
    sys.exit(main())
