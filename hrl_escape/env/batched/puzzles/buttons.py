"""The button puzzle in tensors: bit i is button i."""

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
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle

__all__ = ["ButtonsTensorPuzzle"]


class ButtonsTensorPuzzle(TensorPuzzle):
    """Tensor form of `ButtonsPuzzle`."""

    def make_tables(self, puzzles: Sequence[ButtonsPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """Tables by instance.

        Bits of each button's parents and, if any, its locks (buttons, instances); goals and rules (instances,); with
        doors, the button that opens each, -1 where there are fewer (doors, instances).
        """
        parents, locks = np.zeros((2, len(puzzles), len(frame.target_names)), dtype=np.uint64)
        for number, puzzle in enumerate(puzzles):
            parents[number, : puzzle.count], locks[number, : puzzle.count] = puzzle.parent_masks, puzzle.lock_masks
        tables = {
            "parents": np.ascontiguousarray(parents.T).view(np.int64),
            "goal": np.array([puzzle.goal for puzzle in puzzles], dtype=np.int64),
            "resets": np.array([puzzle.on_violation == "reset" for puzzle in puzzles]),
            "allow_off": np.array([puzzle.allow_off for puzzle in puzzles]),
        }
        if locks.any():
            tables["locks"] = np.ascontiguousarray(locks.T).view(np.int64)
        if doors := max(len(puzzle.doors) for puzzle in puzzles):
            openers = [(*puzzle.doors, *[-1] * (doors - len(puzzle.doors))) for puzzle in puzzles]
            tables["openers"] = np.array(openers, dtype=np.int64).T
        return tables

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        """Each press turns its button on if its parents are and none that locks it is, one after the other."""
        for button in range(targets):
            bit = as_signed(1 << button)
            unmet = tables["parents"][button] & ~state
            if "locks" in tables:
                unmet = unmet | tables["locks"][button] & state
            when_off = torch.where(unmet == 0, state | bit, torch.where(tables["resets"], 0, state))
            when_on = torch.where(tables["allow_off"], state & ~bit, state)
            after = torch.where((state & bit) != 0, when_on, when_off)
            state = torch.where((contacts.pressed & bit) != 0, after, state)
        return state

    def find_shut(self, tables: PuzzleTables, state: Tensor, doors: int) -> Tensor:
        """Return true where the button that opens a door is off, bool (doors, rooms)."""
        openers = tables["openers"]
        return (openers >= 0) & (state >> openers.clamp(min=0) & 1 == 0)

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Return true where the goal button is on, bool (rooms,)."""
        return ((state >> tables["goal"]) & 1) != 0


register_tensor_puzzle(ButtonsPuzzle, ButtonsTensorPuzzle())
