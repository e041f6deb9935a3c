"""Towers of Hanoi on three panels: a press lifts the top disc of a peg, the next press puts it down.

A press that would put a larger disc onto a smaller one has no effect. All discs on the last peg open the exit, which
takes at least 2^n - 1 moves of two presses each. The state is a word of four bits per disc: on peg 1, 2, 3, or in the
hand. Disc 0 is the smallest.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any

from hrl_escape.env.puzzles.base import Contacts, Panels, Puzzle, PuzzleConfig, register_puzzle
from hrl_escape.env.puzzles.mixins import Graphed
from hrl_escape.env.puzzles.symbolic import Modelled, Operator, SymbolicModel
from hrl_escape.settings import Range

PEGS = 3
HAND = PEGS
"""Place of the lifted disc; pegs are places 0 to 2."""


@dataclasses.dataclass(frozen=True)
class HanoiConfig(PuzzleConfig):
    """Configuration of the Towers of Hanoi."""

    kind = "hanoi"
    discs: Annotated[int, Range(1, 8)] = 3
    """Number of discs of different sizes. Each additional disc doubles the number of moves."""
    buttons: Panels = Panels(width=1.5)
    """Sizes and places of the pegs' panels."""


@dataclasses.dataclass(frozen=True)
class HanoiPuzzle(Graphed, Modelled, Puzzle):
    """A concrete puzzle. Pegs are named `peg-1` to `peg-3`; all discs begin on the first."""

    kind = "hanoi"
    fixed_names = tuple(f"peg-{i + 1}" for i in range(PEGS))
    discs: Annotated[int, Range(1, 8)] = 1
    """Number of discs of different sizes."""

    @property
    def goal_targets(self) -> tuple[int, ...]:
        """Index of the last peg, as a tuple of one; all discs must end there."""
        return (PEGS - 1,)

    def encode(self, places: tuple[int, ...]) -> int:
        """Return the state for the place of each disc, smallest first: a peg from 0, or `HAND`."""
        return sum(1 << 4 * disc + place for disc, place in enumerate(places))

    def decode(self, state: int) -> tuple[int, ...]:
        """Return the place of each disc, smallest first."""
        return tuple((state >> 4 * disc & 15).bit_length() - 1 for disc in range(self.discs))

    def make_state(self) -> int:
        """Return the state with all discs on the first peg."""
        return self.encode((0,) * self.discs)

    def is_state(self, state: Any) -> bool:
        """Return whether an untrusted value is a state: one place per disc, and at most one disc in the hand."""
        if type(state) is not int or not 0 <= state < 1 << 4 * self.discs:
            return False
        places = self.decode(state)
        return -1 not in places and self.encode(places) == state and places.count(HAND) <= 1

    def update(self, state: int, contacts: Contacts) -> int:
        """Apply presses in index order: lift a disc, or put the lifted disc down."""
        for peg in contacts.pressed:
            places = self.decode(state)
            top = places.index(peg) if peg in places else self.discs
            held = places.index(HAND) if HAND in places else self.discs
            if held < top:
                state ^= 1 << 4 * held + HAND | 1 << 4 * held + peg
            elif held == self.discs and top < self.discs:
                state ^= 1 << 4 * top + HAND | 1 << 4 * top + peg
        return state

    def is_solved(self, state: int) -> bool:
        """Return whether all discs are on the last peg."""
        return state == self.encode((PEGS - 1,) * self.discs)

    def observe(self, state: int) -> tuple[float, ...]:
        """Return four numbers per disc, smallest first: 1 for its place, on peg 1, 2, 3 or in the hand."""
        return tuple(float(state >> i & 1) for i in range(4 * self.discs))

    def get_lit(self, state: int) -> tuple[bool, ...]:
        """Return whether each peg holds all discs."""
        return tuple(state == self.encode((peg,) * self.discs) for peg in range(PEGS))

    def get_facts(self, state: int) -> frozenset[str]:
        """Return `at(disc-i,peg-j)` or `held(disc-i)` for every disc."""
        return frozenset(self._list_facts(disc)[place] for disc, place in enumerate(self.decode(state)))

    def _list_facts(self, disc: int) -> list[str]:
        return [*(f"at(disc-{disc + 1},{peg})" for peg in self.target_names), f"held(disc-{disc + 1})"]

    def make_symbolic_model(self) -> SymbolicModel:
        """Return the model: two operators per disc and peg, to lift it and to put it down under no smaller disc."""
        facts = [self._list_facts(disc) for disc in range(self.discs)]
        hands = frozenset(names[HAND] for names in facts)
        operators = []
        for disc, names in enumerate(facts):
            for peg, target in enumerate(self.target_names):
                smaller = frozenset(facts[other][peg] for other in range(disc))
                here, held = frozenset({names[peg]}), frozenset({names[HAND]})
                operators.append(Operator(f"lift-disc-{disc + 1}-from-{target}", target, "press", here, smaller | hands,
                                          held, here))
                operators.append(Operator(f"put-disc-{disc + 1}-on-{target}", target, "press", held, smaller,
                                          here, held))
        goal = frozenset(names[PEGS - 1] for names in facts)
        return SymbolicModel(tuple(fact for names in facts for fact in names), tuple(operators), goal)


register_puzzle(HanoiConfig, HanoiPuzzle)
