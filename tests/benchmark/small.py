"""A comparison that takes seconds: one small room with several starts, short episodes, quick agents."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from hrl_escape.agents.spec import AgentSpec, OptionsView
from hrl_escape.benchmark.comparison import WHOLE, Comparison, Shard, run_grid
from hrl_escape.benchmark.grid import Grid, GridRun
from hrl_escape.benchmark.launching.local import Launcher, Listener, report_outcome
from hrl_escape.benchmark.launching.worker import run_guarded
from hrl_escape.benchmark.runs import get_training_folder
from hrl_escape.env.config import RobotConfig, RoomConfig, ShapeConfig, StartConfig
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.sets.room_spec import RoomSpec

SCHEMATIC = RoomConfig(
    name="small",
    room=ShapeConfig(width=8, depth=8),
    robot=RobotConfig(body_radius=0.5),
    puzzle=ButtonsConfig(count=2, buttons=Panels(width=2.0)),
    start=StartConfig(choices=4),
    horizon=80,
)
SMALL = Grid(
    name="small",
    agents=(
        AgentSpec("random"),
        AgentSpec("q-learning"),
        AgentSpec("random-options"),
        AgentSpec("smdp-q-learning", label="only options", options=OptionsView(include_primitives=False)),
    ),
    rooms=(RoomSpec(config=SCHEMATIC.to_dict()),),
    runs=2,
    primitives=600,
    eval_every=200,
    eval_episodes=3,
)


def change(**fields: object) -> Grid:
    """The small grid with some fields changed; agents and rooms may be short texts."""
    for name, kind in (("agents", AgentSpec), ("rooms", RoomSpec)):
        if name in fields:
            fields[name] = tuple(kind.parse(item) if isinstance(item, str) else item for item in fields[name])  # type: ignore[attr-defined]
    return dataclasses.replace(SMALL, **fields)  # type: ignore[arg-type]


def run_quietly(grid: Grid, out: Path, launcher: Launcher | None = None, shard: Shard = WHOLE) -> Comparison:
    """Run a grid, or a part of it, silently."""
    with open("/dev/null", "w") as nowhere:
        return run_grid(grid, out, launcher, Console(file=nowhere), shard)


class OneProcess:
    """Launcher that executes runs in this process, one after another: no server of processes has to load libraries."""

    def run(self, runs: Sequence[GridRun], out: Path, listener: Listener) -> None:
        """Execute all runs."""
        for run in runs:
            report_outcome(out, run, 0, run_guarded(run, out, 10.0), listener)


def break_checkpoint(out: Path, run: GridRun) -> Path:
    """Put a damaged checkpoint where a run that is to be made looks for one."""
    broken = get_training_folder(out, run) / "checkpoint.npz"
    broken.parent.mkdir(parents=True)
    broken.write_bytes(b"no checkpoint")
    return broken


STRANGER = '''
import os, signal
from hrl_escape.agents.algorithms.random import RandomAgent

class Stranger(RandomAgent):
    recipes = {}
    def observe(self, transition):
        self._seen = getattr(self, "_seen", 0) + 1
        if self._seen > 40:
            self.fall()
        return {}

class Raiser(Stranger):
    def fall(self):
        print("last words", flush=True)
        raise KeyError("what a stranger forgot")

class Crasher(Stranger):
    def fall(self):
        os.kill(os.getpid(), signal.SIGSEGV)
'''


def plant_strangers(folder: Path) -> None:
    """Write an installed package with the agents raiser and crasher; the folder must be on the path."""
    package = folder / "strangers-1.0.dist-info"
    package.mkdir()
    (folder / "strangers.py").write_text(STRANGER)
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: strangers\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text(
        "[hrl_escape.agents]\nraiser = strangers:Raiser\ncrasher = strangers:Crasher\n")
