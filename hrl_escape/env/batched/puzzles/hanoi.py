"""Towers of Hanoi in tensors: four bits a disc, for its place."""

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
from hrl_escape.env.puzzles.hanoi import HAND, PEGS, HanoiPuzzle

__all__ = ["HanoiTensorPuzzle"]


class HanoiTensorPuzzle(TensorPuzzle):
    """`env.puzzles.hanoi.HanoiPuzzle`."""

    def make_tables(self, puzzles: Sequence[HanoiPuzzle], targets: int) -> dict[str, NDArray[Any]]:
        """Word with a bit a disc (instances,), and the numbers of a state's bits (4 discs, instances)."""
        (discs,) = {puzzle.discs for puzzle in puzzles}
        word = sum(1 << 4 * disc for disc in range(discs))
        return {"discs": np.full(len(puzzles), word, dtype=np.int64),
                "bits": np.tile(np.arange(4 * discs)[:, None], len(puzzles))}

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        """Each press lifts the peg's top disc, or puts the lifted one down where no smaller disc lies."""
        for peg in range(targets):
            here, held = (_get_lowest(state >> place & tables["discs"]) for place in (peg, HAND))
            puts = (held != 0) & ((here == 0) | (held < here))
            lifts = (held == 0) & (here != 0)
            moved = torch.where(puts, held, torch.where(lifts, here, 0))
            after = state ^ (moved << peg | moved << HAND)
            state = torch.where((contacts.pressed >> peg & 1) != 0, after, state)
        return state

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """All discs are on the last peg."""
        return state == tables["discs"] << PEGS - 1

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Bits of the pegs on which all discs are, int64 (rooms,)."""
        return torch.stack([(state == tables["discs"] << peg).long() << peg for peg in range(PEGS)]).sum(0)

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        """Four numbers a disc: 1 for its place, float32 (4 discs, rooms)."""
        return unpack_bits(state, tables["bits"].shape[0], torch.float32)


def _get_lowest(word: Tensor) -> Tensor:
    """The lowest bit that is on; 0 where none is."""
    return word & -word


register_tensor_puzzle(HanoiPuzzle, HanoiTensorPuzzle())
