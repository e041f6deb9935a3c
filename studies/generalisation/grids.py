"""Efficiency in unseen rooms against the number of training rooms, and in deeper puzzles than any trained on."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

from hrl_escape.agents.spec import parse_specs
from hrl_escape.benchmark.grid import Grid
from hrl_escape.benchmark.protocols import LadderSettings, make_protocol_grid
from hrl_escape.env.config import Between, RoomConfig
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.files import read_toml
from hrl_escape.sets.benchmark import Benchmark
from hrl_escape.sets.instance_set import InstanceSet
from hrl_escape.sets.rung import derive_seed
from studies.ladder.calibration import CHANCE, KNOWN
from studies.running import GridArgs

__all__ = ["AT_ONCE", "CEILING", "DEPTHS", "FLAT", "FLAT_CHANCE", "MEMORY", "OBJECTS", "NAMES", "SEARCH_BASELINES",
           "TRAINED", "TRANSFER", "VECTORS", "GeneralisationArgs", "make_depth_grid", "make_depth_sets",
           "make_sizes_grid"]

_DATA = read_toml(Path(__file__).with_name("study.toml"))
DEPTHS: dict[str, dict[str, Any]] = _DATA["depths"]
TRAINED: str = _DATA["trained"]
TRANSFER: tuple[str, ...] = tuple(_DATA["transfer"])
NAMES: dict[str, str] = _DATA["names"]
FLAT, VECTORS, OBJECTS, MEMORY = NAMES
AT_ONCE = ", many rooms at once"
"""End of the labels of learners that learn from many rooms at once."""
FLAT_CHANCE = "random"
SEARCH_BASELINES: dict[str, str] = _DATA["searchers"]
CEILING: dict[str, str] = _DATA["ceiling"]


Part: TypeAlias = Literal["sizes", "depth", "many", "many-depth", "transfer"]


@dataclasses.dataclass(frozen=True)
class GeneralisationArgs(GridArgs):
    """Options of the study of generalisation."""

    part: tuple[Part, ...] = get_args(Part)
    """Parts: numbers of training rooms, deeper puzzles, both again for learners from many rooms at once, and of these
    other rungs than the one trained in."""
    rung: str = "lattice"
    """Rung of the numbers of training rooms."""
    agents: tuple[str, ...] = ()
    """Agents, as for `hrl-escape ladder run`; those of the part by default."""
    sizes: tuple[int, ...] = tuple(_DATA["sizes"])
    """Numbers of training rooms; of a rung with fewer, those that it has."""
    runs: int = 5
    """Training seeds."""
    primitives: int = 1_000_000
    """Training budget of a run."""
    rooms: int = 64
    """Rooms to be tested in."""
    shallow_rooms: int = 256
    """Rooms to train in, in the parts on depth and other rungs."""


def make_sizes_grid(bench: Benchmark, args: GeneralisationArgs) -> Grid:
    """Grid over numbers of training rooms of a rung.

    Raises:
        EscapeError: no such rung, or more rooms than it has.
    """
    names = args.agents or (*NAMES, *SEARCH_BASELINES, *CEILING, CHANCE, FLAT_CHANCE)
    agents = parse_specs(names)
    sizes = tuple(size for size in args.sizes if size <= bench[args.rung].record.train.count)
    settings = LadderSettings(args.runs, args.primitives, args.rooms, sizes, first_seed=args.first_seed)
    grid = make_protocol_grid(bench, args.rung, "generalise", agents, settings)
    return dataclasses.replace(grid, eval_every=args.primitives)  # only what is known at the end is shown


def make_depth_grid(bench: Benchmark, args: GeneralisationArgs, folder: Path) -> Grid:
    """Grid of training in rooms of few buttons and tests in deeper ones, whose sets are written to a folder.

    Raises:
        FileWriteError: the folder cannot be written.
    """
    train, tests = make_depth_sets(bench, args.shallow_rooms, args.rooms)
    return Grid(
        name="depth", description="Trained in rooms of 2 to 4 buttons, tested in deeper ones without learning.",
        agents=parse_specs(args.agents or (OBJECTS, MEMORY, *SEARCH_BASELINES, *CEILING, CHANCE, KNOWN)),
        train_rooms=(_save(folder, train),) * len(tests), test_rooms=tuple(_save(folder, test) for test in tests),
        runs=args.runs, first_seed=args.first_seed, primitives=args.primitives, eval_every=args.primitives,
        eval_episodes=args.rooms, observation="objects",
    )


def make_depth_sets(bench: Benchmark, trained: int, tested: int) -> tuple[InstanceSet, list[InstanceSet]]:
    """Rooms of few buttons to train in, and those of each of `DEPTHS` to be tested in, by their numbers."""
    base = bench["lattice"].config
    return (_make_set(TRAINED, _change(base, Between(2, 4), "layered"), trained),
            [_make_set(name, _change(base, depth["count"], depth["graph"]), tested) for name, depth in DEPTHS.items()])


def _change(base: RoomConfig, count: int | Between, kind: str) -> RoomConfig:
    assert isinstance(base.puzzle, ButtonsConfig)
    graph = base.puzzle.graph if kind == "layered" else GraphConfig(kind="chain")
    return dataclasses.replace(base, puzzle=dataclasses.replace(base.puzzle, count=count, graph=graph))


def _make_set(name: str, config: RoomConfig, count: int) -> InstanceSet:
    return InstanceSet(name, config, [derive_seed("generalisation", name, "rooms", i) for i in range(count)])


def _save(folder: Path, rooms: InstanceSet) -> str:
    path = folder / f"{rooms.name.replace(' ', '-').replace(',', '')}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    rooms.save(path)
    return str(path)
