"""DoorKey, KeyCorridor and MultiRoom of MiniGrid (Chevalier-Boisvert et al. 2023), cell by cell.

`use` opens and shuts the door in the cell ahead; a locked door requires the key in hand. `grip` takes the thing in the
cell ahead, `release` puts it down there. Shut doors and things block their cells. The exit opens once every door has
been opened or, on maps with a ball, once a ball is held. The instance seed draws the map, as MiniGrid's generators do.
The state is a word: two bits per door (open now, opened once), then `PLACE_BITS` per thing, its cell or `HELD`.

The generators use other random numbers than MiniGrid's. They leave out the outer walls, which belong to the room.
"""

from __future__ import annotations

import dataclasses
import itertools
from functools import cached_property, lru_cache
from typing import Annotated, Any, Literal

import numpy as np

from hrl_escape.env.puzzles.base import USE, Contacts, Puzzle, PuzzleConfig, register_puzzle
from hrl_escape.env.puzzles.maps import HEADINGS, GridMap
from hrl_escape.env.puzzles.mixins import Mapped
from hrl_escape.env.puzzles.symbolic import Modelled, Operator, SymbolicModel
from hrl_escape.errors import ConfigError
from hrl_escape.names import join_words
from hrl_escape.settings import Range

PLACE_BITS = 10
"""Bits of a thing's place in a state."""
HELD = (1 << PLACE_BITS) - 1
"""Place of the thing in the hand."""
DrawnLevel = Literal["door-key", "key-corridor", "multi-room"]
"""Families of levels with generated maps."""


@dataclasses.dataclass(frozen=True)
class MiniGridConfig(PuzzleConfig):
    """Configuration of a MiniGrid level. The room must have as many cells as its map."""

    kind = "mini-grid"
    level: Literal[DrawnLevel, "rows"] = "door-key"
    """Family of levels; `rows` uses the map given there."""
    size: Annotated[int, Range(3, 25)] = 8
    """Side of the map with its outer walls (door-key, multi-room), or of each room (key-corridor)."""
    rooms: Annotated[int, Range(1, 6)] = 3
    """Number of rooms above each other (key-corridor), or in a row (multi-room)."""
    largest: Annotated[int, Range(4, 10)] = 5
    """Largest side of a room with its walls (multi-room)."""
    rows: tuple[str, ...] = ()
    """An explicit map without its outer walls, such as a level of MiniGrid."""

    def check(self) -> None:
        """Check the limits that relate several fields."""
        if bool(self.rows) != (self.level == "rows"):
            raise ConfigError("puzzle.rows", self.rows, "a map if puzzle.level is 'rows', and empty otherwise")
        if self.level == "door-key" and self.size < 5:
            raise ConfigError("puzzle.size", self.size, "at least 5 for a door and a key")

    def make_puzzle(self, rng: np.random.Generator) -> MiniGridPuzzle:
        """Sample the map of the level, or use the given `rows`."""
        if self.level == "rows":
            return MiniGridPuzzle(self.rows)
        if self.level == "door-key":
            return MiniGridPuzzle(draw_door_key(self.size, rng))
        if self.level == "key-corridor":
            return MiniGridPuzzle(draw_key_corridor(self.size, self.rooms, rng))
        return MiniGridPuzzle(draw_multi_room(self.size, self.rooms, self.largest, rng))


