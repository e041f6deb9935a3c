"""The recipe game in tensors: counts of materials and bits of things, as in the puzzle's own state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.puzzles.base import PuzzleTables, TensorContacts, TensorPuzzle, register_tensor_puzzle
from hrl_escape.env.instance import SpaceLayout
from hrl_escape.env.puzzles.recipes import COUNT_BITS, MATERIALS, MOST_KEPT, NAMES, RECIPES, RecipesPuzzle

_SHIFTS = [COUNT_BITS * min(number, MATERIALS) + max(number - MATERIALS, 0) for number in range(len(NAMES))]


class RecipesTensorPuzzle(TensorPuzzle):
    """Tensor form of `RecipesPuzzle`."""

    def make_tables(self, puzzles: Sequence[RecipesPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """Numbers of the goals (instances,)."""
        return {"goal": np.array([NAMES.index(puzzle.goal) for puzzle in puzzles], dtype=np.int64)}

    def _count(self, state: Tensor) -> Tensor:
        """Number of each material and thing, int64 (names, rooms)."""
        return torch.stack([state >> shift & (2**COUNT_BITS - 1 if number < MATERIALS else 1)
                            for number, shift in enumerate(_SHIFTS)])

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        """Collect, place or make what is pressed, one after the other."""
        for target, name in enumerate(NAMES):
            recipe, counts = RECIPES[name], self._count(state)
            needs = [*((thing, 1) for thing in recipe.takes), *recipe.uses]
            able = counts[target] < (MOST_KEPT if target < MATERIALS else 1)
            for needed, number in needs:
                able = able & (counts[NAMES.index(needed)] >= number)
            change = (1 << _SHIFTS[target]) - sum(number << _SHIFTS[NAMES.index(used)] for used, number in recipe.uses)
            state = torch.where((contacts.pressed >> target & 1 != 0) & able, state + change, state)
        return state

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Return true where the goal has been collected, placed or made, bool (rooms,)."""
        goal = tables["goal"].expand(state.shape).unsqueeze(0)
        return self._count(state).gather(0, goal).squeeze(0) > 0

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Bits of materials in store and things that are there, int64 (rooms,)."""
        numbers = torch.arange(len(NAMES), device=state.device).unsqueeze(1)
        return ((self._count(state) > 0).to(torch.int64) << numbers).sum(0)

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        """The store, as shares of `MOST_KEPT`, and 1 for each thing that is there, float32 (names, rooms)."""
        most = torch.tensor([MOST_KEPT] * MATERIALS + [1] * (len(NAMES) - MATERIALS), device=state.device).unsqueeze(1)
        return (self._count(state).to(torch.float64) / most).to(torch.float32)


register_tensor_puzzle(RecipesPuzzle, RecipesTensorPuzzle())
