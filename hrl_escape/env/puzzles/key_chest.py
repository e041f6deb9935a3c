"""Key-Chest (Zhang et al. 2020, HRAC): walk over the key, which earns 1, then to the chest, which opens the exit.

Both are pads on the floor. Without the key the chest is inert. The state is 0, 1 with the key, 2 with the chest open.
"""

from __future__ import annotations

import dataclasses

from hrl_escape.env.puzzles.base import Contacts, Pads, PuzzleConfig, register_puzzle
from hrl_escape.env.puzzles.codes import CodePuzzle

THINGS = ("key", "chest")
"""Names of the pads, in their order."""


@dataclasses.dataclass(frozen=True)
class KeyChestConfig(PuzzleConfig):
    """Schematic of Key-Chest, whose key and chest are pads."""

    kind = "key-chest"
    floor: Pads = Pads()
    """Size and places of key and chest."""


@dataclasses.dataclass(frozen=True)
class KeyChestPuzzle(CodePuzzle):
    """Concrete rules; the pads are called `key` and `chest`."""

    kind = "key-chest"
    are_pads = True
    code = tuple(range(len(THINGS)))

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of the two pads, `key` and `chest`."""
        return THINGS

    def update(self, state: int, contacts: Contacts) -> int:
        """Take the key on its pad; open the chest with it."""
        for pad in contacts.pressed:
            state += pad == state
        return state

    def compute_reward(self, before: int, after: int, contacts: Contacts) -> float:
        """Reward of 1 for taking the key."""
        return float(before == 0 < after)

    def observe(self, state: int) -> tuple[float, ...]:
        """Two numbers: 1 with the key, 1 with the chest open."""
        return tuple(float(state > pad) for pad in self.code)

    def get_lit(self, state: int) -> tuple[bool, ...]:
        """Lit pads: the key once it is taken, the chest once it is open."""
        return tuple(state > pad for pad in self.code)


register_puzzle(KeyChestConfig, KeyChestPuzzle)
