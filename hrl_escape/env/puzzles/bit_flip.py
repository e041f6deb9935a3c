"""BitFlip (Diuk, Strehl and Littman 2006) on a wall: a binary counter's worth of order.

Bit i can be flipped only while all lower bits are on; flipped too early, it and all lower
bits go off. All bits on open the exit. The rule is the one that public implementations of
the domain restate ("flip from left to right; the penalty is a reset of all bits to the
left"), among them that of Mehta et al. 2008 ("Automatic discovery and transfer of MAXQ
hierarchies"), whose additional parity condition on the last bit is left out. Unlike the button
puzzle it is not monotone: a press can undo many. The state is an integer whose bit i is bit i.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any

import numpy as np

from hrl_escape.env.puzzles.base import Contacts, Operator, Panels, Puzzle, PuzzleConfig, SymbolicModel, register_puzzle
from hrl_escape.settings import Range

__all__ = ["BitFlipConfig", "BitFlipPuzzle"]


@dataclasses.dataclass(frozen=True)
class BitFlipConfig(PuzzleConfig):
    """Schematic of BitFlip."""

    kind = "bit-flip"
    _takes_ranges = True
    count: Annotated[int, Range(1, 64)] = 4
    """Number of bits."""
    buttons: Panels = Panels()
    """Sizes and places of the bits' panels."""

    def check(self) -> None:
        """Check what spans several fields."""
        self.buttons.check_places(self.count)

    @property
    def panels(self) -> Panels:
        """Sizes and places of the bits' panels."""
        return self.buttons

    def make_puzzle(self, rng: np.random.Generator) -> BitFlipPuzzle:
        """Nothing is random."""
        return BitFlipPuzzle(self.count)


@dataclasses.dataclass(frozen=True)
class BitFlipPuzzle(Puzzle):
    """A concrete BitFlip puzzle. Bit i is called `bit-<i+1>`."""

    kind = "bit-flip"
    count: Annotated[int, Range(1, 64)] = 1
    """Number of bits."""

    @property
    def target_names(self) -> tuple[str, ...]:
        """`bit-1` to `bit-<count>`."""
        return tuple(f"bit-{i + 1}" for i in range(self.count))

    @property
    def edges(self) -> tuple[tuple[int, int], ...]:
        """Each bit waits for the one below it (and so for all lower ones)."""
        return tuple((i, i + 1) for i in range(self.count - 1))

    @property
    def goal_targets(self) -> tuple[int, ...]:
        """All bits."""
        return tuple(range(self.count))

    @property
    def bounds(self) -> tuple[tuple[float, float], ...]:
        """Every number is 0 or 1."""
        return ((0.0, 1.0),) * self.count

    def make_state(self) -> int:
        """All bits off."""
        return 0

    def is_state(self, state: Any) -> bool:
        """Say whether a value from outside is a word of this many bits."""
        return type(state) is int and 0 <= state < 1 << self.count

    def update(self, state: int, contacts: Contacts) -> int:  # type: ignore[override]
        """Flip, or reset, for each press in index order."""
        for bit in contacts.pressed:
            lower = (1 << bit) - 1
            if state & lower == lower:
                state ^= 1 << bit
            else:
                state &= ~(lower | 1 << bit)
        return state

    def is_solved(self, state: int) -> bool:  # type: ignore[override]
        """All bits are on."""
        return state == (1 << self.count) - 1

    def observe(self, state: int) -> tuple[float, ...]:  # type: ignore[override]
        """One number a bit: 1 on, 0 off."""
        return tuple(float(state >> i & 1) for i in range(self.count))

    def get_lit(self, state: int) -> tuple[bool, ...]:  # type: ignore[override]
        """Bits that are on."""
        return tuple(bool(state >> i & 1) for i in range(self.count))

    def get_facts(self, state: int) -> frozenset[str]:  # type: ignore[override]
        """`on(bit-i)` for every bit that is on."""
        return frozenset(f"on({name})" for i, name in enumerate(self.target_names) if state >> i & 1)

    def make_symbolic_model(self) -> SymbolicModel:
        """Two operators a bit, to set and to clear it, applicable while all lower bits are on."""
        fact = [f"on({name})" for name in self.target_names]
        none: frozenset[str] = frozenset()
        operators = []
        for i, name in enumerate(self.target_names):
            lower, this = frozenset(fact[:i]), frozenset({fact[i]})
            operators.append(Operator(f"set-{name}", name, "press", lower, this, this, none))
            operators.append(Operator(f"clear-{name}", name, "press", lower | this, none, none, this))
        return SymbolicModel(tuple(fact), tuple(operators), frozenset(fact))


register_puzzle(BitFlipConfig, BitFlipPuzzle)
