"""Sokoban: a move into a box pushes it one cell, unless a wall or another box is behind it. Each box belongs on a goal.

Levels come from files in the format of Boxoban, from an explicit map, or from the instance seed, which draws a level by
playing it backwards. A box pushed onto a goal has reward 1, a box pushed off a goal -1, as in gym-sokoban. Boxes in
corners and along walls are dead ends. The state is a word of `BOX_BITS` per box: its cell on the map.

Levels are written as in Sokoban and Boxoban (Guez et al. 2018): `#` wall, `@` the player, `$` a box, `.` a goal, `*` a
box on a goal, `+` the player on a goal, anything else floor.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence
from functools import cache, cached_property, lru_cache
from typing import Annotated, Any, NamedTuple

import numpy as np

from hrl_escape.env.puzzles.base import PUSH, Contacts, Puzzle, PuzzleConfig, register_puzzle
from hrl_escape.env.puzzles.mixins import Pushing
from hrl_escape.env.puzzles.symbolic import Modelled, Operator, SymbolicModel
from hrl_escape.errors import ConfigError
from hrl_escape.search import find_cheapest_steps
from hrl_escape.settings import Range

BOX_BITS = 8
"""Bits of a box's cell in a state."""
MOST_BOXES = 7
PUSH_SIDES = {"east": (0, 1), "north": (-1, 0), "west": (0, -1), "south": (1, 0)}
"""Steps (row, column) to each side; rows count from the top."""
_MOST_SEARCHED = 300_000
"""Largest number of states in the search for the fewest moves."""
_GAMES, _PULLS = 10, 15
"""Number of games played backwards from each drawn map, and of pulls of a box in each."""
_MOST_DRAWN = 1000
"""Most levels drawn for a room configuration before an error is raised."""


@dataclasses.dataclass(frozen=True)
class SokobanConfig(PuzzleConfig):
    """Configuration of Sokoban. The room must have as many cells as its level without the outer walls."""

    kind = "sokoban"
    size: Annotated[int, Range(3, 14)] = 6
    """Side of generated levels, without the outer walls."""
    boxes: Annotated[int, Range(1, MOST_BOXES)] = 2
    """Number of boxes in generated levels. More boxes make levels harder."""
    rows: tuple[str, ...] = ()
    """An explicit level, such as a level of Boxoban."""

    def make_puzzle(self, rng: np.random.Generator) -> SokobanPuzzle:
        """Sample a level, or use the given one without its outer walls."""
        return SokobanPuzzle(tidy_level(self.rows) if self.rows else draw_level(self.size, self.boxes, rng))


