"""Deep Sea in tensors: the word is the puzzle's own state."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.puzzles.base import PuzzleTables, TensorContacts, TensorPuzzle, register_tensor_puzzle
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.deep_sea import COLUMN_BITS, DeepSeaPuzzle

__all__ = ["DeepSeaTensorPuzzle"]


class DeepSeaTensorPuzzle(TensorPuzzle):
    """`env.puzzles.deep_sea.DeepSeaPuzzle`."""

    def make_tables(self, puzzles: Sequence[DeepSeaPuzzle], targets: int) -> dict[str, NDArray[Any]]:
        """Size (instances,), states and rewards after a press of dive-1, dive-2 and both, (3 x words, instances)."""
        most = max(puzzle.size for puzzle in puzzles)
        words = (most + 2) << COLUMN_BITS
        after = np.zeros((3, words, len(puzzles)), dtype=np.int64)
        reward = np.zeros((3, words, len(puzzles)), dtype=np.float32)
        for number, puzzle in enumerate(puzzles):
            for row, word, then, earned in _tabulate(puzzle):
                after[row, word, number], reward[row, word, number] = then, earned
        return {"size": np.array([puzzle.size for puzzle in puzzles], dtype=np.int64),
                "after": after.reshape(3 * words, -1), "reward": reward.reshape(3 * words, -1),
                "rows": np.zeros((most, len(puzzles)))}

    def _look_up(self, table: Tensor, state: Tensor, pressed: Tensor) -> Tensor:
        words = table.shape[0] // 3
        row = ((pressed - 1).clamp(min=0) * words + state.clamp(max=words - 1)).unsqueeze(0)
        return table.expand(-1, state.shape[0]).gather(0, row).squeeze(0)

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        """Look up the state after the presses; nothing moves once the treasure is found."""
        then = self._look_up(tables["after"], state, contacts.pressed)
        return torch.where((contacts.pressed == 0) | self.is_solved(tables, state), state, then)

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """The treasure has been found."""
        return state >> 2 * COLUMN_BITS != 0

    def is_failed(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """The last row has been left without it."""
        return state >> COLUMN_BITS == tables["size"]

    def compute_reward(self, tables: PuzzleTables, before: Tensor, after: Tensor, contacts: TensorContacts) -> Tensor:
        """1 for the treasure, and the cost of each move to the right."""
        reward = self._look_up(tables["reward"], before, contacts.pressed)
        return torch.where(self.is_solved(tables, before), 0.0, reward)

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Bits of the targets that are on, int64 (rooms,): both once the treasure is found."""
        return torch.where(self.is_solved(tables, state), 3, 0)

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        """One number a row, then one a column, float32 (2 size, rooms)."""
        places = torch.arange(tables["rows"].shape[0], device=state.device).unsqueeze(1)
        column = (1 << COLUMN_BITS) - 1
        row = (state >> COLUMN_BITS) & column
        return torch.cat([(places == at).to(torch.float32) for at in (row, state & column)])


@lru_cache
def _tabulate(puzzle: DeepSeaPuzzle) -> tuple[tuple[int, int, int, float], ...]:
    """Outcomes of presses: (number of the presses, state, state after them, reward)."""
    rows = []
    for word in filter(puzzle.is_state, range((puzzle.size + 1) << COLUMN_BITS)):
        for row, pressed in enumerate(((0,), (1,), (0, 1))):
            then = puzzle.update(word, Contacts(pressed))
            rows.append((row, word, then, puzzle.compute_reward(word, then, Contacts(pressed))))
    return tuple(rows)


register_tensor_puzzle(DeepSeaPuzzle, DeepSeaTensorPuzzle())
