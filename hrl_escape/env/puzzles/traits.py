"""Traits that some puzzles have besides their rules: a graph, signs, doors, a map, things to push.

A puzzle has a trait by naming it among its bases, `class Sokoban(Pushing, Puzzle)`. Each trait, as it stands, is that
of a puzzle without: `get_trait(puzzle, Graphed).edges` is empty for a puzzle that is not `Graphed`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from hrl_escape.env.puzzles.places import Capsule, Prop
from hrl_escape.errors import UnsupportedError

__all__ = ["Barring", "Depicted", "Doored", "Graphed", "Mapped", "Propped", "Pushing", "get_trait"]

Trait = TypeVar("Trait")


def get_trait(puzzle: object, trait: type[Trait]) -> Trait:
    """The puzzle itself where it has a trait, else one without anything of it."""
    return puzzle if isinstance(puzzle, trait) else trait()


class Graphed:
    """Targets depend on each other; for drawings, reports and learners' graphs, and not for planners."""

    @property
    def edges(self) -> tuple[tuple[int, int], ...]:
        """Dependencies (parent, child) between targets."""
        return ()

    @property
    def locks_between(self) -> tuple[tuple[int, int], ...]:
        """Pairs (a, b) of targets of which a, once it is on, keeps b from being turned on."""
        return ()

    @property
    def goal_targets(self) -> tuple[int, ...]:
        """Targets that must be on in the end."""
        return ()


class Depicted:
    """Drawings show more of the puzzle than names and lights."""

    @property
    def puddles(self) -> tuple[Capsule, ...]:
        """Stretches of floor that the rules speak of."""
        return ()

    def get_sign(self, state: Any, target: int) -> str:
        """Text that a target shows to people besides its name, such as what lies there; empty for none."""
        return ""


class Barring:
    """The state says which of the room's inner doors, or things in cells, bar the way."""

    def get_shut(self, state: Any) -> int:
        """Bits of the inner doors that are shut."""
        return 0


class Doored(Barring):
    """Doors between rooms open as the puzzle, which is `Modelled`, goes on, and stay open; for those without a map."""

    get_facts: Callable[[Any], frozenset[str]]

    @property
    def door_facts(self) -> tuple[str, ...]:
        """Fact of the symbolic model from which each door is open, for good."""
        return ()

    def get_shut(self, state: Any) -> int:
        """Bits of the doors whose fact does not hold."""
        facts = self.get_facts(state) if self.door_facts else frozenset[str]()
        return sum(1 << door for door, fact in enumerate(self.door_facts) if fact not in facts)


class Mapped(Barring):
    """The puzzle draws the map of its grid world, see `maps.py`; its cells are numbered row by row."""

    @property
    def map_rows(self) -> tuple[str, ...]:
        """Rows of the map."""
        return ()

    @property
    def target_cells(self) -> tuple[int, ...]:
        """Cell of each target."""
        return ()

    @property
    def blockable_cells(self) -> tuple[int, ...]:
        """Cells that can be blocked, by doors or things: the room's inner doors, in order."""
        return ()

    def list_cells(self, state: Any, action: str, target: int) -> tuple[int, ...]:
        """Numbers of the inner doors' cells in which an action at a target can be carried out now."""
        return ()


class Pushing(Mapped):
    """A move into a cell that is blocked calls `update` with `PUSH`, and goes ahead if that frees the cell."""


class Propped:
    """Things stand on the floor, and physics moves them."""

    @property
    def props(self) -> tuple[Prop, ...]:
        """Things that the room must place."""
        return ()

    def with_props(self, props: tuple[Prop, ...]) -> Any:
        """The same puzzle with other things on the floor.

        Raises:
            ConfigError: the puzzle cannot be one with these.
            UnsupportedError: nothing stands on this puzzle's floor.
        """
        raise UnsupportedError("this puzzle has no blocks or plates; push-block has")
