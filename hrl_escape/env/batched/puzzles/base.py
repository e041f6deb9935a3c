"""Contract and registry of tensor forms: a puzzle's rules over 64-bit words, one word a room."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.puzzles.base import Puzzle
from hrl_escape.errors import UnsupportedError

__all__ = [
    "PuzzleTables",
    "TensorContacts",
    "TensorPuzzle",
    "as_signed",
    "get_tensor_puzzle",
    "register_tensor_puzzle",
    "unpack_bits",
]

PuzzleTables = dict[str, Tensor]


class TensorContacts(NamedTuple):
    """Contacts of one primitive in each room.

    Attributes:
        pressed: bits of the newly touched targets, int64 (rooms,).
        uniform: numbers in (0, 1) drawn for this primitive, float64 (rooms,); 0 where no puzzle is random.
        touching: bits of all targets touched at its end, int64 (rooms,).
        grip: 1 where the primitive was `grip`, -1 where it was `release`, 2 where it was `use`, 3 where a move pushes,
            else 0, int64 (rooms,).
        has_moved: true where the body's axis has moved, bool (rooms,).
        x: places of the bodies' axes, m, float64 (rooms,).
        y: places of the bodies' axes, m, float64 (rooms,).
        ahead: numbers of the inner doors one move ahead, -1 for none, int64 (rooms,).
        beyond: numbers of those one more move ahead, where something is pushed, int64 (rooms,).
    """

    pressed: Tensor
    uniform: Tensor
    touching: Tensor
    grip: Tensor
    has_moved: Tensor
    x: Tensor
    y: Tensor
    ahead: Tensor
    beyond: Tensor


class TensorPuzzle(ABC):
    """A puzzle's rules over tensors; its state is one int64 word a room.

    The methods that are not abstract suit puzzles whose own state is an integer with bit i for target i.
    """

    @abstractmethod
    def make_tables(self, puzzles: Sequence[Any], targets: int) -> dict[str, NDArray[Any]]:
        """Stack the tables of the puzzles that the rules read; the last axis is the instance.

        Args:
            puzzles: of the instances.
            targets: number of targets in the tables, that of the puzzle with most; the others are never pressed.
        """

    @abstractmethod
    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        """Apply presses in index order.

        Args:
            tables: columns of each room, (..., rooms) or (..., 1).
            state: int64 (rooms,).
            contacts: what was touched.
            targets: number of targets.
        """

    @abstractmethod
    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Return true where the exit is open, bool (rooms,)."""

    def is_failed(self, tables: PuzzleTables, state: Tensor) -> Tensor | None:
        """Return true where a press has ended the episode without an escape, bool (rooms,); None if none ever does."""
        return None

    def compute_reward(self, tables: PuzzleTables, before: Tensor, after: Tensor, contacts: TensorContacts
                       ) -> Tensor | None:
        """Reward of a primitive on top of the room's own, float32 or float64 (rooms,); None for none.

        It counts where something was pressed or gripped, or where puzzles watch every primitive.
        """
        return None

    def find_shut(self, tables: PuzzleTables, state: Tensor, doors: int) -> Tensor:
        """Return true where an inner door is shut, bool (doors, rooms)."""
        return torch.zeros((doors, state.shape[0]), dtype=torch.bool, device=state.device)

    def encode(self, state: Any) -> int:
        """Turn the puzzle's own state into an unsigned word."""
        return state

    def decode(self, word: int) -> Any:
        """Turn an unsigned word into the puzzle's own state."""
        return word

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Bits of the targets that are on, int64 (rooms,)."""
        return state

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        """The observation numbers, each 0 or 1, float32 (numbers, rooms)."""
        return unpack_bits(state, targets, torch.float32)


def unpack_bits(words: Tensor, count: int, dtype: torch.dtype) -> Tensor:
    """Spread the lowest bits of words (rooms,) over a first axis: shape (count, rooms)."""
    places = torch.arange(count, device=words.device).unsqueeze(1)
    return ((words >> places) & 1).to(dtype)


def as_signed(bits: int) -> int:
    """The signed 64-bit integer of the same bits."""
    return bits - 2**64 if bits >= 2**63 else bits


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
