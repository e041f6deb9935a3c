"""Evidence of presses on a graph of buttons: edges that follow from it, and those that still may be there.

A button that goes on shows that all its parents were on; one that stays off, that a parent was off. Only buttons whose
presses say no more than that are reasoned about: none that can be turned off, and none that locks another.
"""

from __future__ import annotations

from collections.abc import Collection

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.viewer.step_hooks import PrimitiveStep


class PressEvidence:
    """Evidence from the presses in one room, over all its episodes.

    Args:
        instance: the room.
    """

    def __init__(self, instance: RoomInstance) -> None:
        self._puzzle = instance.puzzle
        self._possible: dict[int, frozenset[int]] = {}
        self._failed: dict[int, set[frozenset[int]]] = {}

    def note(self, step: PrimitiveStep) -> None:
        """Take note of the presses of a primitive."""
        before, after = (self._puzzle.get_lit(state.puzzle) for state in (step.before, step.after))
        lit = frozenset(i for i, on in enumerate(before) if on)
        for target in step.pressed:
            if before[target]:
                continue
            if after[target]:
                self._possible[target] = self._possible.get(target, lit) & lit
            else:
                self._failed.setdefault(target, set()).add(lit)

    def list_edges(self) -> tuple[Collection[tuple[int, int]], Collection[tuple[int, int]]]:
        """Edges (parent, child) that are there for certain, and all that may be, of buttons that went on."""
        puzzle = self._puzzle
        if not isinstance(puzzle, ButtonsPuzzle) or puzzle.allow_off or puzzle.locks:
            return (), ()
        possible = {(parent, child) for child, parents in self._possible.items() for parent in parents}
        missing = [(child, self._possible.get(child, frozenset()) - lit)
                   for child, failures in self._failed.items() for lit in failures]
        return {(next(iter(lacked)), child) for child, lacked in missing if len(lacked) == 1}, possible
