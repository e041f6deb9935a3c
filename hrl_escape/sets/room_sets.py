"""Sets of rooms by a short text: those of a ladder, a range of a preset's instances, or a file; and towers of sets.

| text | rooms |
|---|---|
| `ladder-1/lattice/train` | the set of a rung |
| `ladder-1/lattice/train[:64]` | its first 64 rooms |
| `ladder-1/lattice/test[3]` | one of them |
| `clutter#0..15` | instances 0 to 15 of a preset |
| `rooms.json` | a file with `name`, `config` and `seeds`, as `InstanceSet.save` writes it |
| `A + B`, `A x 3` | a tower of these sets, one above another; three floors of one set |

The floors of a tower share one horizon.
"""

from __future__ import annotations

import dataclasses
import hashlib
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import gymnasium
from gymnasium.vector import VectorEnv

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.generation import sample_puzzle
from hrl_escape.errors import ConfigError, UnknownNameError
from hrl_escape.names import parse_whole
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.sets.instance_set import InstanceSet

_FORM = re.compile(r"(?P<name>[^\[\]]+)(?:\[(?P<start>\d*)(?P<colon>:?)(?P<stop>\d*)\])?")


def parse_room_set(text: str) -> InstanceSet:
    """Rooms of a short text; none is generated yet.

    Raises:
        ConfigError: the text names no rooms.
        UnknownNameError: no such benchmark, rung, set or preset.
        FileReadError: the file is missing or damaged.
    """
    form = _FORM.fullmatch(text)
    if form is None or text.endswith("[]"):
        raise ConfigError("rooms", text, "such as ladder-1/lattice/train[:64], clutter#0..15 or rooms.json")
    rooms = _find(form["name"])
    if form["start"] is not None:
        start = int(form["start"] or 0)
        stop = int(form["stop"] or len(rooms)) if form["colon"] else start + 1
        if not start < min(stop, len(rooms)):
            raise ConfigError("rooms", text, f"at least one of the {len(rooms)} rooms of {form['name']}")
        name, rooms = rooms.name, rooms[start:stop]
        rooms.name = name + text[len(form["name"]):]
    return rooms


def make_ladder_env(benchmark: str = "ladder-1", rung: str = "pair", set: str = "train", slice: str = "",
                    options: bool | Mapping[str, Any] = False, **arguments: Any) -> gymnasium.Env:
    """Make an environment over a rung's set of rooms; the entry point of `hrl_escape/Ladder-v1`.

    Args:
        benchmark: one that comes with the package, or a manifest file.
        rung: name of the rung.
        set: `train`, `valid`, `test` or `test_task`.
        slice: part of the set, such as `:64`, `64:128` or `3`; empty for all rooms.
        options: wrap it in an `OptionsEnv`; a table gives its arguments.
        arguments: all other arguments of `EscapeRoomEnv`, such as `observation="objects"`.

    Raises:
        UnknownNameError: no such benchmark, rung, set or argument.
        ConfigError: the slice holds no room.
    """
    return _find_ladder(benchmark, rung, set, slice).make_env(options, **arguments)


def make_ladder_vec(num_envs: int = 1, benchmark: str = "ladder-1", rung: str = "pair", set: str = "train",
                    slice: str = "", options: bool | Mapping[str, Any] = False, **arguments: Any) -> VectorEnv:
    """Make a vector environment over a rung's set; every episode draws a room. See `make_ladder_env`."""
    rooms = _find_ladder(benchmark, rung, set, slice)
    if not isinstance(options, Mapping) and not options:
        return rooms.make_vec(num_envs, **arguments)  # type: ignore[return-value]  # without options it is one
    from hrl_escape.options.batched.vector_env import OptionsVectorEnv  # loads torch

    chosen = dict(options) if isinstance(options, Mapping) else {}
    return OptionsVectorEnv(num_envs, **{"instance": list(rooms), "resample_instance": True, **arguments, **chosen})


def _find_ladder(benchmark: str, rung: str, role: str, part: str) -> InstanceSet:
    return parse_room_set(f"{benchmark}/{rung}/{role}" + (f"[{part}]" if part else ""))


