"""Doors between the rooms of a floor plan: their doorways, and the targets that may lie behind each.

An order in which the puzzle opens its doors is drawn first. Doors are then hung outwards from the room of the starts in
that order, and a target is allowed in the rooms that are open by the time the order needs it: so the order escapes.
Doorways join the rooms to a tree, so that one way, with the same doors for all, leads to each room.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.config import CONTACT_SKIN, RoomConfig
from hrl_escape.env.geometry import Solid
from hrl_escape.env.instance import Rectangle, Target
from hrl_escape.env.puzzles.base import Puzzle
from hrl_escape.env.puzzles.traits import Doored, get_trait
from hrl_escape.env.sampling.floorplan import Floorplan, Rejected
from hrl_escape.errors import ConfigError

__all__ = ["DoorPlan", "sample_doors"]


class DoorPlan(NamedTuple):
    """Doors of a floor plan.

    Attributes:
        solids: the doors, in the puzzle's order.
        rooms: the floor's rooms; one where there are no doors.
        ways: doors on the way from the starts to each room.
        opened: target's name -> doors open by the time it is needed; targets without an entry are not needed.
    """

    solids: tuple[Solid, ...] = ()
    rooms: tuple[Rectangle, ...] = ()
    ways: tuple[tuple[int, ...], ...] = ()
    opened: Mapping[str, frozenset[int]] = MappingProxyType({})

    def allows(self, target: Target) -> bool:
        """Return whether a target lies in one room, and that room is open when the target is needed."""
        if not self.solids:
            return True
        room = self._find_room(target)
        needed = self.opened.get(target.name)
        return room is not None and (needed is None or needed.issuperset(self.ways[room]))

    def _find_room(self, target: Target) -> int | None:
        """Room that holds all of a target's outline; panels hang a little in front of their wall."""
        shape = target.footprint
        places = [(shape.x + share * shape.cos * shape.half_x, shape.y + share * shape.sin * shape.half_x)
                  for share in (-1, 1)]
        return next((number for number, room in enumerate(self.rooms)
                     if all(room.contains(x, y) for x, y in places)), None)

    def list_ways(self, targets: Sequence[Target], exit_: Rectangle, body_radius: float) -> tuple[tuple[int, ...], ...]:
        """Doors on the way to each target and last to the exit, as a `RoomInstance` has them.

        Raises:
            Rejected: a target or the exit lies in more than one room, or in none.
        """
        if not self.solids:
            return ()
        ways = []
        for target in targets:
            room = self._find_room(target)
            if room is None or not self.allows(target):
                raise Rejected(f"{target.name} must be in one room, which is open when it is needed")
            ways.append(self.ways[room])
        return (*ways, self._find_way_out(exit_, body_radius))

    def _find_way_out(self, exit_: Rectangle, body_radius: float) -> tuple[int, ...]:
        """Doors on the way to the room of the exit, or to the room at whose outer wall it is."""
        rooms = [number for number, room in enumerate(self.rooms) if _overlaps(room, exit_, body_radius + CONTACT_SKIN)]
        if not rooms:  # an alcove
            x, y = exit_.centre
            low_x, high_x = min(r.x_min for r in self.rooms), max(r.x_max for r in self.rooms)
            low_y, high_y = min(r.y_min for r in self.rooms), max(r.y_max for r in self.rooms)
            x, y = min(max(x, low_x), high_x), min(max(y, low_y), high_y)
            rooms = [number for number, room in enumerate(self.rooms) if room.contains(x, y)]
        ways = sorted((self.ways[room] for room in rooms), key=len)
        if not ways or any(not set(ways[0]) <= set(way) for way in ways):
            raise Rejected("the exit must be in one room")
        return ways[0]

    def is_at_start(self, places: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return true for places (n, 2) to which no door leads from the starts."""
        if not self.solids:
            return np.ones(len(places), dtype=bool)
        found = np.zeros(len(places), dtype=bool)
        x, y = places.T
        for room, way in zip(self.rooms, self.ways, strict=True):
            if not way:
                found |= (x >= room.x_min) & (x <= room.x_max) & (y >= room.y_min) & (y <= room.y_max)
        return found


def _overlaps(room: Rectangle, area: Rectangle, margin: float) -> bool:
    """Return whether an area overlaps a room, less a margin at its sides."""
    return (max(room.x_min + margin, area.x_min) <= min(room.x_max - margin, area.x_max)
            and max(room.y_min + margin, area.y_min) <= min(room.y_max - margin, area.y_max))


def sample_doors(config: RoomConfig, puzzle: Puzzle, plan: Floorplan, rng: np.random.Generator) -> DoorPlan:
    """Hang a puzzle's doors into doorways of a floor plan.

    Raises:
        ConfigError: there are fewer doorways than doors, or the puzzle cannot open them all.
        Rejected: the fixed start is in no room.
    """
    count = len(get_trait(puzzle, Doored).door_facts)
    if not count:
        return DoorPlan()
    if config.room.rooms <= count:
        raise ConfigError("room.rooms", config.room.rooms, f"more than {count}, a doorway for each of the puzzle's "
                          "doors")
    order, opened = _draw_order(puzzle, rng)
    first = int(rng.integers(len(plan.rooms)))
    if config.start.place == "fixed":
        first = next((number for number, room in enumerate(plan.rooms)
                      if room.contains(config.start.x, config.start.y)), -1)
        if first < 0:
            raise Rejected("the fixed start must be in a room")
    with_doors = set(rng.choice(len(plan.doorways), count, replace=False).tolist())
    ways: dict[int, tuple[int, ...]] = {first: ()}
    solids: dict[int, Solid] = {}
    for door in (*order, None):
        while True:
            open_ways = [(at, to) for number, way in enumerate(plan.doorways) if number not in with_doors
                         for at, to in itertools.permutations(way.rooms) if at in ways and to not in ways]
            if not open_ways:
                break
            for at, to in open_ways:
                ways[to] = ways[at]
        if door is None:
            break
        shut = [(number, at, to) for number in sorted(with_doors)
                for at, to in itertools.permutations(plan.doorways[number].rooms) if at in ways and to not in ways]
        number, at, to = shut[int(rng.integers(len(shut)))]
        ways[to] = tuple(sorted((*ways[at], door)))
        solids[door] = plan.doorways[number].door
    return DoorPlan(tuple(solids[door] for door in range(count)), plan.rooms,
                    tuple(ways[room] for room in range(len(plan.rooms))), opened)


def _draw_order(puzzle: Puzzle, rng: np.random.Generator) -> tuple[list[int], dict[str, frozenset[int]]]:
    """Draw an order in which operators open the doors; returns it and the doors open when each target is first used.

    Raises:
        ConfigError: operators do not open all doors.
    """
    model, facts = puzzle.symbolic.make_symbolic_model(), puzzle.symbolic.get_facts(puzzle.make_state())
    doors = get_trait(puzzle, Doored).door_facts
    opened: dict[str, frozenset[int]] = {}
    order: list[int] = []
    while True:
        order += [door for door, fact in enumerate(doors) if fact in facts and door not in order]
        able = [op for op in model.operators if op.relax(facts) - facts]
        if not able:
            break
        chosen = able[int(rng.integers(len(able)))]
        opened.setdefault(chosen.target, frozenset(order))
        facts |= chosen.relax(facts)
    if len(order) < len(doors):
        raise ConfigError("puzzle.door_facts", doors, "facts that the puzzle's operators can all bring about")
    return order, opened
