"""Measure the headless mode against the real-time view and the published code.

Random primitives run in the same room headless and on the viewer's page, as it moves in
`hrl-escape play`; random meta-actions run headless. All are measured in turns in one run. The
published code made 97 steps a second when rerun in its fastest setting.

Examples:
    python -m benchmarks.modes
    python -m benchmarks.modes --room clutter --seconds 2 --json
"""

from __future__ import annotations

import dataclasses
import json
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from hrl_escape.cli import run_script
from hrl_escape.commands.room_choice import RoomChoice
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import ConfigError
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.viewer.pages.play import PLAY_STRIDE
from hrl_escape.viewer.pages.room import RoomPage
from hrl_escape.viewer.server import open_server

PUBLISHED = 97.0
"""Steps a second of the published code (Menashe and Stone 2019), rerun on the machine of benchmarks/README.md."""
_CHUNK = 50


@dataclasses.dataclass(frozen=True)
class Args(RoomChoice):
    """Options of the command line."""

    repeats: int = 3
    """Number of measurements of each mode."""
    seconds: float = 1.0
    """Length of one measurement, s."""
    json: bool = False
    """Print JSON instead of a table."""


def run(args: Args) -> None:
    """Measure and print."""
    if args.repeats < 1 or not args.seconds > 0:
        raise ConfigError("repeats, seconds", (args.repeats, args.seconds), "repeats of at least 1 and seconds above 0")
    instance = args.make_instance()
    server = open_server(port=0)
    try:
        modes: dict[str, Callable[[float], float]] = {
            "headless, primitives": _Headless(instance).measure,
            "headless, meta-actions": _Options(instance).measure,
            "real-time view": _View(instance, server).measure,
        }
        rates: dict[str, list[float]] = {name: [] for name in modes}
        for _ in range(args.repeats):
            for name, measure in modes.items():
                rates[name].append(measure(args.seconds))
    finally:
        server.stop()
    found = {name: statistics.median(values) for name, values in rates.items()}
    found["published code"] = PUBLISHED
    view = found["real-time view"]
    rows = [{"mode": name, "primitives_per_second": rate, "times_real_time": rate / view,
             "times_published": rate / PUBLISHED} for name, rate in found.items()]
    if args.json:
        print(json.dumps({"room": instance.id, "name": instance.name, "stride": PLAY_STRIDE, "modes": rows}, indent=2))
    else:
        _print(instance, rows)


class _Headless:
    """Random primitives in the flat room."""

    def __init__(self, instance: RoomInstance) -> None:
        self._env = EscapeRoomEnv(instance=instance)
        self._env.reset(seed=0)
        self._actions = np.random.default_rng(0).integers(len(self._env.rules.actions), size=1000).tolist()

    def measure(self, seconds: float) -> float:
        step, number, begin = self._env.step, 0, time.perf_counter()
        while (past := time.perf_counter() - begin) < seconds:
            for _ in range(_CHUNK):
                _, _, terminated, truncated, _ = step(self._actions[number % 1000])
                number += 1
                if terminated or truncated:
                    self._env.reset()
        return number / past


class _Options:
    """Random meta-actions, planned and run to their end."""

    def __init__(self, instance: RoomInstance) -> None:
        self._env = OptionsEnv(EscapeRoomEnv(instance=instance), include_primitives=False)
        _, self._info = self._env.reset(seed=0)
        self._rng = np.random.default_rng(0)

    def measure(self, seconds: float) -> float:
        number, begin = 0, time.perf_counter()
        while (past := time.perf_counter() - begin) < seconds:
            legal = np.flatnonzero(self._info["action_mask"])
            _, _, terminated, truncated, self._info = self._env.step(int(self._rng.choice(legal)))
            number += self._info["duration"]
            if terminated or truncated:
                _, self._info = self._env.reset()
        return number / past


class _View:
    """Random primitives on the page, at the pace of manual mode."""

    def __init__(self, instance: RoomInstance, server: Any) -> None:
        self._env = EscapeRoomEnv(instance=instance)
        self._env.reset(seed=0)
        self._page = RoomPage(server, instance, self._env.get_state())
        self._rng = np.random.default_rng(0)

    def measure(self, seconds: float) -> float:
        number, begin = 0, time.perf_counter()
        while (past := time.perf_counter() - begin) < seconds:
            _, _, terminated, truncated, _ = self._env.step(int(self._rng.integers(len(self._env.rules.actions))))
            self._page.move(self._env.get_state(), PLAY_STRIDE)
            number += 1
            if terminated or truncated:
                self._env.reset()
        return number / past


def _print(instance: RoomInstance, rows: list[dict[str, Any]]) -> None:
    table = Table(box=None, padding=(0, 2), pad_edge=False)
    table.add_column("mode", no_wrap=True)
    for heading in ("primitives/s", "times real time", "times published"):
        table.add_column(heading, justify="right")
    for row in rows:
        table.add_row(row["mode"], f"{row['primitives_per_second']:,.1f}", f"{row['times_real_time']:,.1f}",
                      f"{row['times_published']:,.1f}")
    table.caption = f"{instance.name}, room {instance.seed}; random choices, planning included; medians of one run"
    Console(soft_wrap=True).print(table)


if __name__ == "__main__":
    sys.exit(run_script(run))
