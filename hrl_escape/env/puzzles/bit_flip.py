"""BitFlip (Diuk, Strehl and Littman 2006) on a wall: bits that must be flipped in one order.

Bit i can be flipped only while all lower bits are on. Pressed too early, it and all lower bits go off. All bits on open
the exit, which takes at least n presses, from the lowest bit to the highest. The rule follows public implementations of
the domain ("flip from left to right; the penalty is a reset of all bits to the left"), such as Mehta et al. 2008
("Automatic discovery and transfer of MAXQ hierarchies"), without their parity condition on the last bit. Unlike the
button puzzle, BitFlip is not monotone: one press can undo many. The state is an integer whose bit i is bit i.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated

from hrl_escape.env.puzzles.base import Contacts, Panels, PuzzleConfig, register_puzzle
from hrl_escape.env.puzzles.bits import BitPuzzle
from hrl_escape.env.puzzles.mixins import Graphed
from hrl_escape.env.puzzles.symbolic import Operator, SymbolicModel
from hrl_escape.settings import Range


@dataclasses.dataclass(frozen=True)
class BitFlipConfig(PuzzleConfig):
    """Configuration of a BitFlip puzzle, one wall panel per bit."""

    kind = "bit-flip"
    _takes_ranges = True
    count: Annotated[int, Range(1, 64)] = 4
    """Number of bits, each with a panel. More bits make mistakes more costly."""
    buttons: Panels = Panels()
    """Sizes and places of the bits' panels."""


@dataclasses.dataclass(frozen=True)
class BitFlipPuzzle(Graphed, BitPuzzle):
    """A concrete BitFlip puzzle. Bit i is called `bit-<i+1>`."""

    kind, word = "bit-flip", "bit"
    count: Annotated[int, Range(1, 64)] = 1
    """Number of bits, each with a panel."""

    @property
    def edges(self) -> tuple[tuple[int, int], ...]:
        """Each bit waits for the bit below it, and thereby for all lower bits."""
        return tuple((i, i + 1) for i in range(self.count - 1))

    @property
    def goal_targets(self) -> tuple[int, ...]:
        """Indices of all bits: the exit opens once all are on."""
        return tuple(range(self.count))

    def update(self, state: int, contacts: Contacts) -> int:
        """Apply presses in index order: flip the bit, or clear it and all lower bits."""
        for bit in contacts.pressed:
            lower = (1 << bit) - 1
            if state & lower == lower:
                state ^= 1 << bit
            else:
                state &= ~(lower | 1 << bit)
        return state

    def is_solved(self, state: int) -> bool:
        """Return whether all bits are on."""
        return state == (1 << self.count) - 1

    def make_symbolic_model(self) -> SymbolicModel:
        """Return the model: two operators per bit, to set and to clear it, applicable while all lower bits are on."""
        fact = [f"on({name})" for name in self.target_names]
        operators = []
        for i, name in enumerate(self.target_names):
            lower, this = frozenset(fact[:i]), frozenset({fact[i]})
            operators.append(Operator(f"set-{name}", name, "press", lower, this, this))
            operators.append(Operator(f"clear-{name}", name, "press", lower | this, delete=this))
        return SymbolicModel(tuple(fact), tuple(operators), frozenset(fact))


register_puzzle(BitFlipConfig, BitFlipPuzzle)
