"""Towers: sets of rooms as floors, one above another, that share one horizon."""

from __future__ import annotations

import dataclasses
import hashlib
import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.ranges import sample_puzzle
from hrl_escape.errors import ConfigError
from hrl_escape.ladder.instance_set import InstanceSet
from hrl_escape.ladder.room_sets import parse_room_set

TOWER_HORIZON = 20_000
"""Primitives of an episode, on all floors together."""
_ABOVE = " + "
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

    Args:
        rooms: a set whose marks have motifs.
        floors: how many, two or more.

    Raises:
        ConfigError: marks without motifs, fewer floors, or a set of too few rooms.
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


def join_floors(texts: Iterable[str]) -> str:
    """Short text of the tower whose floors have these short texts."""
    return _ABOVE.join(texts)


def parse_rooms(text: str) -> RoomSets:
    """Rooms of a short text: a set, with ` + ` between several the floors of a tower, with ` x 3` one that repeats.

    Raises:
        EscapeError: see `parse_room_set`.
    """
    if repeated := _REPEATED.fullmatch(text):
        return repeat_floor(parse_room_set(repeated[1].strip()), int(repeated[2]))
    first, *above = (parse_room_set(part.strip()) for part in text.split(_ABOVE))
    return Tower((first, *above)) if above else first


def load_rooms(content: Mapping[str, Any]) -> RoomSets:
    """Make rooms from the content of their description."""
    if "floors" in content:
        return Tower([InstanceSet.from_description(floor) for floor in content["floors"]],
                     bool(content.get("paired")))
    return InstanceSet.from_description(content)