@dataclasses.dataclass(frozen=True)
class MiniGridPuzzle(Mapped, Modelled, Puzzle):
    """A concrete level. Doors are named `door-1`, ..., things `key-1` and `ball-1`."""

    kind = "mini-grid"
    are_pads = True
    rows: tuple[str, ...] = (">D",)
    """The map without its outer walls; `maps.py` lists its characters."""

    def check(self) -> None:
        """Check that the state fits into a word and that everything is reachable."""
        grid = self.grid
        if len("".join(self.rows)) >= HELD or 2 * len(grid.doors) + PLACE_BITS * len(grid.things) > 62:
            raise ConfigError("puzzle.rows", self.rows, f"fewer than {HELD} cells, and fewer doors and things")
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
        """Cells of the doors, then the initial cells of the things."""
        return (*self.grid.doors, *self.grid.things)

    @property
    def blockable_cells(self) -> tuple[int, ...]:
        """Cells of the doors; on a map with things, all cells that are not walls."""
        return self.grid.blockable

    # --- states ------------------------------------------------------------------------

    def _shift(self, thing: int) -> int:
        return 2 * len(self.grid.doors) + PLACE_BITS * thing

    def get_place(self, state: int, thing: int) -> int:
        """Return the cell of a thing, or `HELD`."""
        return state >> self._shift(thing) & HELD

    def _move(self, state: int, thing: int, place: int) -> int:
        return state & ~(HELD << self._shift(thing)) | place << self._shift(thing)

    def _list_places(self, state: int) -> list[int]:
        first, things = 2 * len(self.grid.doors), len(self.grid.things)
        return [state >> first + PLACE_BITS * thing & HELD for thing in range(things)]

    def get_held(self, state: int) -> int | None:
        """Return the number of the held thing, or None for an empty hand."""
        places = self._list_places(state)
        return places.index(HELD) if HELD in places else None

    def is_open(self, state: int, door: int) -> bool:
        """Return whether a door is open."""
        return bool(state >> 2 * door & 1)

    def make_state(self) -> int:
        """Return the state with all doors shut and all things in their initial cells."""
        return sum(cell << self._shift(thing) for thing, cell in enumerate(self.grid.things))

    def is_state(self, state: Any) -> bool:
        """Return whether an untrusted value is a state: every thing in a cell of its own, and at most one held."""
        grid = self.grid
        if type(state) is not int or not 0 <= state < 1 << self._shift(len(grid.things)):
            return False
        if any(self.is_open(state, door) and not state >> 2 * door & 2 for door in range(len(grid.doors))):
            return False
        places = self._list_places(state)
        free = {*grid.blockable, HELD} - {*grid.doors, grid.goal}
        return len(set(places)) == len(places) and free.issuperset(places)

    def update(self, state: int, contacts: Contacts) -> int:
        """Take, put down, open or shut the thing or door in the cell ahead."""
        if contacts.ahead < 0 or not contacts.grip:
            return state
        grid, places = self.grid, self._list_places(state)
        held, cell = places.index(HELD) if HELD in places else None, grid.blockable[contacts.ahead]
        if cell in grid.doors:
            door = grid.doors.index(cell)
            has_key = held is not None and held < grid.keys
            was_opened = state >> 2 * door & 2
            if contacts.grip != USE or not (has_key or was_opened or not grid.is_locked(door)):
                return state
            return (state | 2 << 2 * door) ^ 1 << 2 * door
        if contacts.grip == 1 and held is None and cell in places:
            return self._move(state, places.index(cell), HELD)
        if contacts.grip == -1 and held is not None and cell not in places and cell != grid.goal:
            return self._move(state, held, cell)
        return state

    def get_shut(self, state: int) -> int:
        """Return the bits of the cells that a shut door or a thing blocks."""
        grid = self.grid
        shut = sum(1 << grid.blockable.index(cell) for door, cell in enumerate(grid.doors)
                   if not self.is_open(state, door))
        return shut | sum(1 << grid.blockable.index(place) for place in self._list_places(state) if place != HELD)

    def is_solved(self, state: int) -> bool:
        """Return whether a ball is held or, on a map without balls, all doors have been opened."""
        grid = self.grid
        if len(grid.things) > grid.keys:
            return HELD in self._list_places(state)[grid.keys :]
        return all(state >> 2 * door & 2 for door in range(len(grid.doors)))

    def observe(self, state: int) -> tuple[float, ...]:
        """Return two numbers per door (open, opened once) and three per thing (held, row and column as fractions)."""
        numbers = [float(state >> bit & 1) for bit in range(2 * len(self.grid.doors))]
        for place in self._list_places(state):
            row, column = (0, 0) if place == HELD else divmod(place, self.grid.columns)
            numbers += float(place == HELD), row / len(self.rows), column / self.grid.columns
        return tuple(numbers)

    def describe(self, state: int) -> tuple[str, ...]:
        """Return a sentence with the doors opened so far, including those shut again."""
        opened = [name for door, name in enumerate(self.target_names[: len(self.grid.doors)]) if state >> 2 * door & 2]
        return (f"Doors opened so far: {join_words(opened) or 'none'}.",)

    def get_lit(self, state: int) -> tuple[bool, ...]:
        """Return whether each target is lit: open doors, and the held thing."""
        return (*(self.is_open(state, door) for door in range(len(self.grid.doors))),
                *(place == HELD for place in self._list_places(state)))

    # --- for planners ------------------------------------------------------------------

    def get_facts(self, state: int) -> frozenset[str]:
        """Return `open(door)`, `opened(door)`, `held(thing)` or `lies(thing)` (in any cell), and `free(hand)`."""
        doors, facts = len(self.grid.doors), set[str]()
        for number, name in enumerate(self.target_names):
            if number < doors:
                facts |= {f"{word}({name})" for bit, word in enumerate(("open", "opened"))
                          if state >> 2 * number + bit & 1}
            else:
                facts.add(f"{'held' if self.get_place(state, number - doors) == HELD else 'lies'}({name})")
        return frozenset(facts if self.get_held(state) is not None else facts | {"free(hand)"})

    def make_contacts(self, operator: Operator) -> Contacts:
        """Return the contacts of the primitive of an operator, with things in their initial cells or held."""
        grip = {"grip": 1, "release": -1, "use": USE}[operator.action]
        cell = self.target_cells[self.target_names.index(operator.target)]
        return Contacts((), grip=grip, ahead=self.grid.blockable.index(cell))

    def make_symbolic_model(self) -> SymbolicModel:
        """Return the model: open doors (locked ones with a key in hand), take things, put down keys.

        A thing can be taken once the doors before its initial cell are open, even if it was put down elsewhere since.
        """
        return self._make_model(self.target_cells)

    def _make_model(self, cells: tuple[int, ...]) -> SymbolicModel:
        """Model with targets in these cells. The ways to them decide which doors must be open."""
        grid, names = self.grid, self.target_names
        doors, keys = len(grid.doors), [f"held({name})" for name in names if name.startswith("key")]
        free, operators = frozenset({"free(hand)"}), []
        for number, (name, cell) in enumerate(zip(names, cells, strict=True)):
            if not grid.can_reach(cell):
                continue
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
                if number - doors < grid.keys:
                    operators.append(Operator(f"put-down-{name}", name, "release", held, add=free | lies,
                                              delete=held))
        facts = (*(f"{word}({name})" for name in names[:doors] for word in ("open", "opened")),
                 *(f"{word}({name})" for name in names[doors:] for word in ("held", "lies")), "free(hand)")
        balls = frozenset(f"held({name})" for name in names if name.startswith("ball"))
        goal = balls or frozenset(f"opened({name})" for name in names[:doors])
        return SymbolicModel(facts, tuple(operators), goal)

    def list_cells(self, state: int, action: str, target: int) -> tuple[int, ...]:
        """Return the cell of a door or thing; to put a thing down, the free cells where it blocks no way."""
        grid, doors = self.grid, len(self.grid.doors)
        places = self._list_places(state)
        if action != "release":
            cell = grid.doors[target] if target < doors else places[target - doors]
            return () if cell == HELD else (grid.blockable.index(cell),)
        taken = {*grid.doors, grid.goal, *places}
        return tuple(number for number, cell in enumerate(grid.blockable)
                     if cell not in taken and cell not in grid.bottlenecks)

    def find_model(self, state: int) -> SymbolicModel | None:
        """Return the model with things in their current cells."""
        places = zip(self._list_places(state), self.grid.things, strict=True)
        things = tuple(first if place == HELD else place for place, first in places)
        return None if things == self.grid.things else _make_moved_model(self, things)

    def plan(self, state: int, place: int = -1) -> tuple[Operator, ...] | None:
        """Return the fewest operators to the goal from the current cells of things, by search."""
        return (self.find_model(state) or self.make_symbolic_model()).find_fewest(self.get_facts(state))


