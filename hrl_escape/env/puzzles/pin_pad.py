"""Pin Pad (Director, Hafner et al. 2022): walk over the pads on the floor in the order of a hidden code.

The exit opens once the last pads stepped on, one after another, are the code; stepping on the same pad again counts
once. Two pads are a key and its chest, as in the mazes of HRAC (Zhang et al. 2020); one is a place to go to. The state
is the number of pads of the code walked over: the longest beginning of it with which the walk ends.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated

import numpy as np

from hrl_escape.env.puzzles.base import Contacts, Pads, PuzzleConfig, register_puzzle
from hrl_escape.env.puzzles.codes import CodePuzzle
from hrl_escape.errors import ConfigError
from hrl_escape.settings import Range


@dataclasses.dataclass(frozen=True)
class PinPadConfig(PuzzleConfig):
    """Schematic of Pin Pad; the instance seed draws the order of the pads."""

    kind = "pin-pad"
    count: Annotated[int, Range(1, 8)] = 4
    """Number of pads, all of them in the code."""
    floor: Pads = Pads()
    """Size and places of the pads."""

    def make_puzzle(self, rng: np.random.Generator) -> PinPadPuzzle:
        """Draw the order of the pads."""
        return PinPadPuzzle(tuple(rng.permutation(self.count).tolist()))


@dataclasses.dataclass(frozen=True)
class PinPadPuzzle(CodePuzzle):
    """A concrete walk. Pad i is called `pad-<i+1>`."""

    kind = "pin-pad"
    are_pads = True
    code: tuple[Annotated[int, Range(0, 7)], ...] = (0, 1)
    """Numbers of the pads in order, each of them once."""

    def check(self) -> None:
        """Check that every pad comes once."""
        if not self.code or sorted(self.code) != list(range(len(self.code))):
            raise ConfigError("puzzle.code", self.code, "an order of 1 to 8 pads")

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of the pads, `pad-1` to `pad-<count>`."""
        return tuple(f"pad-{i + 1}" for i in range(len(self.code)))

    def update(self, state: int, contacts: Contacts) -> int:
        """Enter each pad stepped on, in index order; an open exit stays open."""
        for pad in contacts.pressed:
            if state < len(self.code) and not (state and pad == self.code[state - 1]):
                state = state + 1 if pad == self.code[state] else int(pad == self.code[0])
        return state

    def observe(self, state: int) -> tuple[float, ...]:
        """One number a pad: 1 while it counts as walked over."""
        counted = self.code[:state]
        return tuple(float(pad in counted) for pad in range(len(self.code)))

    def get_lit(self, state: int) -> tuple[bool, ...]:
        """Return for each pad whether it counts: it is in the part of the code walked over so far."""
        return tuple(pad in self.code[:state] for pad in range(len(self.code)))


register_puzzle(PinPadConfig, PinPadPuzzle)
