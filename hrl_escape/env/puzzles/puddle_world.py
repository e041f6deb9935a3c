"""Puddle World (Boyan and Moore 1995; Sutton 1996): reach a corner and avoid the puddles on the way.

A primitive that ends in a puddle costs more the deeper inside it ends. The goal is a pad across the corner; the state
is 1 once the body has entered it. The published square of side 1 is 20 m wide here, centred on the room.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated

from hrl_escape.env.puzzles.base import Contacts, Puzzle, PuzzleConfig, register_puzzle
from hrl_escape.env.puzzles.mixins import Depicted
from hrl_escape.env.puzzles.places import Capsule, Pads, Place
from hrl_escape.settings import Range

PUDDLES = (Capsule(-8, 5, -1, 5, 2), Capsule(-1, -2, -1, 6, 2))
"""The published puddles of radius 0.1, from (0.1, 0.75) to (0.45, 0.75) and from (0.45, 0.4) to (0.45, 0.8)."""
CORNER = Pads(3, 1.5, (Place(9 + 0.75 * 0.5**0.5 - 1e-6, 9 + 0.75 * 0.5**0.5 - 1e-6, -45),))
"""The published goal, x + y >= 1.9, widened by a micrometre to include points on its edge."""

Cost = Annotated[float, Range(0, 1_000, "1/m")]


@dataclasses.dataclass(frozen=True)
class PuddleWorldConfig(PuzzleConfig):
    """Configuration of Puddle World."""

    kind = "puddle-world"
    areas: tuple[Capsule, ...] = PUDDLES
    """Puddles; where they overlap, the deepest counts."""
    cost: Cost = 20.0
    """Cost of a primitive that ends in a puddle, per metre of depth. Higher costs make detours worthwhile."""
    goal: Pads = CORNER
    """Size and place of the goal."""


@dataclasses.dataclass(frozen=True)
class PuddleWorldPuzzle(Depicted, Puzzle):
    """Concrete puddles; the only target is the pad `goal`."""

    kind = "puddle-world"
    fixed_names = ("goal",)
    are_pads = True
    areas: tuple[Capsule, ...] = PUDDLES
    """Puddles; where they overlap, the deepest counts."""
    cost: Cost = 20.0
    """Cost of a primitive that ends in a puddle, per metre of depth inside its edge."""

    @property
    def puddles(self) -> tuple[Capsule, ...]:
        """Puddles on the floor, for drawings."""
        return self.areas

    @property
    def is_watching(self) -> bool:
        """True: every primitive can end in a puddle."""
        return True

    def update(self, state: int, contacts: Contacts) -> int:
        """Return 1 once the body has entered the goal's pad, otherwise 0."""
        return int(state or bool(contacts.pressed))

    def compute_reward(self, before: int, after: int, contacts: Contacts) -> float:
        """Return the negative cost of the deepest puddle at the place where the primitive ended."""
        deepest = 0.0
        for area in self.areas:
            depth = area.compute_depth(contacts.x, contacts.y)
            if depth > deepest:
                deepest = depth
        return -self.cost * deepest

    def is_solved(self, state: int) -> bool:
        """Return whether the body has entered the goal."""
        return state == 1

    def get_lit(self, state: int) -> tuple[bool, ...]:
        """Return whether the goal is lit: once the body has entered it."""
        return (state == 1,)


register_puzzle(PuddleWorldConfig, PuddleWorldPuzzle)
