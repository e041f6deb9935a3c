"""Grids of free cells and walls, drawn as text."""

from __future__ import annotations

from collections.abc import Sequence

Cell = tuple[int, int]

NORTH, SOUTH, WEST, EAST = range(4)
MOVES: tuple[Cell, ...] = ((-1, 0), (1, 0), (0, -1), (0, 1))
SIDES: tuple[tuple[int, int], ...] = ((WEST, EAST), (WEST, EAST), (NORTH, SOUTH), (NORTH, SOUTH))
"""The two directions at right angles to each."""


class Grid:
    """Free cells numbered row by row; `#` is a wall, every other character is free."""

    def __init__(self, rows: Sequence[str]) -> None:
        self.rows = tuple(rows)
        self.cells: tuple[Cell, ...] = tuple(
            (row, column) for row, line in enumerate(rows) for column, mark in enumerate(line) if mark != "#"
        )
        self.numbers = {cell: number for number, cell in enumerate(self.cells)}

    def __len__(self) -> int:
        return len(self.cells)

    def find(self, mark: str) -> int:
        """The number of the one cell with a mark."""
        (number,) = (number for number, (row, column) in enumerate(self.cells) if self.rows[row][column] == mark)
        return number

    def move(self, number: int, direction: int) -> int:
        """The cell next to a cell, or the same one where a wall is in the way."""
        (row, column), (down, right) = self.cells[number], MOVES[direction]
        return self.numbers.get((row + down, column + right), number)

    def list_neighbours(self, number: int) -> list[int]:
        """The free cells next to a cell."""
        return [there for direction in range(4) if (there := self.move(number, direction)) != number]
