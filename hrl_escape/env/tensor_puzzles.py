"""Puzzles in tensors: each kind's rules over 64-bit words, one word a room.

A tensor form repeats the rules of the puzzle's own file without branches; conformance tests
hold the two together. Third parties add theirs with `register_tensor_puzzle`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.puzzles.base import Puzzle
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.errors import UnsupportedError

__all__ = ["ButtonsTensorPuzzle", "TensorPuzzle", "get_tensor_puzzle", "register_tensor_puzzle", "unpack_bits"]

PuzzleTables = dict[str, Tensor]


class TensorPuzzle(ABC):
    """A puzzle's rules over tensors; its state is one int64 word a room, bits from 0 up."""

    @abstractmethod
    def make_tables(self, puzzles: Sequence[Any]) -> dict[str, NDArray[Any]]:
        """Stack what the rules need to know of each puzzle; instances come last."""

    @abstractmethod
    def encode(self, state: Any) -> int:
        """Turn the puzzle's own state into an unsigned word."""

    @abstractmethod
    def decode(self, word: int) -> Any:
        """Turn an unsigned word into the puzzle's own state."""

    @abstractmethod
    def make_state(self, tables: PuzzleTables) -> Tensor:
        """Words at the beginning of an episode, int64 (rooms,) or (1,)."""

    @abstractmethod
    def update(self, tables: PuzzleTables, state: Tensor, pressed: Tensor, targets: int) -> Tensor:
        """Apply presses in index order.

        Args:
            tables: columns of each room, (..., rooms) or (..., 1).
            state: int64 (rooms,).
            pressed: bits of the targets whose touching began, int64 (rooms,).
            targets: number of targets.
        """

    @abstractmethod
    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Whether the exit is open, bool (rooms,)."""

    @abstractmethod
    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Bits of the targets that are on, int64 (rooms,)."""

    @abstractmethod
    def observe(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """The observation numbers, float32 (numbers, rooms); within 0 and 1, as all bits are."""


def unpack_bits(words: Tensor, count: int, dtype: torch.dtype) -> Tensor:
    """Spread the lowest bits of words (rooms,) over a first axis: shape (count, rooms)."""
    places = torch.arange(count, device=words.device).unsqueeze(1)
    return ((words >> places) & 1).to(dtype)


class ButtonsTensorPuzzle(TensorPuzzle):
    """`puzzles.buttons.ButtonsPuzzle`: bit i of the word is button i."""

    def make_tables(self, puzzles: Sequence[ButtonsPuzzle]) -> dict[str, NDArray[Any]]:
        """Parents' bits (buttons, instances), and each puzzle's goal and rules (instances,)."""
        parents = np.array([puzzle.parent_masks for puzzle in puzzles], dtype=np.uint64)
        return {
            "parents": np.ascontiguousarray(parents.T).view(np.int64),
            "goal": np.array([puzzle.goal for puzzle in puzzles], dtype=np.int64),
            "resets": np.array([puzzle.on_violation == "reset" for puzzle in puzzles]),
            "allow_off": np.array([puzzle.allow_off for puzzle in puzzles]),
        }

    def encode(self, state: int) -> int:
        """The state is the word."""
        return state

    def decode(self, word: int) -> int:
        """The word is the state."""
        return word

    def make_state(self, tables: PuzzleTables) -> Tensor:
        """All buttons off."""
        return torch.zeros_like(tables["goal"])

    def update(self, tables: PuzzleTables, state: Tensor, pressed: Tensor, targets: int) -> Tensor:
        """Each press turns its button on if its parents are, one after the other."""
        for button in range(targets):
            bit = (1 << button) - ((1 << 64) if button == 63 else 0)
            is_ready = (tables["parents"][button] & ~state) == 0
            when_off = torch.where(is_ready, state | bit, torch.where(tables["resets"], 0, state))
            when_on = torch.where(tables["allow_off"], state & ~bit, state)
            after = torch.where((state & bit) != 0, when_on, when_off)
            state = torch.where((pressed & bit) != 0, after, state)
        return state

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """The goal button is on."""
        return ((state >> tables["goal"]) & 1) != 0

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Buttons that are on."""
        return state

    def observe(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """One number a button."""
        return unpack_bits(state, tables["parents"].shape[0], torch.float32)


_FORMS: dict[str, TensorPuzzle] = {}


def register_tensor_puzzle(puzzle_type: type[Puzzle], form: TensorPuzzle) -> None:
    """Give a puzzle a tensor form, so that the batched engine can step it."""
    _FORMS[puzzle_type.kind] = form


def get_tensor_puzzle(kind: str) -> TensorPuzzle:
    """Look up the tensor form of a puzzle.

    Raises:
        UnsupportedError: the puzzle has none.
    """
    if kind not in _FORMS:
        raise UnsupportedError(
            f"puzzle {kind!r} has no tensor form ({', '.join(sorted(_FORMS))} have): use the Bullet engine "
            "(gymnasium.make, or make_vec with vectorization_mode='sync'), or register_tensor_puzzle"
        )
    return _FORMS[kind]


register_tensor_puzzle(ButtonsPuzzle, ButtonsTensorPuzzle())
