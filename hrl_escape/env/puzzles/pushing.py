"""Boxes pushed over a map: reading and drawing of levels, and the fewest moves that bring all boxes onto goals.

Levels are written as those of Sokoban and of Boxoban (Guez et al. 2018): `#` wall, `@` the player, `$` a box, `.` a
goal, `*` a box on a goal, `+` the player on a goal, anything else floor.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np

from hrl_escape.errors import ConfigError
from hrl_escape.search import find_cheapest_steps

PUSH_SIDES = {"east": (0, 1), "north": (-1, 0), "west": (0, -1), "south": (1, 0)}
"""Steps (row, column) to each side; rows count from the top."""
_MOST_SEARCHED = 300_000
"""States after which the search for the fewest moves gives up."""
_GAMES, _PULLS = 10, 15
"""Games that are played backwards from each drawn map, and pulls a box in each."""
_MOST_DRAWN = 1000
"""Most levels drawn before a schematic is given up."""


class Shove(NamedTuple):
    """A push: the cell that the box leaves, and the side to which it goes."""

    cell: int
    side: str


class BoxMap:
    """Cells of a level and their neighbours, without its boxes.

    Attributes:
        columns: cells in a row.
        floor: cells that are no walls.
        boxes: cells of the boxes at first.
        goals: cells of the goals.
        start: cell of the player at first.

    Raises:
        ConfigError: rows of different lengths, not one player, or not as many boxes as goals.
    """

    def __init__(self, rows: Sequence[str]) -> None:
        text = "".join(rows)
        self.rows, self.columns = tuple(rows), len(rows[0]) if rows else 0
        self.floor, self.boxes, self.goals, players = (
            tuple(cell for cell, character in enumerate(text) if is_one(character))
            for is_one in (lambda c: c != "#", "$*".__contains__, ".*+".__contains__, "@+".__contains__))
        if len({len(row) for row in rows}) != 1 or len(players) != 1:
            raise ConfigError("puzzle.rows", self.rows, "rows of one length, with one player (@ or +) among them")
        if not self.goals or len(self.boxes) != len(self.goals):
            raise ConfigError("puzzle.rows", self.rows, "as many boxes ($ or *) as goals (. or *), and one at least")
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
        """Neighbour of a cell, by the number of its side; -1 for a wall."""
        return self._next[cell][side]

    def measure_walks(self, begin: int, boxes: frozenset[int]) -> dict[int, int]:
        """Moves of the player to each cell that can be reached without a push."""
        moves, queue = {begin: 0}, [begin]
        for here in queue:
            count = moves[here] + 1
            for cell in self._beside[here]:
                if cell not in moves and cell not in boxes:
                    moves[cell] = count
                    queue.append(cell)
        return moves

    def list_shoves(self, player: int, boxes: frozenset[int]) -> Iterator[tuple[Shove, int, frozenset[int]]]:
        """Pushes that are possible, as (push, moves with it, boxes after it)."""
        walks = self.measure_walks(player, boxes)
        for box in boxes:
            for side, name in enumerate(PUSH_SIDES):
                behind, to = self._next[box][side ^ 2], self._next[box][side]
                if to >= 0 and to not in boxes and behind in walks:
                    yield Shove(box, name), walks[behind] + 1, boxes - {box} | {to}

    def measure_pushes(self) -> list[dict[int, int]]:
        """For each goal, the pushes that bring a lone box there from each cell; none from dead cells."""
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
    """Pushes of a solution with the fewest moves, walks included; None if there is none.

    Player and boxes stand on the cells that are told, not where the rows have theirs. A* with the fewest pushes that
    lone boxes need, each to a goal of its own. Boxes never enter cells from which no pushes lead to a goal. Beyond
    10,000 states it continues greedily, so fewer moves may exist; beyond 300,000 it gives up.
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
    """Least sum of prices that gives each row a column of its own; infinity where there is none."""
    from scipy.optimize import linear_sum_assignment  # only puzzles with boxes pay for this import

    try:
        rows, columns = linear_sum_assignment(prices)
    except ValueError:  # no assignment is finite
        return math.inf
    return float(sum(prices[row][column] for row, column in zip(rows.tolist(), columns.tolist(), strict=True)))


# --- levels --------------------------------------------------------------------------------


def read_boxoban(text: str) -> tuple[tuple[str, ...], ...]:
    """Read a file of levels, as Boxoban's: rows, after a line that begins with `;` and the level's number.

    Raises:
        ConfigError: there is no level in it.
    """
    levels, rows = list[tuple[str, ...]](), list[str]()
    for line in (*text.splitlines(), ";"):
        if line.strip() and not line.startswith(";"):
            rows.append(line.rstrip())
        elif rows:
            levels.append(tuple(rows))
            rows = []
    if not levels:
        raise ConfigError("levels", text, "rows of # and other characters, as Boxoban's files have them")
    return tuple(levels)


def tidy_level(rows: Sequence[str]) -> tuple[str, ...]:
    """Rows of one length without the outer walls, which a room has of its own; what cannot be reached is wall."""
    wide = max(map(len, rows), default=0)
    square = tuple(row.ljust(wide) for row in rows)
    level = BoxMap(square)
    inside = level.measure_walks(level.start, frozenset())
    kept = ["".join(c if row * wide + column in inside else "#" for column, c in enumerate(text))
            for row, text in enumerate(square)]
    if not {*level.boxes, *level.goals} <= inside.keys():
        raise ConfigError("puzzle.rows", tuple(rows), "boxes and goals that the player could walk to")
    rows_used = [number for number, row in enumerate(kept) if row.strip("#")]
    columns_used = [number for number in range(wide) if any(row[number] != "#" for row in kept)]
    return tuple(row[columns_used[0]: columns_used[-1] + 1] for row in kept[rows_used[0]: rows_used[-1] + 1])


def draw_level(side: int, boxes: int, rng: np.random.Generator) -> tuple[str, ...]:
    """Draw a level by playing backwards: boxes begin on goals and are pulled away as far as possible.

    The side is that of the square of cells, without outer walls.

    Raises:
        ConfigError: the cells are too few for the boxes.
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
    """Player and boxes after random pulls, where the boxes' distances from the goals were largest."""
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
    """Rows of a level, from rows of walls and the places of boxes, goals and player."""
    columns, marks = len(rows[0]), {(False, False): " ", (True, False): "$", (False, True): ".", (True, True): "*"}
    text = [c if c == "#" else marks[cell in boxes, cell in goals] for cell, c in enumerate("".join(rows))]
    text[player] = "+" if player in goals else "@"
    return tuple("".join(text[begin: begin + columns]) for begin in range(0, len(text), columns))