@dataclasses.dataclass(frozen=True)
class SokobanPuzzle(Pushing, Modelled, Puzzle):
    """A concrete level. Boxes are named `box-1`, ..., goals `goal-1`, ..., row by row."""

    kind = "sokoban"
    are_pads = True
    rows: tuple[str, ...] = ("@$.",)
    """The level, without its outer walls if it has some."""

    def check(self) -> None:
        """Check that the state fits into a word."""
        if len(self.level.boxes) > MOST_BOXES or len("".join(self.rows)) > 1 << BOX_BITS:
            raise ConfigError("puzzle.rows", self.rows, f"at most {MOST_BOXES} boxes and {1 << BOX_BITS} cells")

    @cached_property
    def level(self) -> BoxMap:
        """Cells of the level and their neighbours."""
        return BoxMap(self.rows)

    @property
    def map_rows(self) -> tuple[str, ...]:
        """Rows of the map: walls, floor, and the start with heading +x."""
        cells = ["#" if c == "#" else ">" if c in "@+" else " " for c in "".join(self.rows)]
        wide = self.level.columns
        return tuple("".join(cells[begin: begin + wide]) for begin in range(0, len(cells), wide))

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of the boxes, `box-1` and so on, then of the goals, `goal-1` and so on."""
        return tuple(f"{what}-{number + 1}" for what in ("box", "goal") for number in range(len(self.level.boxes)))

    @property
    def goal_targets(self) -> tuple[int, ...]:
        """Indices of the goals: each must have a box on it."""
        return tuple(range(len(self.level.boxes), 2 * len(self.level.boxes)))

    @property
    def target_cells(self) -> tuple[int, ...]:
        """Initial cells of the boxes, then the cells of the goals."""
        return (*self.level.boxes, *self.level.goals)

    @property
    def blockable_cells(self) -> tuple[int, ...]:
        """Cells that are not walls."""
        return self.level.floor

    @property
    def has_dead_ends(self) -> bool:
        """True: a box in a corner can never leave it."""
        return True

    # --- states ------------------------------------------------------------------------

    def encode(self, cells: tuple[int, ...]) -> int:
        """Return the state with the boxes in given cells."""
        return sum(cell << BOX_BITS * box for box, cell in enumerate(cells))

    def decode(self, state: int) -> tuple[int, ...]:
        """Return the cell of each box."""
        return tuple(state >> BOX_BITS * box & (1 << BOX_BITS) - 1 for box in range(len(self.level.boxes)))

    def make_state(self) -> int:
        """Return the state with the boxes in their initial cells."""
        return self.encode(self.level.boxes)

    def is_state(self, state: Any) -> bool:
        """Return whether an untrusted value is a state: each box in a floor cell of its own."""
        if type(state) is not int or not 0 <= state < 1 << BOX_BITS * len(self.level.boxes):
            return False
        cells = self.decode(state)
        return len(set(cells)) == len(cells) and set(cells) <= set(self.level.floor)

    def update(self, state: int, contacts: Contacts) -> int:
        """Push the box ahead into the cell beyond it, if that cell is free."""
        if contacts.grip != PUSH or contacts.ahead < 0 or contacts.beyond < 0:
            return state
        cells, floor = self.decode(state), self.level.floor
        box, to = floor[contacts.ahead], floor[contacts.beyond]
        if box not in cells or to in cells:
            return state
        return self.encode(tuple(to if cell == box else cell for cell in cells))

    def compute_reward(self, before: int, after: int, contacts: Contacts) -> float:
        """Return 1 for each box pushed onto a goal, -1 for each pushed off."""
        return 0.0 if after == before else float(self._count_filled(after) - self._count_filled(before))

    def _count_filled(self, state: int) -> int:
        return len({*self.decode(state)}.intersection(self.level.goals))

    def get_shut(self, state: int) -> int:
        """Return the bits of the cells with boxes."""
        return sum(1 << self.level.floor.index(cell) for cell in self.decode(state))

    def is_solved(self, state: int) -> bool:
        """Return whether every goal has a box on it."""
        return self._count_filled(state) == len(self.level.goals)

    def observe(self, state: int) -> tuple[float, ...]:
        """Return row and column of each box as fractions of the map, then one number per goal, 1 with a box on it."""
        cells = self.decode(state)
        places = [divmod(cell, self.level.columns) for cell in cells]
        shares = [share for row, column in places for share in (row / len(self.rows), column / self.level.columns)]
        return (*shares, *(float(goal in cells) for goal in self.level.goals))

    def describe(self, state: int) -> tuple[str, ...]:
        """Return no sentence: apart from the lights, `observe` shows only positions."""
        return ()

    def get_lit(self, state: int) -> tuple[bool, ...]:
        """Return whether each target is lit: boxes on goals, and goals with a box on them."""
        cells, goals = self.decode(state), self.level.goals
        return (*(cell in goals for cell in cells), *(goal in cells for goal in goals))

    # --- for planners ------------------------------------------------------------------

    def _write_place(self, box: int, cell: int) -> str:
        row, column = divmod(cell, self.level.columns)
        return f"at({self.target_names[box]},cell-{row + 1}-{column + 1})"

    def _write_filled(self, cell: int) -> frozenset[str]:
        goals = self.level.goals
        return frozenset({f"filled(goal-{goals.index(cell) + 1})"}) if cell in goals else frozenset()

    def get_facts(self, state: int) -> frozenset[str]:
        """Return `at(box,cell)` for every box, and `filled(goal)` for every goal with a box on it."""
        cells = self.decode(state)
        places = {self._write_place(box, cell) for box, cell in enumerate(cells)}
        return frozenset(places).union(*map(self._write_filled, cells))

    def make_contacts(self, operator: Operator) -> Contacts:
        """Return the contacts of the move that executes an operator."""
        cell, to = self._model[1][operator.name]
        return Contacts((), grip=PUSH, ahead=self.level.floor.index(cell), beyond=self.level.floor.index(to))

    def make_symbolic_model(self) -> SymbolicModel:
        """Return the model: one operator per box, cell and side. The room plans the walk to the box."""
        return self._model[0]

    @cached_property
    def _model(self) -> tuple[SymbolicModel, dict[str, tuple[int, int]]]:
        """The model, and the first and last cell of the box that each operator pushes."""
        level, boxes = self.level, range(len(self.level.boxes))
        operators, ends = list[Operator](), dict[str, tuple[int, int]]()
        for box, (number, side), cell in itertools.product(boxes, enumerate(PUSH_SIDES), level.floor):
            to, behind = level.find_beside(cell, number), level.find_beside(cell, number ^ 2)
            if to < 0 or behind < 0:
                continue
            here, there = frozenset({self._write_place(box, cell)}), frozenset({self._write_place(box, to)})
            taken = frozenset(self._write_place(other, to) for other in boxes if other != box)
            gone = here | self._write_filled(cell)
            name = f"push-{self.target_names[box]}-{side}-{len(ends) + 1}"
            operators.append(Operator(name, self.target_names[box], f"push-{side}", here, taken,
                                      there | self._write_filled(to), gone))
            ends[name] = cell, to
        places = (self._write_place(box, cell) for box in boxes for cell in level.floor)
        filled = tuple(fact for goal in level.goals for fact in self._write_filled(goal))
        return SymbolicModel((*places, *filled), tuple(operators), frozenset(filled)), ends

    def list_cells(self, state: int, action: str, target: int) -> tuple[int, ...]:
        """Return the index of the current cell of an operator's box, as a tuple of one."""
        return (self.level.floor.index(self.decode(state)[target]),)

    def plan(self, state: int, place: int = -1) -> tuple[Operator, ...] | None:
        """Return the pushes of a solution with the fewest moves from the robot's cell."""
        player = self.level.start if place < 0 else self.level.floor[place]
        found = list[Operator]()
        for shove in find_fewest_shoves(self.rows, player, frozenset(self.decode(state))) or ():
            box = self.decode(state).index(shove.cell)
            found.append(next(op for op in self.make_symbolic_model().operators
                              if (op.target, op.action) == (self.target_names[box], f"push-{shove.side}")
                              and self._model[1][op.name][0] == shove.cell))
            state = self.update(state, self.make_contacts(found[-1]))
        return tuple(found) if self.is_solved(state) else None


