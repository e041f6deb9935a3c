"""Deep Sea (Osband et al. 2019, bsuite): each press dives one row, and only one sequence reaches the treasure.

On a square of N x N cells, one panel moves a diver down and right at a reward of -0.01 / N, the other down and left.
The assignment is random for each cell. Moving right in the last cell has reward 1 and opens the exit. After N presses
the episode ends in any case. Always moving right returns 0.99; random presses find the treasure in one of 2^N episodes.
The state encodes (row, column, treasure found) as an integer.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from hrl_escape.env.puzzles.base import Contacts, Panels, Puzzle, PuzzleConfig, register_puzzle
from hrl_escape.settings import Range

MOVE_COST = 0.01
"""Total cost of moving right N times."""
COLUMN_BITS = 6
"""Bits of a state's column. The row is above them, and the treasure is one bit above the row."""
_TREASURE = 1 << 2 * COLUMN_BITS

SeaSize = Annotated[int, Range(2, 50)]
MappingSeed = Annotated[int, Range(0, 2**32 - 1)]


@dataclasses.dataclass(frozen=True)
class DeepSeaConfig(PuzzleConfig):
    """Configuration of Deep Sea."""

    kind = "deep-sea"
    size: SeaSize = 10
    """Number of rows and of columns of the sea. Each additional row halves the success rate of random presses."""
    mapping_seed: MappingSeed = 42
    """Seed of the assignment of panels; bsuite uses 42."""
    buttons: Panels = Panels(width=1.5)
    """Sizes and places of the two panels."""


@dataclasses.dataclass(frozen=True)
class DeepSeaPuzzle(Puzzle):
    """A concrete sea with the panels `dive-1` and `dive-2`. Episodes begin in the top left cell, state 0."""

    kind = "deep-sea"
    fixed_names = ("dive-1", "dive-2")
    size: SeaSize = 2
    """Number of rows and of columns of the sea."""
    mapping_seed: MappingSeed = 42
    """Seed of the assignment of panels."""

    @cached_property
    def rights(self) -> tuple[tuple[int, ...], ...]:
        """Index of the panel that moves right, by row and column."""
        drawn = np.random.RandomState(self.mapping_seed).binomial(1, 0.5, [self.size, self.size])
        return tuple(map(tuple, drawn.tolist()))

    def _read(self, state: int) -> tuple[int, int]:
        return (state & ~_TREASURE) >> COLUMN_BITS, state & (1 << COLUMN_BITS) - 1

    def is_state(self, state: Any) -> bool:
        """Return whether an untrusted value is a cell of the sea, or a column below its last row."""
        if type(state) is not int or not 0 <= state < 2 * _TREASURE:
            return False
        row, column = self._read(state)
        return row <= self.size and column <= min(row, self.size - 1) and (
            state < _TREASURE or (row == self.size and column == self.size - 1))

    def update(self, state: int, contacts: Contacts) -> int:
        """Dive one row for each press, in index order."""
        for panel in contacts.pressed:
            row, column = self._read(state)
            if row == self.size:
                break
            if self.rights[row][column] == panel:
                found = column == self.size - 1
                column = min(column + 1, self.size - 1)
            else:
                found, column = False, max(column - 1, 0)
            state = _TREASURE * found | row + 1 << COLUMN_BITS | column
        return state

    def is_solved(self, state: int) -> bool:
        """Return whether the treasure was found."""
        return state >= _TREASURE

    def is_failed(self, state: int) -> bool:
        """Return whether the dive ended without the treasure."""
        return state >> COLUMN_BITS == self.size

    def compute_reward(self, before: int, after: int, contacts: Contacts) -> float:
        """Return 1 for the treasure, minus the cost of each move to the right."""
        reward, here = 0.0, before
        for panel in contacts.pressed:
            row, column = self._read(here)
            if row < self.size and self.rights[row][column] == panel:
                reward -= MOVE_COST / self.size
            here = self.update(here, Contacts((panel,)))
        return reward + float(self.is_solved(after) and not self.is_solved(before))

    def observe(self, state: int) -> tuple[float, ...]:
        """Return one number per row, then one per column: 1 at the diver. No row is 1 after the last press."""
        row, column = self._read(state)
        return tuple(float(i == at) for at in (row, column) for i in range(self.size))

    def get_lit(self, state: int) -> tuple[bool, ...]:
        """Return whether each panel is lit: all once the treasure is found, none before."""
        return (self.is_solved(state),) * 2


register_puzzle(DeepSeaConfig, DeepSeaPuzzle)
