"""Mixins for puzzles with more than rules: a graph, signs, cues, doors, a map, things to push.

A puzzle declares a mixin as a base class: `class Sokoban(Pushing, Puzzle)`. The defaults of each mixin describe a
puzzle without it: `get_mixin(puzzle, Graphed).edges` is empty for a puzzle that is not `Graphed`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from hrl_escape.env.puzzles.places import Capsule, Prop
from hrl_escape.errors import UnsupportedError

Mixin = TypeVar("Mixin")


def get_mixin(puzzle: object, mixin: type[Mixin]) -> Mixin:
    """Return the puzzle itself if it has a mixin, otherwise an instance of the mixin with its defaults."""
    return puzzle if isinstance(puzzle, mixin) else mixin()


class Graphed:
    """Mixin: targets depend on each other. Drawings, reports and learned graphs use it; planners do not."""

    @property
    def edges(self) -> tuple[tuple[int, int], ...]:
        """Dependencies (parent, child) between targets."""
        return ()

    @property
    def locks_between(self) -> tuple[tuple[int, int], ...]:
        """Pairs (a, b) of targets: once a is on, b can no longer be turned on."""
        return ()

    @property
    def goal_targets(self) -> tuple[int, ...]:
        """Targets that must be on at the end."""
        return ()


class Depicted:
    """Mixin: drawings show more of the puzzle than names and lights."""

    @property
    def puddles(self) -> tuple[Capsule, ...]:
        """Regions of the floor that the rules refer to, for drawings."""
        return ()

    def get_sign(self, state: Any, target: int) -> str:
        """Return the text that drawings add to a target's name, such as its stock; empty for none."""
        return ""


class Cued:
    """Mixin: targets carry symbols that agents observe. Symbols never change the rules; see `cues.py`."""

    cues: tuple[int, ...] = ()
    """Number of the symbol on each target; empty if targets have no cues."""


class Barring:
    """Mixin: the state decides which inner doors of the room, or things in cells, block the way."""

    def get_shut(self, state: Any) -> int:
        """Return the bits of the inner doors that are shut."""
        return 0


class Doored(Barring):
    """Mixin of a `Modelled` puzzle without a map: facts of the puzzle open doors between rooms, for good."""

    get_facts: Callable[[Any], frozenset[str]]

    @property
    def door_facts(self) -> tuple[str, ...]:
        """Fact of the symbolic model that opens each door for good."""
        return ()

    def get_shut(self, state: Any) -> int:
        """Return the bits of the doors whose fact does not hold."""
        facts = self.get_facts(state) if self.door_facts else frozenset[str]()
        return sum(1 << door for door, fact in enumerate(self.door_facts) if fact not in facts)


class Mapped(Barring):
    """Mixin: the puzzle has a map of a grid world (`maps.py`). Cells are numbered row by row."""

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
        """Return the indices of the inner doors' cells where an action at a target is possible in a state."""
        return ()


class Pushing(Mapped):
    """Mixin: a move into a blocked cell calls `update` with `PUSH`, and succeeds if that frees the cell."""


class Propped:
    """Mixin: the puzzle has props on the floor, which physics moves."""

    @property
    def props(self) -> tuple[Prop, ...]:
        """Props that the room must place."""
        return ()

    def with_props(self, props: tuple[Prop, ...]) -> Any:
        """Return the same puzzle with other props on the floor.

        Raises:
            ConfigError: the puzzle is not possible with these props.
            UnsupportedError: the puzzle has no props.
        """
        raise UnsupportedError("this puzzle has no blocks or plates; use push-block")
