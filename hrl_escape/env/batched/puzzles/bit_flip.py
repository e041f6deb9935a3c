"""BitFlip in tensors: bit i is bit i."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.puzzles.base import (
    PuzzleTables,
    TensorContacts,
    TensorPuzzle,
    as_signed,
    register_tensor_puzzle,
)
from hrl_escape.env.instance import SpaceLayout
from hrl_escape.env.puzzles.bit_flip import BitFlipPuzzle

__all__ = ["BitFlipTensorPuzzle"]


class BitFlipTensorPuzzle(TensorPuzzle):
    """Tensor form of `BitFlipPuzzle`."""

    def make_tables(self, puzzles: Sequence[BitFlipPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """The word with all bits on (instances,)."""
        return {"all_on": np.array([as_signed((1 << puzzle.count) - 1) for puzzle in puzzles], dtype=np.int64)}

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        """Each press flips its bit if all lower ones are on, and else clears it and them."""
        for number in range(targets):
            bit, lower = as_signed(1 << number), (1 << number) - 1
            after = torch.where((state & lower) == lower, state ^ bit, state & ~(lower | bit))
            state = torch.where((contacts.pressed & bit) != 0, after, state)
        return state

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Return true where all bits are on, bool (rooms,)."""
        return state == tables["all_on"]


register_tensor_puzzle(BitFlipPuzzle, BitFlipTensorPuzzle())
