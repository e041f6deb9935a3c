"""Maps of a puzzle's grid world: walls, doors, things in cells, start and goal.

A map is rows of characters from the top, one per cell: `#` wall, `d` door, `D` locked door, `k` key, `b` ball, `G`
goal, `>`, `^`, `<` or `v` the start and its heading, anything else floor. Cells are numbered row by row.
"""

from __future__ import annotations

import heapq
from collections.abc import Collection
from functools import cached_property

from hrl_escape.errors import ConfigError

HEADINGS = ">^<v"
"""Characters of a start, by quarter turns counter-clockwise from +x."""


class GridMap:
    """A map with derived sets of cells, numbered row by row.

    Attributes:
        columns: number of cells in a row.
        doors: cells of the doors.
        things: initial cells of the things: keys, then balls.
        keys: number of keys.
        floor: initially empty cells.
        start: cell of the start.
        heading: initial heading, in quarter turns from +x.
        goal: cell of the goal, or None if there is none.
        blockable: cells that can be blocked: doors and, on a map with things, all other cells that are not walls.

    Raises:
        ConfigError: rows differ in length, or there is not exactly one start.
    """

    def __init__(self, rows: tuple[str, ...]) -> None:
        self.rows = rows
        text = self._text = "".join(rows)
        if len({len(row) for row in rows}) != 1 or sum(text.count(start) for start in HEADINGS) != 1:
            raise ConfigError("puzzle.rows", rows, "rows of equal length with exactly one start")
        self.columns = len(rows[0])
        self.doors, self.floor, self._cells = self._find("dD"), self._find(" "), self._find(set(text) - {"#"})
        self.things, self.keys = (*self._find("k"), *self._find("b")), text.count("k")
        self.start, self.goal = self._find(HEADINGS)[0], next(iter(self._find("G")), None)
        self.heading = HEADINGS.index(text[self.start])
        self.blockable = self._cells if self.things else self.doors

    def _find(self, characters: Collection[str]) -> tuple[int, ...]:
        return tuple(cell for cell, character in enumerate(self._text) if character in characters)

    def is_locked(self, door: int) -> bool:
        """Return whether a door is initially locked."""
        return self._text[self.doors[door]] == "D"

    def _list_neighbours(self, cell: int) -> list[int]:
        """Neighbours of a cell that are not walls."""
        row, column = divmod(cell, self.columns)
        beside = ((row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1))
        return [i * self.columns + j for i, j in beside
                if 0 <= i < len(self.rows) and 0 <= j < self.columns and self.rows[i][j] != "#"]

    @cached_property
    def bottlenecks(self) -> frozenset[int]:
        """Cells where a thing would cut off other cells, or block the front of a door."""
        cells, found = self._cells, set[int]()
        for cell in cells:
            others = [other for other in cells if other != cell]
            reached, queue = {cell, others[0]}, [others[0]]
            while queue:
                more = set(self._list_neighbours(queue.pop())) - reached
                reached |= more
                queue += more
            if len(reached) < len(cells) or any(beside in self.doors for beside in self._list_neighbours(cell)):
                found.add(cell)
        return frozenset(found)

    @cached_property
    def _ways(self) -> dict[int, tuple[int, ...]]:
        """Fewest doors, in order, on a way from the start to each reachable cell. Things are ignored."""
        ways: dict[int, tuple[int, ...]] = {}
        queue: list[tuple[int, int, int, tuple[int, ...]]] = [(0, 0, self.start, ())]
        while queue:
            doors, steps, cell, way = heapq.heappop(queue)
            if cell in ways:
                continue
            ways[cell] = way
            beyond = (*way, self.doors.index(cell)) if cell in self.doors else way
            for other in self._list_neighbours(cell):
                heapq.heappush(queue, (len(beyond), steps + 1, other, beyond))
        return ways

    def can_reach(self, cell: int) -> bool:
        """Return whether a cell is reachable from the start once all doors are open."""
        return cell in self._ways

    def list_doors_before(self, cell: int) -> tuple[int, ...]:
        """Return the indices of the doors on the way from the start to a cell.

        Raises:
            ConfigError: the cell is unreachable even with all doors open.
        """
        if not self.can_reach(cell):
            raise ConfigError("puzzle.rows", self.rows, f"a way from the start to cell {cell}")
        return self._ways[cell]