@lru_cache(maxsize=256)
def _make_moved_model(puzzle: MiniGridPuzzle, things: tuple[int, ...]) -> SymbolicModel:
    """Model with things in these cells, cached because options request it at each step."""
    return puzzle._make_model((*puzzle.grid.doors, *things))


register_puzzle(MiniGridConfig, MiniGridPuzzle)


# --- levels ---------------------------------------------------------------------------------

_SIDES = ((1, 0), (0, 1), (-1, 0), (0, -1))
"""Steps (column, row) out of a room, in MiniGrid's order of doors: right, down, left, up."""


class _Canvas:
    """A map under construction with its outer walls; places are (column, row)."""

    def __init__(self, columns: int, rows: int, rng: np.random.Generator) -> None:
        self.cells, self.rng = np.full((rows, columns), "#"), rng

    def clear(self, left: int, top: int, right: int, bottom: int) -> None:
        """Turn the cells from one corner up to, but not including, another into floor."""
        self.cells[top:bottom, left:right] = " "

    def put(self, what: str, at: tuple[int, int]) -> None:
        self.cells[at[1], at[0]] = what

    def draw(self, low: int, high: int) -> int:
        """A random integer from `low` up to, but not including, `high`."""
        return int(self.rng.integers(low, high))

    def scatter(self, what: str, left: int, top: int, right: int, bottom: int) -> tuple[int, int]:
        """Put a character into a random free cell of a rectangle."""
        rows, columns = np.nonzero(self.cells[top:bottom, left:right] == " ")
        number = self.draw(0, len(rows))
        at = left + int(columns[number]), top + int(rows[number])
        self.put(what, at)
        return at

    def draw_start(self) -> str:
        return HEADINGS[self.draw(0, 4)]

    def finish(self) -> tuple[str, ...]:
        """Rows without the outer walls."""
        return tuple("".join(row) for row in self.cells[1:-1, 1:-1].tolist())


