"""LightBox in tensors: bit i is light i."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.puzzles.base import PuzzleTables, TensorContacts, TensorPuzzle, register_tensor_puzzle
from hrl_escape.env.instance import SpaceLayout
from hrl_escape.env.puzzles.light_box import LightBoxPuzzle

__all__ = ["LightBoxTensorPuzzle"]


class LightBoxTensorPuzzle(TensorPuzzle):
    """Tensor form of `LightBoxPuzzle`."""

    def make_tables(self, puzzles: Sequence[LightBoxPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """Bits of each light's parents and of its family (lights, instances), the goal and the chance (instances,)."""
        parents, families = np.zeros((2, len(frame.target_names), len(puzzles)), dtype=np.int64)
        for number, puzzle in enumerate(puzzles):
            parents[: puzzle.count, number], families[: puzzle.count, number] = puzzle.parent_masks, puzzle.family_masks
        return {"parents": parents, "families": families,
                "goal": np.array([puzzle.goal for puzzle in puzzles], dtype=np.int64),
                "success": np.array([puzzle.success for puzzle in puzzles], dtype=np.float64)}

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        """Each press that has its effect turns its light on, off, or all off, one after the other."""
        pressed = torch.where(contacts.uniform < tables["success"], contacts.pressed, 0)
        for light in range(targets):
            bit = 1 << light
            is_ready = (tables["parents"][light] & ~state) == 0
            after = torch.where((state & bit) != 0, state & ~tables["families"][light],
                                torch.where(is_ready, state | bit, 0))
            state = torch.where((pressed & bit) != 0, after, state)
        return state

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Return true where the goal's light is on, bool (rooms,)."""
        return (state >> tables["goal"] & 1) != 0


register_tensor_puzzle(LightBoxPuzzle, LightBoxTensorPuzzle())
