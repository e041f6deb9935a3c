"""Kills (SIGKILL) at random moments, each resumed by the same command, against work that was left alone.

Run: `python benchmarks/kills.py --only train --kills 100` and so on; exits with 1 if a byte differs or a process
outlives its parent. `train` is one run of smdp-dqn, `compare` a comparison of six agents, `study` the study of task
hierarchies, `ladder` a rung of the ladder with two agents, `data` four recordings, `ray` the comparison on a Ray of
this machine (extra `ray`). A finished run is compared and then repeated in another folder, until the kills are done.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import itertools
import json
import multiprocessing
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.context import ForkProcess
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.checkpoint import compute_state_digest, load_checkpoint
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.presets import get_grid
from hrl_escape.cli import main as main_of_cli
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.files import write_json
from hrl_escape.options.options_env import OptionsEnv
from studies.__main__ import main as main_of_studies

AGENTS = ("random", "dqn", "random-options", "smdp-q-learning", "smdp-dqn", "smdp-ppo")
LONGEST_SECONDS = 2.0
ORPHAN_SECONDS = 60.0
"""Longest life of a process after its parent was killed; on a busy machine it can still be loading."""
class Work(NamedTuple):
    """Work that is killed.

    Attributes:
        run: does it in a folder.
        read: its results there.
        signs: signs of progress, a glob.
        victims: words in the command lines of the processes below it that are killed too, alone.
    """

    run: Callable[[Path], None]
    read: Callable[[Path], Any]
    signs: str
    victims: tuple[str, ...] = ()


def write_grid(folder: Path, agents: Sequence[str] = AGENTS, runs: int = 2, primitives: int = 1_500) -> str:
    """File of a grid."""
    grid = dataclasses.replace(get_grid("quickstart"), name="kills", agents=tuple(map(AgentSpec.parse, agents)),
                               runs=runs, primitives=primitives)
    write_json(folder.with_suffix(".json"), grid.to_dict())
    return str(folder.with_suffix(".json"))


def compare(folder: Path) -> None:
    """A comparison of two runs of each agent."""
    sys.exit(main_of_cli(["compare", write_grid(folder), "--out", str(folder)]))


def compare_on_ray(folder: Path) -> None:
    """A smaller comparison on a Ray of this machine."""
    grid = write_grid(folder, AGENTS[:5:2], 1, 600)
    sys.exit(main_of_cli(["compare", grid, "--out", str(folder), "--ray", "--workers", "2"]))


def read_compare(folder: Path) -> Any:
    """Its tables, to the byte."""
    return [(folder / name).read_bytes() for name in ("results.csv", "curves.csv")]


def learn(folder: Path | None, primitives: int = 10_000) -> None:
    """Train in short episodes, with a checkpoint after each."""
    torch.set_num_threads(1)
    room = generate(dataclasses.replace(get_preset("paper-two-button"), horizon=100), 0)
    env = OptionsEnv(EscapeRoomEnv(instance=room, observation="features"))
    train("smdp-dqn+primitives", env, primitives=primitives, seed=0, out=folder, checkpoint_seconds=0.0, progress=False)


def read_train(folder: Path) -> Any:
    """Weights to the bit, and every row of the log without the times in it."""
    rows = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    kept = [{name: value for name, value in row.items() if "second" not in name} for row in rows]
    return compute_state_digest(load_checkpoint(folder / "checkpoint.npz")["agent"]), kept


def study(folder: Path) -> None:
    """The study of task hierarchies with one run of each."""
    sys.exit(main_of_studies(["hierarchies", "--runs", "1", "--primitives", "400",
                              "--out", str(folder / "runs"), "--docs", str(folder / "docs")]))


def read_study(folder: Path) -> Any:
    """Its raw results, to the byte."""
    return [file.read_bytes() for file in sorted(folder.glob("docs/raw/*.jsonl"))]


def climb(folder: Path) -> None:
    """A rung with two agents."""
    words = ["--rung", "pair", "--rooms", "1", "--runs", "2", "--primitives", "1500", "--out", str(folder)]
    sys.exit(main_of_cli(["ladder", "run", "smdp-q-learning", "smdp-dqn", *words]))


def read_ladder(folder: Path) -> Any:
    """Its tables, to the byte."""
    return [(folder / "per-instance" / "pair" / name).read_bytes() for name in ("results.csv", "curves.csv")]


def make_data(folder: Path) -> None:
    """Four recordings, one after another."""
    names = [f"pair-{kind}-v1" for kind in ("play", "noisy", "expert", "explore")]
    sys.exit(main_of_cli(["data", "make", *names, "--primitives", "20000", "--out", str(folder)]))


def read_data(folder: Path) -> Any:
    """The recordings, to the byte."""
    return [file.read_bytes() for file in sorted(folder.glob("*.npz"))]


LOGS = "runs/*/training/log.jsonl"
WORK = {"compare": Work(compare, read_compare, LOGS, ("forkserver",)),
        "train": Work(learn, read_train, "checkpoint.npz"),
        "study": Work(study, read_study, f"runs/*/*/{LOGS}", ("forkserver",)),
        "ladder": Work(climb, read_ladder, f"per-instance/*/{LOGS}", ("forkserver",)),
        "data": Work(make_data, read_data, "*.npz"),
        "ray": Work(compare_on_ray, read_compare, LOGS, ("_run_guarded", "raylet/raylet"))}


def start(run: Callable[[Path], None], folder: Path) -> ForkProcess:
    """Start the work, silently, in a fork of this process, which has loaded all that takes time."""
    process = multiprocessing.get_context("fork").Process(target=run_silently, args=(run, folder))
    process.start()
    return process


def run_silently(run: Callable[[Path], None], folder: Path) -> None:
    """Do the work in this process."""
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        os.dup2(nowhere.fileno(), 2)
    run(folder)


def run_to_end(run: Callable[[Path], None], folder: Path) -> float:
    """Run without disturbance; returns seconds."""
    began = time.perf_counter()
    process = start(run, folder)
    process.join()
    if process.exitcode:
        sys.exit(f"the work ended with code {process.exitcode}")
    return time.perf_counter() - began


def find_newest(folder: Path, signs: str) -> int:
    """Time of the last change among the signs of progress, ns; 0 where there is none."""
    times = [0]
    for path in folder.glob(signs):
        with contextlib.suppress(FileNotFoundError):  # rewritten meanwhile
            times.append(path.stat().st_mtime_ns)
    return max(times)


def list_descendants(ancestor: int) -> dict[int, str]:
    """Command lines of the processes below one, by number; those that have ended and wait for their parent are none."""
    parents, titles = {}, {}
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            state, parent = (folder / "stat").read_text().rpartition(")")[2].split()[:2]
            if state != "Z":
                parents[int(folder.name)] = int(parent)
                titles[int(folder.name)] = (folder / "cmdline").read_text().replace("\0", " ")
    found = [ancestor]
    for process in found:
        found += [child for child, parent in parents.items() if parent == process]
    return {process: titles.get(process, "") for process in found[1:]}


def list_victims(work: Work, process: ForkProcess) -> dict[int, str]:
    """Command lines of the processes below the work's first that are killed too, by number."""
    assert process.pid is not None, "it was started"
    return {number: title for number, title in list_descendants(process.pid).items()
            if any(words in title for words in work.victims)}