def draw_door_key(size: int, rng: np.random.Generator) -> tuple[str, ...]:
    """Draw a wall with a locked door: start and key on its left, the goal in the lower right corner."""
    canvas = _Canvas(size, size, rng)
    canvas.clear(1, 1, size - 1, size - 1)
    canvas.put("G", (size - 2, size - 2))
    split = canvas.draw(2, size - 2)
    canvas.cells[:, split] = "#"
    canvas.scatter(canvas.draw_start(), 0, 0, split, size)
    canvas.put("D", (split, canvas.draw(1, size - 2)))
    canvas.scatter("k", 0, 0, split, size)
    return canvas.finish()


def draw_key_corridor(size: int, rows: int, rng: np.random.Generator) -> tuple[str, ...]:
    """Draw three columns of rooms: a corridor, a key on its left, and a ball behind a locked door on its right."""
    step = size - 1
    canvas = _Canvas(3 * step + 1, rows * step + 1, rng)
    boxes = {(i, j): (i * step + 1, j * step + 1, (i + 1) * step, (j + 1) * step)
             for i in range(3) for j in range(rows)}
    for box in boxes.values():
        canvas.clear(*box)
    canvas.clear(step + 1, 1, 2 * step, rows * step)  # the corridor
    links = {frozenset(((1, j), (1, j + 1))) for j in range(rows - 1)}

    def add_door(kind: str, room: tuple[int, int], other: tuple[int, int]) -> None:
        left, top, _, _ = boxes[max(room, other)]
        across, along = canvas.draw(0, step - 1), canvas.draw(0, step - 1)
        canvas.put(kind, (left - 1, top + along) if room[1] == other[1] else (left + across, top - 1))
        links.add(frozenset((room, other)))

    locked = (2, canvas.draw(0, rows))
    add_door("D", locked, (1, locked[1]))
    things = {"b": locked, "k": (0, canvas.draw(0, rows))}
    for what, room in things.items():
        canvas.scatter(what, *boxes[room])
    while True:  # not directly in front of a thing, as in MiniGrid
        heading = canvas.draw_start()
        at = canvas.scatter(heading, *boxes[1, rows // 2])
        quarter = HEADINGS.index(heading)
        ahead = at[0] + (1, 0, -1, 0)[quarter], at[1] + (0, -1, 0, 1)[quarter]
        if canvas.cells[ahead[1], ahead[0]] in " #":
            break
        canvas.put(" ", at)
    while len(_find_connected((1, 0), links)) < len(boxes):
        room = canvas.draw(0, 3), canvas.draw(0, rows)
        across, down = _SIDES[canvas.draw(0, 4)]
        other = room[0] + across, room[1] + down
        if other in boxes and locked not in (room, other) and frozenset((room, other)) not in links:
            add_door("d", room, other)
    return canvas.finish()


def _find_connected(room: tuple[int, int], links: set[frozenset[tuple[int, int]]]) -> set[tuple[int, int]]:
    found = {room}
    while more := set(itertools.chain(*(link for link in links if link & found))) - found:
        found |= more
    return found


def draw_multi_room(size: int, rooms: int, largest: int, rng: np.random.Generator) -> tuple[str, ...]:
    """Draw a row of rooms of random sizes with a door between neighbours, the start in the first, the goal in the last.

    A layout that gets stuck with too few rooms is drawn again.
    """
    boxes: list[tuple[int, int, int, int]] = []
    doors: list[tuple[int, int]] = []
    canvas = _Canvas(size, size, rng)
    while len(boxes) < rooms:
        boxes, doors = [], []
        _place_rooms(canvas, rooms, largest, 2, (canvas.draw(0, size - 2), canvas.draw(0, size - 2)), boxes, doors)
    for left, top, right, bottom in boxes:
        canvas.clear(left + 1, top + 1, right - 1, bottom - 1)
    for door in doors[1:]:
        canvas.put("d", door)
    canvas.scatter(canvas.draw_start(), *boxes[0])
    canvas.scatter("G", *boxes[-1])
    return canvas.finish()


def _place_rooms(canvas: _Canvas, left_over: int, largest: int, wall: int, door: tuple[int, int],
                 boxes: list[tuple[int, int, int, int]], doors: list[tuple[int, int]]) -> bool:
    """Place a room with a given entry door in one of its walls (right, down, left, up), then the rooms behind it.

    Boxes are (left, top, right, bottom) with walls; right and bottom are exclusive.
    """
    wide, high = canvas.draw(4, largest + 1), canvas.draw(4, largest + 1)
    x, y = door
    if not boxes:
        left, top = x, y
    elif wall in (0, 2):
        left, top = (x - wide + 1 if wall == 0 else x), canvas.draw(y - high + 2, y)
    else:
        left, top = canvas.draw(x - wide + 2, x), (y - high + 1 if wall == 1 else y)
    box = left, top, left + wide, top + high
    rows, columns = canvas.cells.shape
    if left < 0 or top < 0 or box[2] > columns or box[3] > rows:
        return False
    if any(not (box[2] <= other[0] or other[2] <= left or box[3] <= other[1] or other[3] <= top)
           for other in boxes[:-1]):
        return False
    boxes.append(box)
    doors.append(door)
    if left_over == 1:
        return True
    for _ in range(8):
        out = [side for side in range(4) if side != wall][canvas.draw(0, 3)]
        exit_ = {0: (box[2] - 1, top + canvas.draw(1, high - 1)), 1: (left + canvas.draw(1, wide - 1), box[3] - 1),
                 2: (left, top + canvas.draw(1, high - 1)), 3: (left + canvas.draw(1, wide - 1), top)}[out]
        if _place_rooms(canvas, left_over - 1, largest, (out + 2) % 4, exit_, boxes, doors):
            break
    return True
