"""Puzzles whose state is a word of bits, one a target: bit i is 1 while target i is on."""

from __future__ import annotations

from typing import Any

from hrl_escape.env.puzzles.base import Puzzle

__all__ = ["BitPuzzle"]


class BitPuzzle(Puzzle):
    """Base of such puzzles: a subclass gives names, rules, the symbolic model, and `count` as a field."""

    count: int
    """Number of targets."""

    @property
    def bounds(self) -> tuple[tuple[float, float], ...]:
        """Every number is 0 or 1."""
        return ((0.0, 1.0),) * self.count

    def make_state(self) -> int:
        """All targets off."""
        return 0

    def is_state(self, state: Any) -> bool:
        """Say whether a value from outside is a word of this many bits."""
        return type(state) is int and 0 <= state < 1 << self.count

    def observe(self, state: int) -> tuple[float, ...]:
        """One number a target: 1 on, 0 off."""
        return tuple(float(state >> i & 1) for i in range(self.count))

    def get_lit(self, state: int) -> tuple[bool, ...]:
        """Targets that are on."""
        return tuple(bool(state >> i & 1) for i in range(self.count))

    def get_facts(self, state: int) -> frozenset[str]:
        """`on(<name>)` for every target that is on."""
        return frozenset(f"on({name})" for i, name in enumerate(self.target_names) if state >> i & 1)
