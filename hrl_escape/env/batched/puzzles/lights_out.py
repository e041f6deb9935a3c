"""Lights Out in tensors: bit i is light i."""

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
    unpack_bits,
)
from hrl_escape.env.instance import SpaceLayout
from hrl_escape.env.puzzles.lights_out import LightsOutPuzzle, list_flips

__all__ = ["LightsOutTensorPuzzle"]


class LightsOutTensorPuzzle(TensorPuzzle):
    """Tensor form of `LightsOutPuzzle`."""

    def make_tables(self, puzzles: Sequence[LightsOutPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """Flips of each press (lights, instances), and each goal (instances,)."""
        flips = np.zeros((len(puzzles), len(frame.target_names)), dtype=np.int64)
        for row, puzzle in zip(flips, puzzles, strict=True):
            row[: puzzle.count] = list_flips(puzzle.count, puzzle.columns)
        return {"flips": np.ascontiguousarray(flips.T),
                "goal": np.array([puzzle.goal for puzzle in puzzles], dtype=np.int64)}

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        """Each press flips its light and the neighbours."""
        for light in range(targets):
            bit = as_signed(1 << light)
            state = torch.where((contacts.pressed & bit) != 0, state ^ tables["flips"][light], state)
        return state

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Return true where the board shows the goal pattern, bool (rooms,)."""
        return state == tables["goal"]

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        """The lights, then the goal's, float32 (2 targets, rooms)."""
        goal = tables["goal"].expand_as(state)
        return torch.cat([unpack_bits(word, targets, torch.float32) for word in (state, goal)])


register_tensor_puzzle(LightsOutPuzzle, LightsOutTensorPuzzle())
