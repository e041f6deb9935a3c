"""Foraging in tensors: the word is the puzzle's own state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.puzzles.base import PuzzleTables, TensorContacts, TensorPuzzle, register_tensor_puzzle
from hrl_escape.env.puzzles.foraging import CORRIDOR_COUNT, ForagingPuzzle

__all__ = ["ForagingTensorPuzzle"]


class ForagingTensorPuzzle(TensorPuzzle):
    """`env.puzzles.foraging.ForagingPuzzle`."""

    def make_tables(self, puzzles: Sequence[ForagingPuzzle], targets: int) -> dict[str, NDArray[Any]]:
        """Worms to eat (instances,)."""
        return {"worms": np.array([puzzle.worms for puzzle in puzzles], dtype=np.int64)}

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        """Eat the worm."""
        eaten, place = state // CORRIDOR_COUNT, state % CORRIDOR_COUNT
        eats = (contacts.grip > 0) & ((contacts.touching >> place & 1) != 0) & (eaten < tables["worms"])
        turn = torch.where(contacts.uniform < 0.5, 1, 2)
        return torch.where(eats, (eaten + 1) * CORRIDOR_COUNT + (place + turn) % CORRIDOR_COUNT, state)

    def compute_reward(self, tables: PuzzleTables, before: Tensor, after: Tensor, contacts: TensorContacts) -> Tensor:
        """1 for a worm, float32 (rooms,)."""
        return (after != before).to(torch.float32)

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """All worms have been eaten."""
        return state // CORRIDOR_COUNT == tables["worms"]

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Bit of the corridor with the worm, int64 (rooms,)."""
        return 1 << state % CORRIDOR_COUNT

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        """One number a corridor, and the share of the worms eaten, float32 (4, rooms)."""
        places = torch.arange(CORRIDOR_COUNT, device=state.device).unsqueeze(1)
        share = (state // CORRIDOR_COUNT).to(torch.float64) / tables["worms"]
        return torch.cat([(places == state % CORRIDOR_COUNT).to(torch.float32), share.to(torch.float32).unsqueeze(0)])


register_tensor_puzzle(ForagingPuzzle, ForagingTensorPuzzle())