register_puzzle(SokobanConfig, SokobanPuzzle)


# --- levels --------------------------------------------------------------------------------


class Shove(NamedTuple):
    """A push: the cell that the box leaves, and the side it moves to."""

    cell: int
    side: str


class BoxMap:
    """Cells of a level and their neighbours, without its boxes.

    Attributes:
        columns: number of cells in a row.
        floor: cells that are not walls.
        boxes: initial cells of the boxes.
        goals: cells of the goals.
        start: initial cell of the player.

    Raises:
        ConfigError: rows differ in length, there is not exactly one player, or boxes and goals differ in number.
    """

    def __init__(self, rows: Sequence[str]) -> None:
        text = "".join(rows)
        self.rows, self.columns = tuple(rows), len(rows[0]) if rows else 0
        self.floor, self.boxes, self.goals, players = (
            tuple(cell for cell, character in enumerate(text) if is_one(character))
            for is_one in (lambda c: c != "#", "$*".__contains__, ".*+".__contains__, "@+".__contains__))
        if len({len(row) for row in rows}) != 1 or len(players) != 1:
            raise ConfigError("puzzle.rows", self.rows, "rows of equal length with exactly one player (@ or +)")
        if not self.goals or len(self.boxes) != len(self.goals):
            raise ConfigError("puzzle.rows", self.rows, "as many boxes ($ or *) as goals (. or *), at least one")
        self.start = players[0]
        self._next = {cell: tuple(self._find_beside(text, cell, *step) for step in PUSH_SIDES.values())
                      for cell in self.floor}
        self._beside = {cell: tuple(near for near in beside if near >= 0) for cell, beside in self._next.items()}

    def _find_beside(self, text: str, cell: int, down: int, right: int) -> int:
        row, column = cell // self.columns + down, cell % self.columns + right
        beside = row * self.columns + column
        inside = 0 <= row < len(self.rows) and 0 <= column < self.columns
        return beside if inside and text[beside] != "#" else -1

    def find_beside(self, cell: int, side: int) -> int:
        """Return the neighbour of a cell on a side; -1 for a wall."""
        return self._next[cell][side]

    def measure_walks(self, begin: int, boxes: frozenset[int]) -> dict[int, int]:
        """Return the number of moves of the player to each cell that is reachable without a push."""
        moves, queue = {begin: 0}, [begin]
        for here in queue:
            count = moves[here] + 1
            for cell in self._beside[here]:
                if cell not in moves and cell not in boxes:
                    moves[cell] = count
                    queue.append(cell)
        return moves

    def list_shoves(self, player: int, boxes: frozenset[int]) -> Iterator[tuple[Shove, int, frozenset[int]]]:
        """Yield the possible pushes, as (push, moves with it, boxes after it)."""
        walks = self.measure_walks(player, boxes)
        for box in boxes:
            for side, name in enumerate(PUSH_SIDES):
                behind, to = self._next[box][side ^ 2], self._next[box][side]
                if to >= 0 and to not in boxes and behind in walks:
                    yield Shove(box, name), walks[behind] + 1, boxes - {box} | {to}

    def measure_pushes(self) -> list[dict[int, int]]:
        """Return, for each goal, the pushes that bring a single box there from each cell; dead cells are missing."""
        tables = []
        for goal in self.goals:
            pushes, queue = {goal: 0}, [goal]
            for here in queue:
                for side in range(4):
                    box = self._next[here][side ^ 2]
                    if box >= 0 and box not in pushes and self._next[box][side ^ 2] >= 0:
                        pushes[box] = pushes[here] + 1
                        queue.append(box)
            tables.append(pushes)
        return tables


