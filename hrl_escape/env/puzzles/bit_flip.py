"""BitFlip (Diuk, Strehl and Littman 2006) on a wall: bits that are flipped in one order.

Bit i can be flipped only while all lower bits are on; pressed too early, it and all lower bits go
off. All bits on open the exit: n presses at the fewest, from the lowest bit to the highest. The
rule is the one that public implementations of the domain restate ("flip from left to right; the
penalty is a reset of all bits to the left"), among them that of Mehta et al. 2008 ("Automatic
discovery and transfer of MAXQ hierarchies"), whose additional parity condition on the last bit is
left out. Unlike the button puzzle it is not monotone: a press can undo many. The state is an
integer whose bit i is bit i.
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
    """Room configuration of a BitFlip puzzle, one wall panel a bit."""

    kind = "bit-flip"
    _takes_ranges = True
    count: Annotated[int, Range(1, 64)] = 4
    """Number of bits, each with a panel."""
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
        """Each bit waits for the one below it (and so for all lower ones)."""
        return tuple((i, i + 1) for i in range(self.count - 1))

    @property
    def goal_targets(self) -> tuple[int, ...]:
        """Numbers of all bits: the exit opens once all are on."""
        return tuple(range(self.count))

    def update(self, state: int, contacts: Contacts) -> int:
        """Flip the bit, or clear it and all lower ones, for each press in index order."""
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
        """Two operators a bit, to set and to clear it, applicable while all lower bits are on."""
        fact = [f"on({name})" for name in self.target_names]
        operators = []
        for i, name in enumerate(self.target_names):
            lower, this = frozenset(fact[:i]), frozenset({fact[i]})
            operators.append(Operator(f"set-{name}", name, "press", lower, this, this))
            operators.append(Operator(f"clear-{name}", name, "press", lower | this, delete=this))
        return SymbolicModel(tuple(fact), tuple(operators), frozenset(fact))


register_puzzle(BitFlipConfig, BitFlipPuzzle)
