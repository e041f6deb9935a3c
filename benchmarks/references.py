"""References of a benchmark's rungs, and the choice of the rungs of a profile.

    python -m benchmarks.references measure ladder-2
    python -m benchmarks.references measure ladder-2 --rung depth-1 depth-2
    python -m benchmarks.references choose benchmarks/ladder-2.toml

To measure is to play an episode in each of the first test rooms: random choices, the search baselines, the
planner, and `bayes` where all puzzles can be listed. Where nothing is hidden, the planner stands for `bayes`. What was
measured before is kept.

To choose is to go along each axis of a profile, whose candidates stand from easy to hard, and to measure its yardstick
in rooms that are in no set: the best search baseline, or random moves. Rung by rung, the candidate with the efficiency
nearest to the next target is chosen, without any training. Measured efficiencies stay in
`NAME-calibration.json` next to the file; `python -m benchmarks.ladder freeze` writes the manifest.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from numpy.typing import NDArray

from hrl_escape.agents import make_agent
from hrl_escape.agents.spec import BAYES, ORACLE, AgentSpec
from hrl_escape.agents.training.evaluation import compute_episode_seed, evaluate
from hrl_escape.benchmark.agent_env import make_agent_env
from hrl_escape.benchmark.references.bayes import SHOWN
from hrl_escape.benchmark.references.graph_family import GraphFamily, condition_on_room, make_family
from hrl_escape.benchmark.references.registry import SEARCH_METHODS, make_reference
from hrl_escape.benchmark.rung_references import RungReferences, load_references
from hrl_escape.benchmark.standings import compute_headroom
from hrl_escape.benchmark.statistics import compute_efficiency
from hrl_escape.cli import run_script
from hrl_escape.commands.room_choice import split_assignment
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.errors import UnsupportedError
from hrl_escape.files import read_json, read_toml, write_json
from hrl_escape.planning.best_known import find_best_known, list_start_states
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.sets.changes import change_field
from hrl_escape.sets.instance_set import InstanceSet
from hrl_escape.sets.manifest import AxisRecord, Manifest, RungRecord, SetRecord
from hrl_escape.sets.rung import Rung, derive_seed

_FOLDER = Path(__file__).parents[1] / "hrl_escape/benchmark/data/references"
CHANCE, MOVES = "random-options", "random"
YARDSTICKS: Mapping[str, tuple[str, ...]] = {"searchers": SEARCH_METHODS, "moves": (MOVES,)}
"""Agents whose best efficiency is the yardstick of an axis."""


@dataclasses.dataclass(frozen=True)
class Measure:
    """Options of the measurement of references."""

    benchmark: Annotated[str, tyro.conf.Positional]
    """Benchmark that comes with the package."""
    rung: tuple[str, ...] = ()
    """Names of rungs; all that are missing by default."""
    rooms: int = 64
    """Test rooms, from the first."""


@dataclasses.dataclass(frozen=True)
class Choose:
    """Options of the choice of rungs."""

    profile: Annotated[Path, tyro.conf.Positional]
    """File of the axes and their candidates."""
    axis: tuple[str, ...] = ()
    """Axes to measure; all by default. The manifest is written once all are known."""


def play(agent: str, rooms: InstanceSet) -> NDArray[np.float64] | None:
    """Efficiency of a reference in an episode in each room, (rooms,), or None if the puzzle does not suit it."""
    spec = AgentSpec.parse(agent)
    fewest = [find_best_known(room, list_start_states(room)[0]).primitives or math.nan for room in rooms]
    order = {str(compute_episode_seed(0, "evaluation", number)): number for number in range(len(rooms))}
    try:
        env, recorder = make_agent_env(spec, rooms, "objects", order)
        with closing(env):
            player = (make_reference(spec.name, env, recorder) if spec.is_reference else
                      make_agent(spec.name, env.observation_space, env.action_space, 0))
            found = evaluate(player, env, len(rooms))
    except UnsupportedError:
        return None
    return compute_efficiency(found.escaped, found.lengths, fewest).clip(max=1.0)


def average(scores: NDArray[np.float64]) -> float:
    """Mean over rooms, as it is written."""
    return round(float(scores.mean()), 4)


def compute_entropy(family: GraphFamily) -> float:
    """Uncertainty about the graph and the rule, bits."""
    return float(-(family.weights * np.log2(family.weights)).sum())


def measure_information(config: ButtonsConfig, rooms: Sequence[RoomInstance]) -> tuple[float, float]:
    """Bits that cues and places of rooms reveal about the hidden graph, and bits of graph and rule in total.

    Means over rooms.

    Raises:
        UnsupportedError: the graphs cannot be listed, see `make_family`.
    """
    families = [make_family(config, len(room.targets)) for room in rooms]
    told = [compute_entropy(family) - compute_entropy(condition_on_room(family, config, room))
            for family, room in zip(families, rooms, strict=True)]
    return float(np.mean(told)), float(np.mean(list(map(compute_entropy, families))))


def measure_rung(rung: Rung, rooms: int) -> RungReferences:
    """References in the first test rooms."""
    tested = rung.test[:rooms]
    scores = {agent: found for agent in (CHANCE, *SEARCH_METHODS, ORACLE) if (found := play(agent, tested)) is not None}
    by = max((name for name in SEARCH_METHODS if name in scores), key=lambda name: scores[name].mean())
    found = RungReferences(average(scores[CHANCE]), average(scores[by]), by, average(scores[ORACLE]))
    return measure_bayes(rung, rooms, found, scores[by])


def measure_bayes(rung: Rung, rooms: int, known: RungReferences, search: NDArray[np.float64] | None = None
                  ) -> RungReferences:
    """Add the Bayes planner, where it is exact, and its lead over the best search baseline, (rooms,)."""
    tested, puzzle = rung.test[:rooms], rung.config.puzzle
    told = hidden = None
    if isinstance(puzzle, ButtonsConfig):
        try:
            told, hidden = (round(bits, 3) for bits in measure_information(puzzle, tested))
        except UnsupportedError:
            return known  # too many graphs: the Bayes planner would sample
    scores = np.ones(len(tested)) if isinstance(puzzle, SHOWN) else play(BAYES, tested)
    search = play(known.by, tested) if search is None else search
    if scores is None or search is None:
        return known
    gap = compute_headroom(search, scores)
    return dataclasses.replace(known, bayes=average(scores), told=told, hidden=hidden,
                               headroom=tuple(round(value, 4) for value in gap))


def measure(args: Measure) -> int:
    """Write the references of a benchmark, rung by rung."""
    bench, path = load_benchmark(args.benchmark), _FOLDER / f"{args.benchmark}.json"
    table = _read(path)
    for rung in [bench[name] for name in args.rung] or list(bench):
        known = None if args.rung or rung.name not in table else load_references(args.benchmark)[rung.name]
        if known is None:
            found = measure_rung(rung, args.rooms)
        elif known.headroom is None:
            found = measure_bayes(rung, args.rooms, known)
        else:
            continue
        table[rung.name] = {name: value for name, value in dataclasses.asdict(found).items() if value is not None}
        write_json(path, {own.name: table[own.name] for own in bench if own.name in table}, indent=1)
        print(f"{rung.name}: {found}", flush=True)
    return 0


def _read(path: Path) -> dict[str, Any]:
    return read_json(path, "measurements") if path.exists() else {}


def choose_levels(curve: Sequence[float], targets: Sequence[float]) -> list[int]:
    """Numbers of the candidates to take, ascending: for each target the nearest of those that leave some for the rest.

    Args:
        curve: efficiency of the yardstick at each candidate, from easy to hard.
        targets: efficiencies, as many as rungs.
    """
    chosen: list[int] = []
    for left, target in zip(range(len(targets) - 1, -1, -1), targets, strict=True):
        open_ = range(chosen[-1] + 1 if chosen else 0, len(curve) - left)
        chosen.append(min(open_, key=lambda number: abs(curve[number] - target)))
    return chosen


def make_config(name: str, changes: str) -> RoomConfig:
    """Room configuration of a name with fields changed, written as for `--set`."""
    fields = RoomConfig().to_dict() | {"name": name}
    for text in changes.split():
        change_field(fields, *split_assignment(text, "set", "puzzle.count=3"))
    return RoomConfig.from_dict(fields)


def measure_candidates(data: Mapping[str, Any], axis: Mapping[str, Any], known: dict[str, dict[str, float]]
                       ) -> Iterable[str]:
    """Fill in what the yardstick reaches with each candidate of an axis; yields a line for each."""
    for value in axis["values"]:
        place = f"{axis['name']}: {value}"
        if place in known:
            continue
        config = make_config(axis["name"], f"{data['set']} {axis['set']} {value}")
        rooms = InstanceSet(place, config, [derive_seed(data["name"], place, "calibration", index)
                                            for index in range(data["rooms"])])
        found = {agent: play(agent, rooms) for agent in YARDSTICKS[axis["yardstick"]]}
        known[place] = {agent: average(scores) for agent, scores in found.items() if scores is not None}
        yield f"{place}: {known[place]}"


def choose(args: Choose) -> int:
    """Measure candidates and write the manifest, without roots."""
    data = read_toml(args.profile, "profile")
    path = args.profile.with_name(f"{args.profile.stem}-calibration.json")
    known = _read(path)
    for axis in data["axis"]:
        if not args.axis or axis["name"] in args.axis:
            for line in measure_candidates(data, axis, known):
                known |= _read(path)  # another process may measure other axes
                write_json(path, known, indent=1)
                print(line, flush=True)
    records: list[RungRecord] = []
    axes: list[AxisRecord] = []
    for axis in data["axis"]:
        places = [f"{axis['name']}: {value}" for value in axis["values"]]
        if any(place not in known for place in places):
            print(f"{axis['name']} is missing, so no manifest is written")
            return 0
        numbers = choose_levels([max(known[place].values()) for place in places], axis.get("targets", data["targets"]))
        for level, number in enumerate(numbers, 1):
            name = f"{axis['name']}-{level}"
            config = make_config(name, f"{data['set']} {axis['set']} {axis['values'][number]}")
            train, valid, test = (SetRecord(count=data[role]) for role in ("train", "valid", "test"))
            records.append(RungRecord(name, axis["isolates"], config, train=train, valid=valid, test=test))
        axes.append(AxisRecord(axis["name"], tuple(record.name for record in records[-len(numbers):]),
                               axis.get("observation", "")))
    target = args.profile.with_suffix(".json")
    Manifest(data["name"], rungs=tuple(records), axes=tuple(axes)).save(target)
    print(f"wrote {target}: {len(records)} rungs")
    return 0


def run(args: Measure | Choose) -> int:
    """Measure references, or choose the rungs of a profile."""
    return measure(args) if isinstance(args, Measure) else choose(args)


if __name__ == "__main__":
    sys.exit(run_script(run))
