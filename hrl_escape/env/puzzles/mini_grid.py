"""DoorKey, KeyCorridor and MultiRoom of MiniGrid (Chevalier-Boisvert et al. 2023), cell by cell.

Doors are opened and shut by `use` from the cell before them, locked ones with the key in hand; `grip` takes the thing
in the cell ahead, `release` puts it down there. Shut doors and things block their cells. The exit opens once every door
has been opened, or where there is a ball once that is held. The instance seed draws the map, as MiniGrid's generators
do. The state is a word: two bits a door (open now, opened once), then `PLACE_BITS` a thing, its cell or `HELD`.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np

from hrl_escape.env.puzzles.base import USE, Contacts, Puzzle, PuzzleConfig, register_puzzle
from hrl_escape.env.puzzles.grid_levels import draw_door_key, draw_key_corridor, draw_multi_room
from hrl_escape.env.puzzles.maps import GridMap
from hrl_escape.env.puzzles.symbolic import Modelled, Operator, SymbolicModel
from hrl_escape.env.puzzles.traits import Mapped
from hrl_escape.errors import ConfigError
from hrl_escape.settings import Range

__all__ = ["HELD", "PLACE_BITS", "DrawnLevel", "MiniGridConfig", "MiniGridPuzzle"]

PLACE_BITS = 10
"""Bits of a thing's place in a state."""
HELD = (1 << PLACE_BITS) - 1
"""Place of the thing in the hand."""
DrawnLevel = Literal["door-key", "key-corridor", "multi-room"]
"""Names of the families of levels whose maps are drawn."""


@dataclasses.dataclass(frozen=True)
class MiniGridConfig(PuzzleConfig):
    """Schematic of a MiniGrid level; the room must have as many cells as its map."""

    kind = "mini-grid"
    level: Literal[DrawnLevel, "rows"] = "door-key"
    """Family of levels; `rows` takes the map given there."""
    size: Annotated[int, Range(3, 25)] = 8
    """Side of the map with its outer walls (door-key, multi-room), or of each room (key-corridor)."""
    rooms: Annotated[int, Range(1, 6)] = 3
    """Rooms one above another (key-corridor), or one after another (multi-room)."""
    largest: Annotated[int, Range(4, 10)] = 5
    """Largest side of a room with its walls (multi-room)."""
    rows: tuple[str, ...] = ()
    """An explicit map without its outer walls, such as one of MiniGrid's own levels."""

    def check(self) -> None:
        """Check what spans several fields."""
        if bool(self.rows) != (self.level == "rows"):
            raise ConfigError("puzzle.rows", self.rows, "a map exactly where puzzle.level is 'rows'")
        if self.level == "door-key" and self.size < 5:
            raise ConfigError("puzzle.size", self.size, "at least 5 for a door and a key")

    def make_puzzle(self, rng: np.random.Generator) -> MiniGridPuzzle:
        """Draw the level's map from the generator, or take the given `rows`."""
        if self.level == "rows":
            return MiniGridPuzzle(self.rows)
        if self.level == "door-key":
            return MiniGridPuzzle(draw_door_key(self.size, rng))
        if self.level == "key-corridor":
            return MiniGridPuzzle(draw_key_corridor(self.size, self.rooms, rng))
        return MiniGridPuzzle(draw_multi_room(self.size, self.rooms, self.largest, rng))


