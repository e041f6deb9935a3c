"""Puddle World in tensors: the word is 1 once the goal has been entered."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.puzzles.base import PuzzleTables, TensorContacts, TensorPuzzle, register_tensor_puzzle
from hrl_escape.env.instance import SpaceLayout
from hrl_escape.env.puzzles.puddle_world import PuddleWorldPuzzle


class PuddleWorldTensorPuzzle(TensorPuzzle):
    """Tensor form of `PuddleWorldPuzzle`."""

    def make_tables(self, puzzles: Sequence[PuddleWorldPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """Ends and radius of each puddle, of no size where there are fewer (5, puddles, instances), and the cost."""
        most = max(1, *(len(puzzle.areas) for puzzle in puzzles))
        areas = np.zeros((5, most, len(puzzles)), dtype=np.float64)
        for number, puzzle in enumerate(puzzles):
            for place, area in enumerate(puzzle.areas):
                areas[:, place, number] = area.x1, area.y1, area.x2, area.y2, area.radius
        return {"areas": areas, "cost": np.array([puzzle.cost for puzzle in puzzles], dtype=np.float64)}

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        """Set the word to 1 where the goal's pad has been entered."""
        return state | (contacts.pressed != 0).to(state.dtype)

    def compute_reward(self, tables: PuzzleTables, before: Tensor, after: Tensor, contacts: TensorContacts,
                       targets: int) -> Tensor:
        """The price of the deepest puddle at each place, float64 (rooms,)."""
        x1, y1, x2, y2, radius = tables["areas"]
        along_x, along_y, to_x, to_y = x2 - x1, y2 - y1, contacts.x - x1, contacts.y - y1  # (puddles, rooms)
        length = along_x * along_x + along_y * along_y
        share = ((to_x * along_x + to_y * along_y) / torch.where(length > 0, length, 1.0)).clamp(0.0, 1.0)
        off_x, off_y = to_x - share * along_x, to_y - share * along_y
        depth = (radius - torch.sqrt(off_x * off_x + off_y * off_y)).clamp(min=0.0)
        return -tables["cost"] * depth.amax(0)

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Return true where the goal has been entered, bool (rooms,)."""
        return state == 1


register_tensor_puzzle(PuddleWorldPuzzle, PuddleWorldTensorPuzzle())
