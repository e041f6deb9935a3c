"""Towers: sets of rooms as floors, one above another, that share one horizon."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

from hrl_escape.env.instance import RoomInstance
from hrl_escape.ladder.instance_set import InstanceSet
from hrl_escape.ladder.room_sets import parse_room_set

TOWER_HORIZON = 20_000
"""Primitives of an episode, on all floors together."""
_ABOVE = " + "


class Tower:
    """Sets of rooms, a floor each, from the bottom to the top; every room has the horizon of the tower.

    Args:
        floors: two sets or more.

    Attributes:
        floors: the same sets, with the tower's horizon.
        name: that of the lowest floor, and how many there are above.
    """

    def __init__(self, floors: Sequence[InstanceSet]) -> None:
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
        return {"id": digest[:16], "content": {"floors": [part["content"] for part in parts]}}


RoomSets: TypeAlias = "InstanceSet | Tower"
"""A set of rooms, one for each episode, or a tower, one for each floor."""


def list_sets(rooms: RoomSets) -> tuple[InstanceSet, ...]:
    """The floors of a tower; a set alone."""
    return rooms.floors if isinstance(rooms, Tower) else (rooms,)


def join_floors(texts: Iterable[str]) -> str:
    """Short text of the tower whose floors have these short texts."""
    return _ABOVE.join(texts)


def parse_rooms(text: str) -> RoomSets:
    """Rooms of a short text: a set, or with ` + ` between several the floors of a tower.

    Raises:
        EscapeError: see `parse_room_set`.
    """
    first, *above = (parse_room_set(part.strip()) for part in text.split(_ABOVE))
    return Tower((first, *above)) if above else first


def load_rooms(content: Mapping[str, Any]) -> RoomSets:
    """Make rooms from the content of their description."""
    if "floors" in content:
        return Tower([InstanceSet.from_description(floor) for floor in content["floors"]])
    return InstanceSet.from_description(content)
