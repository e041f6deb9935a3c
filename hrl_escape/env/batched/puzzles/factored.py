"""Factored domains in tensors: the word is the puzzle's own state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.puzzles.base import PuzzleTables, TensorContacts, TensorPuzzle, register_tensor_puzzle
from hrl_escape.env.puzzles.factored import FactoredPuzzle

__all__ = ["FactoredTensorPuzzle"]


class FactoredTensorPuzzle(TensorPuzzle):
    """`env.puzzles.factored.FactoredPuzzle`."""

    def make_tables(self, puzzles: Sequence[FactoredPuzzle], targets: int) -> dict[str, NDArray[Any]]:
        """Tables by instance.

        `after`: states after each press (states x factors, instances); `lit`: word of the factors that have their goal,
        by state (states, instances); `goal` and `success` (instances,); `values` of a factor (arity, instances). All
        domains of a batch have the same arity, because their observations are equally long.
        """
        states = max(puzzle.arity**puzzle.count for puzzle in puzzles)
        after = np.zeros((len(puzzles), states, targets), dtype=np.int64)
        lit = np.zeros((states, len(puzzles)), dtype=np.int64)
        for number, puzzle in enumerate(puzzles):
            for state in range(puzzle.arity**puzzle.count):
                after[number, state, : puzzle.count] = [puzzle.turn(state, factor) for factor in range(puzzle.count)]
                lit[state, number] = sum(on << factor for factor, on in enumerate(puzzle.get_lit(state)))
        return {"after": np.ascontiguousarray(after.reshape(len(puzzles), -1).T), "lit": lit,
                "goal": np.array([puzzle.goal for puzzle in puzzles], dtype=np.int64),
                "success": np.array([puzzle.success for puzzle in puzzles], dtype=np.float64),
                "values": np.tile(np.arange(puzzles[0].arity)[:, None], (1, len(puzzles)))}

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        """Each press that has its effect turns its factor, one after the other."""
        pressed = torch.where(contacts.uniform < tables["success"], contacts.pressed, 0)
        after = tables["after"]
        for factor in range(targets):
            row = (state * targets + factor).unsqueeze(0)
            then = after.expand(-1, state.shape[0]).gather(0, row).squeeze(0)
            state = torch.where((pressed >> factor & 1) != 0, then, state)
        return state

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Every factor has its goal."""
        return state == tables["goal"]

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Bits of the factors that have their goal, int64 (rooms,)."""
        return tables["lit"].expand(-1, state.shape[0]).gather(0, state.unsqueeze(0)).squeeze(0)

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        """One number a factor and value, then those of the goal, float32 (2 x targets x arity, rooms)."""
        values = tables["values"]
        arity = values.shape[0]
        digits = [word // arity**factor % arity for word in (state, tables["goal"].expand_as(state))
                  for factor in range(targets)]
        return torch.cat([(values == digit).to(torch.float32) for digit in digits])


register_tensor_puzzle(FactoredPuzzle, FactoredTensorPuzzle())
