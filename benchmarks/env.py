"""Measure steps per second of each preset against CartPole-v1, Taxi, MiniGrid and panda-gym, in one run.

Every environment comes from gymnasium.make with its default wrappers and takes random actions.
Repeats are interleaved, so that a busy moment of the machine slows all of them alike. The median
counts. Resets are timed separately.

Examples:
    python -m benchmarks.env
    python -m benchmarks.env --presets clutter ten-button --observation features --json
"""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import statistics
import sys
import time
from typing import Any

import gymnasium
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.machine import describe_machine
from hrl_escape.cli import run_script
from hrl_escape.env import escape_room  # noqa: F401  # so that no measurement has to import it
from hrl_escape.env.presets import PRESETS, make_env_name
from hrl_escape.errors import ConfigError, UnknownNameError

BASELINE = "CartPole-v1"
_PEERS = {"minigrid": "MiniGrid-DoorKey-8x8-v0", "panda_gym": "PandaReach-v3"}  # module that registers it
_CHUNK = 20  # steps between two looks at the clock; shorter than a busy machine's time slices
_MAKES, _RESETS = 3, 20


@dataclasses.dataclass(frozen=True)
class Args:
    """Options of the command line."""

    presets: tuple[str, ...] = ()
    """Presets to measure; all by default."""
    observation: str = "state"
    """Observation of our environments; `hrl-escape list observations` names them all."""
    repeats: int = 5
    """Number of measurements of each environment."""
    seconds: float = 0.2
    """Length of one measurement, s."""
    json: bool = False
    """Print JSON instead of a table."""


@dataclasses.dataclass
class _Subject:
    """An environment and its measurements."""

    name: str
    id: str
    arguments: dict[str, Any]
    env: gymnasium.Env
    actions: list[Any]
    make_seconds: float
    reset_seconds: list[float]
    step_seconds: list[float]

    def summarise(self) -> dict[str, Any]:
        """Numbers for table and JSON."""
        return {"name": self.name, "id": self.id, "steps_per_second": 1 / statistics.median(self.step_seconds),
                "make_ms": 1e3 * self.make_seconds, "reset_ms": 1e3 * statistics.median(self.reset_seconds)}


def run(args: Args) -> None:
    """Measure and print."""
    if args.repeats < 1 or not args.seconds > 0:
        raise ConfigError("repeats, seconds", (args.repeats, args.seconds), "repeats of at least 1 and seconds above 0")
    for preset in args.presets:
        if preset not in PRESETS:
            raise UnknownNameError("preset", preset, PRESETS)
    subjects = [_make_subject(*subject) for subject in _choose(args)]
    rounds = [(repeat, subject) for repeat in range(args.repeats) for subject in subjects]
    progress = track(rounds, "measuring", console=Console(stderr=True), transient=True, disable=args.json)
    for _, subject in progress:
        _measure(subject, args.seconds)
    for subject in subjects:
        subject.env.close()
    rows = [subject.summarise() for subject in subjects]
    base = next(row["steps_per_second"] for row in rows if row["id"] == BASELINE)
    for row in rows:
        row["ratio"] = row["steps_per_second"] / base
    if args.json:
        print(json.dumps({"baseline": BASELINE, "settings": dataclasses.asdict(args),
                          "machine": describe_machine("pybullet"), "environments": rows}, indent=2))
    else:
        _print(rows)


def _choose(args: Args) -> list[tuple[str, str, dict[str, Any]]]:
    """Name, id and arguments of each environment: ours, then the peers that are installed."""
    ours = [(name, f"hrl_escape/{make_env_name(name)}-v1", {"observation": args.observation})
            for name in args.presets or PRESETS]
    peers = [BASELINE, max(name for name in gymnasium.registry if name.startswith("Taxi-v"))]
    for module, name in _PEERS.items():
        if importlib.util.find_spec(module) is not None:
            importlib.import_module(module)
            if name not in gymnasium.registry:  # newer Gymnasium no longer loads plug-ins by itself
                gymnasium.register_envs(importlib.import_module(module))
            peers.append(name)
    return [*ours, *((name, name, {}) for name in peers)]


def _make_subject(name: str, id_: str, arguments: dict[str, Any]) -> _Subject:
    envs, times = [], []
    for _ in range(_MAKES):
        begin = time.perf_counter()
        envs.append(gymnasium.make(id_, **arguments))
        times.append(time.perf_counter() - begin)
    *spare, env = envs
    for other in spare:
        other.close()
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(1000)]
    env.reset(seed=0)
    resets = []
    for _ in range(_RESETS):
        begin = time.perf_counter()
        env.reset()
        resets.append(time.perf_counter() - begin)
    return _Subject(name, id_, arguments, env, actions, min(times), resets, [])


def _measure(subject: _Subject, seconds: float) -> None:
    """Step with random actions for a while; resets do not count."""
    env, actions, clock = subject.env, subject.actions, time.perf_counter
    step, number = env.step, 0
    env.reset()
    end = clock() + seconds
    while (begin := clock()) < end:
        lost = 0.0
        for _ in range(_CHUNK):
            _, _, terminated, truncated, _ = step(actions[number])
            number = (number + 1) % len(actions)
            if terminated or truncated:
                before = clock()
                env.reset()
                lost += clock() - before
        subject.step_seconds.append((clock() - begin - lost) / _CHUNK)


def _print(rows: list[dict[str, Any]]) -> None:
    table = Table(box=None, padding=(0, 2), pad_edge=False)
    table.add_column("environment", no_wrap=True)
    for heading in ("steps/s", "ratio", "make ms", "reset ms"):
        table.add_column(heading, justify="right")
    for row in rows:
        table.add_row(row["name"], f"{row['steps_per_second']:,.0f}", f"{row['ratio']:.3f}", f"{row['make_ms']:.1f}",
                      f"{row['reset_ms']:.3f}")
    table.caption = f"random actions; ratio to {BASELINE} in this run; resets are not in steps/s"
    Console(soft_wrap=True).print(table)


if __name__ == "__main__":
    sys.exit(run_script(run))
