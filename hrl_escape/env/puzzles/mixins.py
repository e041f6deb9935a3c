"""Mixins that some puzzles have besides their rules: a graph, signs, marks, doors, a map, things to push.

A puzzle declares a mixin as a base class, `class Sokoban(Pushing, Puzzle)`. The defaults of each mixin are those
of a puzzle without it: `get_mixin(puzzle, Graphed).edges` is empty for a puzzle that is not `Graphed`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from hrl_escape.env.puzzles.places import Capsule, Prop
from hrl_escape.errors import UnsupportedError

Mixin = TypeVar("Mixin")


def get_mixin(puzzle: object, mixin: type[Mixin]) -> Mixin:
    """Return the puzzle itself if it has a mixin, else an empty instance of the mixin."""
    return puzzle if isinstance(puzzle, mixin) else mixin()


class Graphed:
    """Mixin: targets depend on each other; for drawings, reports and learners' graphs, not for planners."""

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
    """Mixin: drawings show more of the puzzle than names and lights."""

    @property
    def puddles(self) -> tuple[Capsule, ...]:
        """Regions of the floor that the rules refer to, for drawings."""
        return ()

    def get_sign(self, state: Any, target: int) -> str:
        """Text that drawings show at a target besides its name, such as its stock; empty for none."""
        return ""


class Marked:
    """Mixin: targets bear symbols that agents see, and that change no rule; see `marks.py`."""

    marks: tuple[int, ...] = ()
    """Number of the symbol on each target; none where targets bear no marks."""


class Barring:
    """Mixin: the state decides which of the room's inner doors, or things in cells, block the way."""

    def get_shut(self, state: Any) -> int:
        """Bits of the inner doors that are shut."""
        return 0


class Doored(Barring):
    """Mixin of a `Modelled` puzzle without a map: doors between rooms open with its facts, and stay open."""

    get_facts: Callable[[Any], frozenset[str]]

    @property
    def door_facts(self) -> tuple[str, ...]:
        """For each door, the fact of the symbolic model that opens it for good."""
        return ()

    def get_shut(self, state: Any) -> int:
        """Bits of the doors whose fact does not hold."""
        facts = self.get_facts(state) if self.door_facts else frozenset[str]()
        return sum(1 << door for door, fact in enumerate(self.door_facts) if fact not in facts)


class Mapped(Barring):
    """Mixin: the puzzle draws the map of its grid world, see `maps.py`; cells are numbered row by row."""

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
    """Mixin: a move into a blocked cell calls `update` with `PUSH`, and goes ahead if that frees the cell."""


class Propped:
    """Mixin: props stand on the floor, and physics moves them."""

    @property
    def props(self) -> tuple[Prop, ...]:
        """Props that the room must place."""
        return ()

    def with_props(self, props: tuple[Prop, ...]) -> Any:
        """The same puzzle with other props on the floor.

        Raises:
            ConfigError: the puzzle cannot be one with these.
            UnsupportedError: nothing stands on this puzzle's floor.
        """
        raise UnsupportedError("this puzzle has no blocks or plates; push-block has")