@dataclasses.dataclass(frozen=True)
class MiniGridPuzzle(Mapped, Modelled, Puzzle):
    """A concrete level. Doors are called `door-1`, ..., things `key-1` and `ball-1`."""

    kind = "mini-grid"
    are_pads = True
    rows: tuple[str, ...] = (">D",)
    """The map without its outer walls; see `maps.py` for its characters."""

    def check(self) -> None:
        """Check that the state fits into a word and that everything can be reached."""
        grid = self.grid
        if len("".join(self.rows)) >= HELD or 2 * len(grid.doors) + PLACE_BITS * len(grid.things) > 62:
            raise ConfigError("puzzle.rows", self.rows, f"fewer than {HELD} cells, and few enough doors and things")
        for cell in (*grid.doors, *grid.things, *([] if grid.goal is None else [grid.goal])):
            grid.list_doors_before(cell)

    @cached_property
    def grid(self) -> GridMap:
        """Cells of the map: doors, things, start and goal."""
        return GridMap(self.rows)

    @property
    def map_rows(self) -> tuple[str, ...]:
        """Rows of the map from the top, without its outer walls."""
        return self.rows

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of the doors, then of the keys, then of the balls."""
        keys = self.grid.keys
        return (*(f"door-{i + 1}" for i in range(len(self.grid.doors))), *(f"key-{i + 1}" for i in range(keys)),
                *(f"ball-{i + 1}" for i in range(len(self.grid.things) - keys)))

    @property
    def target_cells(self) -> tuple[int, ...]:
        """Cells of the doors, and those in which things lie at first."""
        return (*self.grid.doors, *self.grid.things)

    @property
    def blockable_cells(self) -> tuple[int, ...]:
        """Cells of the doors and, on a map with things, all others that are no walls."""
        return self.grid.blockable

    # --- states ------------------------------------------------------------------------

    def _shift(self, thing: int) -> int:
        return 2 * len(self.grid.doors) + PLACE_BITS * thing

    def get_place(self, state: int, thing: int) -> int:
        """Cell of a thing, or `HELD`."""
        return state >> self._shift(thing) & HELD

    def _move(self, state: int, thing: int, place: int) -> int:
        return state & ~(HELD << self._shift(thing)) | place << self._shift(thing)

    def get_held(self, state: int) -> int | None:
        """Number of the held thing; None for an empty hand."""
        return next((thing for thing in range(len(self.grid.things)) if self.get_place(state, thing) == HELD), None)

    def is_open(self, state: int, door: int) -> bool:
        """Return whether a door stands open."""
        return bool(state >> 2 * door & 1)

    def is_unlocked(self, state: int, door: int) -> bool:
        """Return whether a door needs no key any more: it never did, or has been opened once."""
        return bool(state >> 2 * door & 2) or not self.grid.is_locked(door)

    def make_state(self) -> int:
        """State with all doors shut and all things in their first places."""
        return sum(cell << self._shift(thing) for thing, cell in enumerate(self.grid.things))

    def is_state(self, state: Any) -> bool:
        """Return whether an untrusted value gives every thing a cell of its own, and at most one is held."""
        grid = self.grid
        if type(state) is not int or not 0 <= state < 1 << self._shift(len(grid.things)):
            return False
        if any(self.is_open(state, door) and not state >> 2 * door & 2 for door in range(len(grid.doors))):
            return False
        places = [self.get_place(state, thing) for thing in range(len(grid.things))]
        free = {*grid.blockable, HELD} - {*grid.doors, grid.goal}
        return len(set(places)) == len(places) and free.issuperset(places)

    def update(self, state: int, contacts: Contacts) -> int:
        """Take, put down, open or shut what is in the cell ahead."""
        if contacts.ahead < 0 or not contacts.grip:
            return state
        grid, held = self.grid, self.get_held(state)
        cell = grid.blockable[contacts.ahead]
        if cell in grid.doors:
            door = grid.doors.index(cell)
            has_key = held is not None and held < grid.keys
            if contacts.grip != USE or not (self.is_unlocked(state, door) or has_key):
                return state
            return (state | 2 << 2 * door) ^ 1 << 2 * door
        lying = next((thing for thing in range(len(grid.things)) if self.get_place(state, thing) == cell), None)
        if contacts.grip == 1 and held is None and lying is not None:
            return self._move(state, lying, HELD)
        if contacts.grip == -1 and held is not None and lying is None and cell != grid.goal:
            return self._move(state, held, cell)
        return state

    def get_shut(self, state: int) -> int:
        """Bits of the cells that a shut door or a thing blocks."""
        grid = self.grid
        shut = sum(1 << grid.blockable.index(cell) for door, cell in enumerate(grid.doors)
                   if not self.is_open(state, door))
        places = (self.get_place(state, thing) for thing in range(len(grid.things)))
        return shut | sum(1 << grid.blockable.index(place) for place in places if place != HELD)

    def is_solved(self, state: int) -> bool:
        """Return whether a ball is held or, on a map without balls, all doors have been opened."""
        grid = self.grid
        if len(grid.things) > grid.keys:
            return any(self.get_place(state, thing) == HELD for thing in range(grid.keys, len(grid.things)))
        return all(state >> 2 * door & 2 for door in range(len(grid.doors)))

    def observe(self, state: int) -> tuple[float, ...]:
        """Two numbers a door: open, opened once; three a thing: held, row and column as shares of the map."""
        numbers = [float(state >> bit & 1) for bit in range(2 * len(self.grid.doors))]
        for thing in range(len(self.grid.things)):
            place = self.get_place(state, thing)
            row, column = (0, 0) if place == HELD else divmod(place, self.grid.columns)
            numbers += float(place == HELD), row / len(self.rows), column / self.grid.columns
        return tuple(numbers)

    def get_lit(self, state: int) -> tuple[bool, ...]:
        """Lit targets: open doors, and the thing that is held."""
        return (*(self.is_open(state, door) for door in range(len(self.grid.doors))),
                *(self.get_place(state, thing) == HELD for thing in range(len(self.grid.things))))

    # --- for planners ------------------------------------------------------------------

    def get_facts(self, state: int) -> frozenset[str]:
        """`open(door)`, `opened(door)`, `held(thing)` or `lies(thing)` in its first place, and `free(hand)`."""
        doors, facts = len(self.grid.doors), set[str]()
        for number, name in enumerate(self.target_names):
            if number < doors:
                facts |= {f"{word}({name})" for bit, word in enumerate(("open", "opened"))
                          if state >> 2 * number + bit & 1}
            elif (place := self.get_place(state, number - doors)) in (HELD, self.target_cells[number]):
                facts.add(f"{'held' if place == HELD else 'lies'}({name})")
        return frozenset(facts if self.get_held(state) is not None else facts | {"free(hand)"})

    def make_contacts(self, operator: Operator) -> Contacts:
        """Contacts of the primitive that carries out an operator; keys are put down in cells that are free at first."""
        grip = {"grip": 1, "release": -1, "use": USE}[operator.action]
        target = self.target_names.index(operator.target)
        cell = self.grid.floor[target - len(self.grid.doors)] if grip == -1 else self.target_cells[target]
        return Contacts((), grip=grip, ahead=self.grid.blockable.index(cell))

    def make_symbolic_model(self) -> SymbolicModel:
        """Open each door, with a key in hand if it is locked; take things from their first places, put down keys."""
        grid, names = self.grid, self.target_names
        doors, keys = len(grid.doors), [f"held({name})" for name in names if name.startswith("key")]
        free, operators = frozenset({"free(hand)"}), []
        for number, (name, cell) in enumerate(zip(names, self.target_cells, strict=True)):
            way = frozenset(f"open({names[door]})" for door in grid.list_doors_before(cell))
            if number < doors:
                opened = frozenset({f"open({name})", f"opened({name})"})
                locks = frozenset({f"opened({name})"}) if grid.is_locked(number) else frozenset[str]()
                operators.append(Operator(f"open-{name}", name, "use", way | locks, frozenset({f"open({name})"}),
                                          opened))
                operators += [Operator(f"unlock-{name}-by-{key[5:-1]}", name, "use", way | {key}, locks, opened)
                              for key in keys if locks]
            else:
                held, lies = frozenset({f"held({name})"}), frozenset({f"lies({name})"})
                operators.append(Operator(f"take-{name}", name, "grip", way | free | lies, add=held,
                                          delete=free | lies))
                if number - doors < min(grid.keys, len(grid.floor)):
                    operators.append(Operator(f"put-down-{name}", name, "release", held, add=free, delete=held))
        facts = (*(f"{word}({name})" for name in names[:doors] for word in ("open", "opened")),
                 *(f"{word}({name})" for name in names[doors:] for word in ("held", "lies")), "free(hand)")
        balls = frozenset(f"held({name})" for name in names if name.startswith("ball"))
        goal = balls or frozenset(f"opened({name})" for name in names[:doors])
        return SymbolicModel(facts, tuple(operators), goal)

    def list_cells(self, state: int, action: str, target: int) -> tuple[int, ...]:
        """Cell of a door or thing; to put a thing down, the free cells in which it blocks no way."""
        grid, doors = self.grid, len(self.grid.doors)
        places = [self.get_place(state, thing) for thing in range(len(grid.things))]
        if action != "release":
            cell = grid.doors[target] if target < doors else places[target - doors]
            return () if cell == HELD else (grid.blockable.index(cell),)
        taken = {*grid.doors, grid.goal, *places}
        return tuple(number for number, cell in enumerate(grid.blockable)
                     if cell not in taken and not grid.is_bottleneck(cell))

    def plan(self, state: int, place: int = -1) -> tuple[Operator, ...] | None:
        """The fewest operators to the goal, by search, as doors leave little choice of order."""
        return self.make_symbolic_model().find_fewest(self.get_facts(state))


register_puzzle(MiniGridConfig, MiniGridPuzzle)
