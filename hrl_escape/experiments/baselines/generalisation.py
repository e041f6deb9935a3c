"""Efficiency in unseen rooms against the number of training rooms, and in deeper puzzles than any trained on."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import NamedTuple

from hrl_escape.env.config import Between, RoomConfig
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.experiments.grid import AgentSpec, Grid
from hrl_escape.experiments.protocols import LadderSettings, make_protocol_grid
from hrl_escape.ladder.benchmark import Benchmark
from hrl_escape.ladder.hidden import derive_seed
from hrl_escape.ladder.instance_set import InstanceSet

__all__ = ["DEPTHS", "FLAT", "MEMORY", "OBJECTS", "TRAINING_ROOMS", "TRAINED", "VECTORS", "GeneralisationSettings",
           "make_depth_grid", "make_sizes_grid"]

TRAINING_ROOMS = (1, 4, 16, 64, 256, 1000)
"""Numbers of training rooms; the last is the whole set, of which few runs see a room twice."""
FLAT, VECTORS = "ppo+objects", "smdp-ppo+no-primitives"
OBJECTS, MEMORY = "smdp-ppo+objects+no-primitives", "smdp-ppo+objects+memory+no-primitives"
CHANCE, KNOWN = "smdp-random+no-primitives", "planner"
TRAINED = "2 to 4 buttons"
DEPTHS = {"6 buttons, layered": (6, "layered"), "6 buttons, one chain": (6, "chain"),
          "8 buttons, layered": (8, "layered"), "10 buttons, layered": (10, "layered")}
"""Rooms to be tested in after training in shallow ones; two of the same number, the chain being deeper."""


class GeneralisationSettings(NamedTuple):
    """Size of the study.

    Attributes:
        rung: to train and test on against the number of training rooms.
        runs: training seeds.
        primitives: training budget.
        rooms: test rooms.
        train_size: training rooms of shallow puzzles.
    """

    rung: str
    runs: int
    primitives: int
    rooms: int
    train_size: int = 256


def make_sizes_grid(bench: Benchmark, settings: GeneralisationSettings) -> Grid:
    """Grid over numbers of training rooms of a rung.

    Raises:
        EscapeError: no such rung, or more rooms than it has.
    """
    agents = tuple(map(AgentSpec.parse, (FLAT, VECTORS, OBJECTS, MEMORY, CHANCE)))
    most = bench[settings.rung].record.train.count
    sizes = LadderSettings(settings.runs, settings.primitives, settings.rooms,
                           tuple(size for size in TRAINING_ROOMS if size <= most))
    return make_protocol_grid(bench, settings.rung, "generalise", agents, sizes)


def make_depth_grid(bench: Benchmark, settings: GeneralisationSettings, folder: Path) -> Grid:
    """Grid of training in rooms of few buttons and tests in deeper ones, whose sets are written to a folder.

    Raises:
        FileWriteError: the folder cannot be written.
    """
    base = bench["lattice"].config
    train = _save(folder, TRAINED, _change(base, Between(2, 4), "layered"), settings.train_size)
    tests = tuple(_save(folder, name, _change(base, count, kind), settings.rooms)
                  for name, (count, kind) in DEPTHS.items())
    return Grid(
        name="depth", description="Trained in rooms of 2 to 4 buttons, tested in deeper ones without learning.",
        agents=tuple(map(AgentSpec.parse, (OBJECTS, MEMORY, CHANCE, KNOWN))), train_rooms=(train,) * len(tests),
        test_rooms=tests, runs=settings.runs, primitives=settings.primitives,
        eval_every=settings.primitives, eval_episodes=settings.rooms, observation="objects",
    )


def _change(base: RoomConfig, count: int | Between, kind: str) -> RoomConfig:
    assert isinstance(base.puzzle, ButtonsConfig)
    graph = base.puzzle.graph if kind == "layered" else GraphConfig(kind="chain")
    return dataclasses.replace(base, puzzle=dataclasses.replace(base.puzzle, count=count, graph=graph))


def _save(folder: Path, name: str, config: RoomConfig, count: int) -> str:
    path = folder / f"{name.replace(' ', '-').replace(',', '')}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    InstanceSet(name, config, [derive_seed("generalisation", name, "rooms", i) for i in range(count)]).save(path)
    return str(path)
