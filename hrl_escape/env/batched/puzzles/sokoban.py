"""Sokoban in tensors: the word is the puzzle's own state, the cell of each box."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.puzzles.base import PuzzleTables, TensorContacts, TensorPuzzle, register_tensor_puzzle
from hrl_escape.env.instance import SpaceLayout
from hrl_escape.env.puzzles.base import PUSH
from hrl_escape.env.puzzles.sokoban import BOX_BITS, SokobanPuzzle

_CELL = (1 << BOX_BITS) - 1


class SokobanTensorPuzzle(TensorPuzzle):
    """Tensor form of `SokobanPuzzle`."""

    def make_tables(self, puzzles: Sequence[SokobanPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """`cells`: cell of each inner door, -1 for none; `goals`: their cells (goals, instances); `size` of the map."""
        levels = [puzzle.level for puzzle in puzzles]
        cells = np.full((max(len(level.floor) for level in levels), len(levels)), -1, dtype=np.int64)
        for number, level in enumerate(levels):
            cells[: len(level.floor), number] = level.floor
        return {"cells": cells, "goals": np.array([level.goals for level in levels], dtype=np.int64).T,
                "size": np.array([[len(level.rows) for level in levels], [level.columns for level in levels]],
                                 dtype=np.int64)}

    def _list_boxes(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Cell of each box, int64 (boxes, rooms)."""
        boxes = torch.arange(tables["goals"].shape[0], device=state.device).unsqueeze(1)
        return state >> BOX_BITS * boxes & _CELL

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        """Push the box ahead into the cell beyond it, if that is free."""
        cells = tables["cells"].expand(-1, state.shape[0])
        box, to = (cells.gather(0, number.clamp(min=0).unsqueeze(0)).squeeze(0)
                   for number in (contacts.ahead, contacts.beyond))
        boxes = self._list_boxes(tables, state)
        is_there = (contacts.grip == PUSH) & (contacts.ahead >= 0) & (contacts.beyond >= 0) & (box >= 0) & (to >= 0)
        is_there = is_there & ~(boxes == to).any(0)
        for number, cell in enumerate(boxes):
            moved = state & ~(_CELL << BOX_BITS * number) | to << BOX_BITS * number
            state = torch.where(is_there & (cell == box), moved, state)
        return state

    def _find_filled(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Return true for each pair of a box and the goal on which it stands, bool (boxes, goals, rooms)."""
        return self._list_boxes(tables, state).unsqueeze(1) == tables["goals"].unsqueeze(0)

    def compute_reward(self, tables: PuzzleTables, before: Tensor, after: Tensor, contacts: TensorContacts,
                       targets: int) -> Tensor:
        """1 for a box that comes onto a goal, -1 for one that leaves it."""
        then, now = (self._find_filled(tables, state).sum((0, 1)) for state in (before, after))
        return (now - then).to(torch.float64)

    def find_shut(self, tables: PuzzleTables, state: Tensor, doors: int) -> Tensor:
        """Return true where a box stands in a cell, bool (inner doors, rooms)."""
        cells = tables["cells"][:doors]
        is_shut = torch.zeros((cells.shape[0], state.shape[0]), dtype=torch.bool, device=state.device)
        for cell in self._list_boxes(tables, state):
            is_shut = is_shut | (cells == cell)
        return is_shut

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Return true where a box stands on every goal, bool (rooms,)."""
        return self._find_filled(tables, state).any(0).all(0)

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Bits of boxes on goals, then of goals with boxes on them, int64 (rooms,)."""
        filled = self._find_filled(tables, state)
        lit = torch.cat([filled.any(1), filled.any(0)]).to(torch.int64)
        return (lit << torch.arange(len(lit), device=state.device).unsqueeze(1)).sum(0)

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        """Row and column of each box as shares of the map, then one number a goal, float32 (numbers, rooms)."""
        rows, columns = tables["size"]
        seen = list[Tensor]()
        for cell in self._list_boxes(tables, state):
            seen += [cell // columns / rows.to(torch.float64), cell % columns / columns.to(torch.float64)]
        filled = self._find_filled(tables, state).any(0).to(torch.float64)
        return torch.cat([torch.stack(seen), filled]).to(torch.float32)


register_tensor_puzzle(SokobanPuzzle, SokobanTensorPuzzle())