@lru_cache(maxsize=256)
def _get_map(rows: tuple[str, ...]) -> tuple[BoxMap, list[dict[int, int]]]:
    level = BoxMap(rows)
    return level, level.measure_pushes()


@lru_cache(maxsize=256)
def find_fewest_shoves(rows: tuple[str, ...], player: int, boxes: frozenset[int]) -> tuple[Shove, ...] | None:
    """Return the pushes of a solution with the fewest moves, walks included, or None if there is none.

    `player` and `boxes` give the current cells. A* uses the fewest pushes of single boxes, each to its own goal, as
    lower bound. Boxes never enter dead cells, which have no way to a goal. After 10,000 states the search continues
    greedily, and fewer moves may exist; after 300,000 it stops and returns None.
    """
    level, pushes = _get_map(rows)
    goals = frozenset(level.goals)

    @cache
    def count_least(boxes: frozenset[int]) -> float:
        return _match([[table.get(box, math.inf) for table in pushes] for box in boxes])

    def list_steps(state: tuple[frozenset[int], int]) -> Iterator[tuple[Shove, int, tuple[frozenset[int], int]]]:
        for shove, moves, moved in level.list_shoves(state[1], state[0]):
            yield shove, moves, (moved, shove.cell)

    return find_cheapest_steps((boxes, player), lambda state: state[0] == goals, list_steps,
                               lambda state: count_least(state[0]), _MOST_SEARCHED)


def _match(prices: list[list[float]]) -> float:
    """Smallest sum of prices that assigns each row its own column; infinity if there is none."""
    from scipy.optimize import linear_sum_assignment  # imported here because only puzzles with boxes need it

    try:
        rows, columns = linear_sum_assignment(prices)
    except ValueError:  # no assignment is finite
        return math.inf
    return float(sum(prices[row][column] for row, column in zip(rows.tolist(), columns.tolist(), strict=True)))


# --- levels --------------------------------------------------------------------------------