def _find(name: str) -> InstanceSet:
    if name.count("/") >= 2 and not name.endswith(".json"):
        bench, rung, role = name.rsplit("/", 2)
        sets = load_benchmark(bench)[rung].sets
        if role not in sets:
            raise UnknownNameError(f"set of {bench}/{rung}", role, sets)
        return sets[role]
    if name.endswith(".json"):
        return InstanceSet.load(name)
    preset, _, seeds = name.partition("#")
    low, _, high = (seeds or "0").partition("..")
    first, last = parse_whole(low), parse_whole(high or low)
    if first is None or last is None or first > last:
        raise ConfigError("rooms", name, f"a range of instances such as {preset}#0..15")
    return InstanceSet(name, get_preset(preset), range(first, last + 1))


TOWER_HORIZON = 20_000
"""Primitives of an episode, on all floors together."""
ABOVE = " + "
"""Stands in a tower's short text between a floor and the one above."""
_REPEATED = re.compile(r"(.+) x (\d+)")


class Tower:
    """Sets of rooms, a floor each, from the bottom to the top; every room has the horizon of the tower.

    Where they are paired, rooms of one number belong together, an episode is in these, and sets have equally many.
    """

    def __init__(self, floors: Sequence[InstanceSet], paired: bool = False) -> None:
        self.paired = paired
        self.floors = tuple(InstanceSet(rooms.name, dataclasses.replace(rooms.config, horizon=TOWER_HORIZON),
                                        rooms.seeds) for rooms in floors)
        self.name = f"{self.floors[0].name} and {len(self.floors) - 1} floors above"

    def __len__(self) -> int:
        return sum(map(len, self.floors))

    def __getitem__(self, index: int) -> RoomInstance:
        return self.floors[0][index]

    def describe(self) -> dict[str, Any]:
        """Return the tower as JSON values, as a set does; `load_rooms` makes it again from the content."""
        parts = [floor.describe() for floor in self.floors]
        digest = hashlib.sha256("".join(part["id"] for part in parts).encode()).hexdigest()
        return {"id": digest[:16], "content": {"floors": [part["content"] for part in parts],
                                               **({"paired": True} if self.paired else {})}}


def repeat_floor(rooms: InstanceSet, floors: int) -> Tower:
    """Make a tower whose floors have one motif of marks in an episode, and another room of the set each.

    Rooms whose motif fewer rooms have than there are floors are left out.

    Raises:
        ConfigError: marks without motifs, fewer than two floors, or a set of too few rooms.
    """
    puzzle, name = rooms.config.puzzle, f"{rooms.name} x {floors}"
    if floors < 2 or not isinstance(puzzle, ButtonsConfig) or puzzle.marks.motifs < 2:
        raise ConfigError("floors", name, "two or more floors, from rooms whose marks have motifs")
    groups: dict[int, list[int]] = defaultdict(list)
    for seed in rooms.seeds:
        drawn: Any = sample_puzzle(rooms.config, seed)[1]
        groups[puzzle.marks.find_motif(drawn.marks, drawn.edge_list, drawn.goal)].append(seed)
    kept = [group for _, group in sorted(groups.items()) if len(group) >= floors]
    if not kept:
        raise ConfigError("floors", name, "a set with as many rooms of a motif as floors")
    sets = [InstanceSet(name, rooms.config, [seed for group in kept
                        for seed in (*group[floor:], *group[:floor])]) for floor in range(floors)]
    return Tower(sets, paired=True)


RoomSets: TypeAlias = "InstanceSet | Tower"
"""A set of rooms, one for each episode, or a tower, one for each floor."""


def list_sets(rooms: RoomSets) -> tuple[InstanceSet, ...]:
    """The floors of a tower; a set alone."""
    return rooms.floors if isinstance(rooms, Tower) else (rooms,)


def parse_rooms(text: str) -> RoomSets:
    """Rooms of a short text: a set, with ` + ` between several the floors of a tower, with ` x 3` one that repeats."""
    if repeated := _REPEATED.fullmatch(text):
        return repeat_floor(parse_room_set(repeated[1].strip()), int(repeated[2]))
    first, *above = (parse_room_set(part.strip()) for part in text.split(ABOVE))
    return Tower((first, *above)) if above else first


def load_rooms(content: Mapping[str, Any]) -> RoomSets:
    """Make rooms from the content of their description."""
    if "floors" in content:
        return Tower([InstanceSet.from_description(floor) for floor in content["floors"]],
                     bool(content.get("paired")))
    return InstanceSet.from_description(content)
