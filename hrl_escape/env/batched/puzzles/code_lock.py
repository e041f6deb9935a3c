"""The combination lock in tensors: the word is the progress."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.puzzles.base import PuzzleTables, TensorContacts, TensorPuzzle, register_tensor_puzzle
from hrl_escape.env.puzzles.code_lock import CodeLockPuzzle

__all__ = ["CodeLockTensorPuzzle"]


class CodeLockTensorPuzzle(TensorPuzzle):
    """`env.puzzles.code_lock.CodeLockPuzzle`."""

    def make_tables(self, puzzles: Sequence[CodeLockPuzzle], targets: int) -> dict[str, NDArray[Any]]:
        """Tables by instance.

        `after`: progress after each press (progress x digits, instances); `last`: digit entered last, by progress
        (progress, instances); `length` of the code, word of all `digits`, and whether progress is `shown` (instances,).
        """
        length = max(len(puzzle.code) for puzzle in puzzles)
        after = np.tile(np.arange(length + 1)[None, :, None], (len(puzzles), 1, targets)).astype(np.int64)
        last = np.full((len(puzzles), length + 1), -1, dtype=np.int64)
        for number, puzzle in enumerate(puzzles):
            after[number, : len(puzzle.code), : puzzle.digits] = puzzle.next_progress
            last[number, 1 : len(puzzle.code) + 1] = puzzle.code
        return {"after": np.ascontiguousarray(after.reshape(len(puzzles), -1).T), "last": np.ascontiguousarray(last.T),
                "length": np.array([len(puzzle.code) for puzzle in puzzles], dtype=np.int64),
                "digits": np.array([(1 << puzzle.digits) - 1 for puzzle in puzzles], dtype=np.int64),
                "shown": np.array([puzzle.shown for puzzle in puzzles])}

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        """Each press goes on to its row's next progress."""
        after = tables["after"]
        for digit in range(targets):
            row = (state * targets + digit).unsqueeze(0)
            then = after.expand(-1, state.shape[0]).gather(0, row).squeeze(0)
            state = torch.where((contacts.pressed >> digit & 1) != 0, then, state)
        return state

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """The whole code has been entered."""
        return state == tables["length"]

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Bit of the panel pressed last, where progress is shown; all bits once the lock is open, int64 (rooms,)."""
        last = tables["last"].expand(-1, state.shape[0]).gather(0, state.unsqueeze(0)).squeeze(0)
        lit = torch.where(tables["shown"] & (last >= 0), 1 << last.clamp(min=0), 0)
        return torch.where(self.is_solved(tables, state), tables["digits"], lit)

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        """One number a digit of the code, float32 (length, rooms)."""
        seen = torch.where(tables["shown"] | self.is_solved(tables, state), state, 0)
        places = torch.arange(tables["last"].shape[0] - 1, device=state.device).unsqueeze(1)
        return (places < seen).to(torch.float32)


register_tensor_puzzle(CodeLockPuzzle, CodeLockTensorPuzzle())
