"""Pin Pad in tensors: the word is the number of pads that count."""

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
    register_tensor_puzzle,
    unpack_bits,
)
from hrl_escape.env.puzzles.pin_pad import PinPadPuzzle

__all__ = ["PinPadTensorPuzzle"]


class PinPadTensorPuzzle(TensorPuzzle):
    """`env.puzzles.pin_pad.PinPadPuzzle`."""

    def make_tables(self, puzzles: Sequence[PinPadPuzzle], targets: int) -> dict[str, NDArray[Any]]:
        """Place of each pad in the code (pads, instances), and the pads' number (instances,); absent pads have none."""
        places = np.full((targets, len(puzzles)), -1, dtype=np.int64)
        for number, puzzle in enumerate(puzzles):
            places[list(puzzle.code), number] = range(len(puzzle.code))
        return {"places": places, "length": np.array([len(puzzle.code) for puzzle in puzzles], dtype=np.int64)}

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        """Each step on a pad goes on in the code, stays, or begins anew."""
        for pad in range(targets):
            place = tables["places"][pad]
            after = torch.where(place == state, state + 1, (place == 0).to(torch.int64))
            is_moot = (place == state - 1) | (state == tables["length"])
            state = torch.where((contacts.pressed >> pad & 1 != 0) & ~is_moot, after, state)
        return state

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """The whole code has been walked."""
        return state == tables["length"]

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Bits of the pads that count, int64 (rooms,)."""
        lit = torch.zeros_like(state)
        for pad, place in enumerate(tables["places"]):
            lit = lit | ((place >= 0) & (place < state)).to(torch.int64) << pad
        return lit

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        """One number a pad, float32 (pads, rooms)."""
        return unpack_bits(self.get_lit(tables, state), targets, torch.float32)


register_tensor_puzzle(PinPadPuzzle, PinPadTensorPuzzle())
