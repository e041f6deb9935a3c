"""Foraging (Singh, Lewis, Barto and Sorg 2010): eat a worm at the end of a corridor; the next appears in another one.

The ends of the corridors are pads on the floor. Gripping on the pad of a worm eats it, with reward 1, and the next worm
appears at one of the other ends with equal probability. The published task never ends; here the exit opens after a
number of worms. The state is three times the number of eaten worms plus the index of the corridor with the worm.
"""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from typing import Annotated, Any

from hrl_escape.env.puzzles.base import Contacts, Puzzle, PuzzleConfig, register_puzzle
from hrl_escape.env.puzzles.places import Pads
from hrl_escape.env.puzzles.symbolic import Effect, Modelled, Operator, SymbolicModel
from hrl_escape.settings import Range

CORRIDOR_COUNT = 3
"""Number of corridors, each with a pad at its end."""

Worms = Annotated[int, Range(1, 100)]


@dataclasses.dataclass(frozen=True)
class ForagingConfig(PuzzleConfig):
    """Configuration of Foraging, with a pad at the end of each corridor."""

    kind = "foraging"
    worms: Worms = 4
    """Number of worms to eat before the exit opens."""
    ends: Pads = Pads()
    """Size and places of the corridors' ends."""


@dataclasses.dataclass(frozen=True)
class ForagingPuzzle(Modelled, Puzzle):
    """Concrete worms. The ends of the corridors are named `corridor-1` to `corridor-3`."""

    kind = "foraging"
    fixed_names = tuple(f"corridor-{i + 1}" for i in range(CORRIDOR_COUNT))
    are_pads = True
    worms: Worms = 4
    """Number of worms to eat before the exit opens."""

    @property
    def chances(self) -> tuple[float, ...]:
        """One half: the next worm appears at either of the other two ends."""
        return (0.5,)

    def list_starts(self) -> tuple[int, ...]:
        """List the initial states: the first worm in any corridor."""
        return tuple(range(CORRIDOR_COUNT))

    def is_state(self, state: Any) -> bool:
        """Return whether an untrusted value is a number of worms and a corridor."""
        return type(state) is int and 0 <= state < CORRIDOR_COUNT * (self.worms + 1)

    def update(self, state: int, contacts: Contacts) -> int:
        """Eat the worm if a grip touches its pad; the next worm appears at one of the other two ends."""
        eaten, place = divmod(state, CORRIDOR_COUNT)
        if contacts.grip <= 0 or place not in contacts.touching or eaten == self.worms:
            return state
        return (eaten + 1) * CORRIDOR_COUNT + (place + (1 if contacts.uniform < 0.5 else 2)) % CORRIDOR_COUNT

    def compute_reward(self, before: int, after: int, contacts: Contacts) -> float:
        """Return 1 for an eaten worm, otherwise 0."""
        return float(after != before)

    def is_solved(self, state: int) -> bool:
        """Return whether all worms were eaten."""
        return state // CORRIDOR_COUNT == self.worms

    def compute_progress(self, state: int) -> float:
        """Return the fraction, in [0, 1], of the worms that were eaten."""
        return state // CORRIDOR_COUNT / self.worms

    def observe(self, state: int) -> tuple[float, ...]:
        """Return one number per corridor, 1 for the worm's, and the fraction of worms that were eaten."""
        return (*(float(state % CORRIDOR_COUNT == i) for i in range(CORRIDOR_COUNT)), self.compute_progress(state))

    def get_lit(self, state: int) -> tuple[bool, ...]:
        """Return whether each corridor is lit: the one with the worm."""
        return tuple(state % CORRIDOR_COUNT == i for i in range(CORRIDOR_COUNT))

    def get_facts(self, state: int) -> frozenset[str]:
        """Return `worm(corridor-i)` for the corridor with the worm, and `eaten(number)`."""
        eaten, place = divmod(state, CORRIDOR_COUNT)
        return frozenset({f"worm({self.target_names[place]})", f"eaten({eaten})"})

    def make_symbolic_model(self) -> SymbolicModel:
        """Return the model: one operator per corridor, after which the next worm appears in the following corridor."""
        worm = [frozenset({f"worm({name})"}) for name in self.target_names]
        eaten = [frozenset({f"eaten({number})"}) for number in range(self.worms + 1)]
        counts = tuple(Effect(before, add=after, delete=before) for before, after in pairwise(eaten))
        operators = tuple(Operator(f"eat-in-{name}", name, "grip", worm[i], eaten[-1], worm[(i + 1) % CORRIDOR_COUNT],
                                   worm[i], when=counts) for i, name in enumerate(self.target_names))
        return SymbolicModel(tuple(fact for facts in (*worm, *eaten) for fact in facts), operators, eaten[-1])


register_puzzle(ForagingConfig, ForagingPuzzle)
