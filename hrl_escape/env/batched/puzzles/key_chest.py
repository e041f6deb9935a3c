"""Key-Chest in tensors: the word is the puzzle's own state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.puzzles.base import PuzzleTables, TensorContacts, TensorPuzzle, register_tensor_puzzle
from hrl_escape.env.puzzles.key_chest import KeyChestPuzzle

__all__ = ["KeyChestTensorPuzzle"]


class KeyChestTensorPuzzle(TensorPuzzle):
    """`env.puzzles.key_chest.KeyChestPuzzle`."""

    def make_tables(self, puzzles: Sequence[KeyChestPuzzle], targets: int) -> dict[str, NDArray[Any]]:
        """All are alike."""
        return {}

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        """Take the key; open the chest with it."""
        for pad in range(targets):
            state = torch.where((contacts.pressed >> pad & 1 != 0) & (state == pad), pad + 1, state)
        return state

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """The chest is open."""
        return state == 2

    def compute_reward(self, tables: PuzzleTables, before: Tensor, after: Tensor, contacts: TensorContacts) -> Tensor:
        """1 for the key."""
        return ((before == 0) & (after > 0)).to(torch.float64)

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Bits of the key once it is taken and the chest once it is open, int64 (rooms,)."""
        return (1 << state) - 1

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        """Two numbers: 1 with the key, 1 with the chest open, float32 (2, rooms)."""
        return torch.stack([state > pad for pad in range(targets)]).to(torch.float32)


register_tensor_puzzle(KeyChestPuzzle, KeyChestTensorPuzzle())