def read_boxoban(text: str) -> tuple[tuple[str, ...], ...]:
    """Read a file of levels in the format of Boxoban: rows, after a line with `;` and the number of the level.

    Raises:
        ConfigError: the file contains no level.
    """
    levels, rows = list[tuple[str, ...]](), list[str]()
    for line in (*text.splitlines(), ";"):
        if line.strip() and not line.startswith(";"):
            rows.append(line.rstrip())
        elif rows:
            levels.append(tuple(rows))
            rows = []
    if not levels:
        raise ConfigError("levels", text, "rows of # and other characters, as in Boxoban's files")
    return tuple(levels)


def tidy_level(rows: Sequence[str]) -> tuple[str, ...]:
    """Return rows of equal length without outer walls, which the room has itself; unreachable cells become walls."""
    wide = max(map(len, rows), default=0)
    square = tuple(row.ljust(wide) for row in rows)
    level = BoxMap(square)
    inside = level.measure_walks(level.start, frozenset())
    kept = ["".join(c if row * wide + column in inside else "#" for column, c in enumerate(text))
            for row, text in enumerate(square)]
    if not {*level.boxes, *level.goals} <= inside.keys():
        raise ConfigError("puzzle.rows", tuple(rows), "boxes and goals that the player can reach")
    rows_used = [number for number, row in enumerate(kept) if row.strip("#")]
    columns_used = [number for number in range(wide) if any(row[number] != "#" for row in kept)]
    return tuple(row[columns_used[0]: columns_used[-1] + 1] for row in kept[rows_used[0]: rows_used[-1] + 1])


def draw_level(side: int, boxes: int, rng: np.random.Generator) -> tuple[str, ...]:
    """Sample a level by playing backwards: boxes begin on goals and are pulled away as far as possible.

    `side` is the number of cells along each side, without outer walls.

    Raises:
        ConfigError: there are too few cells for the boxes.
    """
    for _ in range(_MOST_DRAWN):
        cells = np.where(rng.random((side, side)) < 0.2, "#", " ")
        rows, floor = ["".join(row) for row in cells.tolist()], np.flatnonzero(cells.ravel() == " ")
        chosen = rng.permutation(floor)[: boxes + 1].tolist()
        if len(chosen) <= boxes:
            continue
        level = BoxMap(_write(rows, chosen[-1], frozenset(chosen[:-1]), frozenset(chosen[:-1])))
        if len(level.measure_walks(level.start, frozenset())) < len(floor):
            continue
        player, placed = _pull_away(level, rng)
        if not placed & frozenset(level.goals):
            return _write(rows, player, placed, frozenset(level.goals))
    raise ConfigError("puzzle.boxes", boxes, f"fewer boxes for {side} x {side} cells")


def _pull_away(level: BoxMap, rng: np.random.Generator) -> tuple[int, frozenset[int]]:
    """Player and boxes after the random pulls with the largest distances from the goals."""
    pushes, (best, farthest) = level.measure_pushes(), ((level.start, frozenset(level.boxes)), 0.0)
    for _ in range(_GAMES):
        player, boxes = level.start, frozenset(level.boxes)
        for _ in range(_PULLS * len(boxes)):
            walks, pulls = level.measure_walks(player, boxes), list[tuple[int, int, int]]()
            for box, side in itertools.product(sorted(boxes), range(4)):
                to = level.find_beside(box, side)
                beyond = level.find_beside(to, side) if to >= 0 else -1
                if to in walks and beyond in walks:
                    pulls.append((box, to, beyond))
            if not pulls:
                break
            box, to, player = pulls[int(rng.integers(len(pulls)))]
            boxes = boxes - {box} | {to}
            away = _match([[table.get(each, math.inf) for table in pushes] for each in boxes])
            if away > farthest and not boxes & frozenset(level.goals):
                best, farthest = (player, boxes), away
    return best


def _write(rows: Sequence[str], player: int, boxes: frozenset[int], goals: frozenset[int]) -> tuple[str, ...]:
    """Rows of a level, from rows of walls and the cells of boxes, goals and player."""
    columns, marks = len(rows[0]), {(False, False): " ", (True, False): "$", (False, True): ".", (True, True): "*"}
    text = [c if c == "#" else marks[cell in boxes, cell in goals] for cell, c in enumerate("".join(rows))]
    text[player] = "+" if player in goals else "@"
    return tuple("".join(text[begin: begin + columns]) for begin in range(0, len(text), columns))