def kill_all(work: Work, process: ForkProcess) -> None:
    """Kill a process; those below it have to end by themselves."""
    below = list_victims(work, process)
    process.kill()
    process.join()
    until = time.monotonic() + ORPHAN_SECONDS
    while left := {pid: title for pid, title in below.items() if _read_title(pid) == title}:
        if time.monotonic() > until:
            sys.exit(f"left behind by the process that was killed: {left}")
        time.sleep(0.05)


def _read_title(process: int) -> str | None:
    """Command line of a process that is alive."""
    try:
        folder = Path(f"/proc/{process}")
        if (folder / "stat").read_text().rpartition(")")[2].split()[0] == "Z":
            return None
        return (folder / "cmdline").read_text().replace("\0", " ")
    except OSError:
        return None


def kill_in_turn(work: Work, folder: Path, kills: Iterator[int], rng: np.random.Generator) -> Iterator[str]:
    """Start the work and kill it, or a process below it, again and again until it is finished; yields what was killed.

    Every fourth kill comes while it starts, the others up to `LONGEST_SECONDS` after a new sign of progress. Five in
    six hit a process below it alone, where there is one.
    """
    process = None
    try:
        for number in kills:
            if process is None or not process.is_alive():
                process = start(work.run, folder)
            before = find_newest(folder, work.signs)
            while number % 4 and process.is_alive() and find_newest(folder, work.signs) == before:
                time.sleep(0.02)
            process.join(rng.uniform(0.0, LONGEST_SECONDS))
            if process.exitcode == 0:
                return
            if process.exitcode is not None:  # runs whose processes were killed have failed
                continue
            below = list_victims(work, process)
            if number % 6 and below:
                victim = int(rng.choice(sorted(below)))
                with contextlib.suppress(ProcessLookupError):
                    os.kill(victim, signal.SIGKILL)
                yield below[victim]
            else:
                kill_all(work, process)
                yield "the command"
    finally:
        if process is not None:
            process.kill()
            process.join()


def survive(name: str, kills: int, seed: int, folder: Path) -> bool:
    """Do the work alone and killed; returns whether both have the same numbers."""
    work, alone, rng, numbers = WORK[name], folder / f"{name}-alone", np.random.default_rng(seed), itertools.count()
    print(f"{name}: left alone {run_to_end(work.run, alone):.0f} s", flush=True)
    wanted, met, is_same = work.read(alone), 0, True
    if not wanted or not list(alone.glob(work.signs)):
        sys.exit(f"{name} left no results, or no signs of progress as {work.signs}")
    for attempt in itertools.count(1):
        killed = folder / f"{name}-killed-{attempt}"
        for victim in itertools.islice(kill_in_turn(work, killed, numbers, rng), kills - met):
            met += 1
            print(f"  kill {met}, {len(list(killed.glob(work.signs)))} signs of progress: {victim[:60]}", flush=True)
        run_to_end(work.run, killed)
        is_same = is_same and work.read(killed) == wanted
        print(f"{name}: {met} kills, {attempt} times to the end, "
              f"{'the same numbers' if is_same else 'DIFFERENT NUMBERS'}", flush=True)
        if met >= kills:
            return is_same
    raise AssertionError


def main() -> int:
    """Kill each kind of work and say whether its numbers differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=WORK, default=list(WORK), help="kinds of work")
    parser.add_argument("--kills", type=int, default=20, help="of each")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    arguments = parser.parse_args()
    learn(None, 100)  # what is compiled and loaded now, the forks of this process need not load
    with tempfile.TemporaryDirectory() as folder:
        survived = [survive(name, arguments.kills, arguments.seed, Path(folder)) for name in arguments.only]
    return 0 if all(survived) else 1


if __name__ == "__main__":
    sys.exit(main())
