"""Tasks of a feudal hierarchy: managers of ever finer cells, who are paid for obeying, not for succeeding.

Dayan and Hinton (1993). A manager sees the cell of its level that the agent is in, and orders its
sub-manager to leave that cell in a direction, or to search inside.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.hierarchy.regions import DIRECTIONS, Quadtree
from hrl_escape.agents.hierarchy.task import BaseTask, Call, Frame, Hierarchy, Seen, Stack, Step

__all__ = ["SEARCH", "FeudalTask", "make_feudal_hierarchy"]

SEARCH = len(DIRECTIONS)
"""The command to search inside the cell; commands below it are directions."""


ORDER_NAMES = ("north", "south", "west", "east", "search")
"""Names of the commands."""


class FeudalTask(BaseTask):
    """The manager of one level; the last one chooses primitives.

    A call is an order from the level above, about the cell of that level in which it is given: the cell to be left, or
    to be searched. The root has no order and is paid by the environment.

    Args:
        tree: the division.
        level: of the cells that it sees and gives orders about; below the tree's depth it sees the observation and
            chooses primitives.
        primitives: of the environment.
        penalty: what leaving the cell other than ordered costs.
        patience: primitives after which an order to the last level is given up, and twice as many a level higher; 0
            never gives up.
    """

    def __init__(self, tree: Quadtree, level: int, primitives: int, penalty: float, patience: int) -> None:
        self.tree, self.level = tree, level
        self.is_last = level > tree.depth
        super().__init__(f"level {level}", primitives if self.is_last else SEARCH + 1)
        self._penalty, self._patience = penalty, patience * 2 ** (tree.depth + 1 - level)
        self.below: FeudalTask | None = None

    def view(self, seen: Seen, stack: Stack) -> Any:
        """The cell of its level, row and column; the last level sees the observation."""
        return seen.observation if self.is_last else np.array(self.tree.find_cell(seen.observation, self.level))

    def legal(self, seen: Seen, context: Any) -> NDArray[np.bool_]:
        """Directions that do not lead out of the square, and the search; primitives on the last level."""
        if self.is_last:
            return seen.mask
        cell = self.tree.find_cell(seen.observation, self.level)
        inside = [self.tree.has_neighbour(cell, self.level, direction) for direction in range(SEARCH)]
        return np.array([*inside, True], np.bool_)

    def decode(self, choice: int, seen: Seen, context: Any) -> Call:
        """The order to the level below; a primitive on the last level."""
        return Call(choice) if self.below is None else Call(self.below, int(choice))

    def list_calls(self) -> Mapping[str, Any]:
        """One an order."""
        return {f"{self.name} {order}": number for number, order in enumerate(ORDER_NAMES)}

    def find_exit(self, frame: Frame, seen: Seen) -> tuple[int, int] | None:
        """Row and column by which the call's cell was left; None inside it."""
        if frame.context is None:
            return None
        (top, left), (row, column) = (self.tree.find_cell(each.observation, self.level - 1)
                                      for each in (frame.start, seen))  # fmt: skip
        return None if (top, left) == (row, column) else (row - top, column - left)

    def ends(self, frame: Frame, seen: Seen) -> float:
        """Certain where the cell is left, in whatever direction, or patience has run out."""
        given_up = frame.context is not None and 0 < self._patience <= frame.primitives
        return float(given_up or self.find_exit(frame, seen) is not None)

    def pay(self, step: Step, frame: Frame) -> float:
        """1 for leaving as ordered, or for the end of the episode during a search; the penalty for leaving else."""
        if frame.context is None:
            return step.reward
        way = self.find_exit(frame, step.next_seen)
        if way is not None:
            was_ordered = frame.context < SEARCH and way == DIRECTIONS[frame.context]
            return 1.0 if was_ordered else -self._penalty
        return float(frame.context == SEARCH and step.terminated)


def make_feudal_hierarchy(tree: Quadtree, primitives: int, penalty: float, patience: int) -> Hierarchy:
    """Managers of the levels 1 to the tree's depth, and one of primitives below."""
    levels = [FeudalTask(tree, level, primitives, penalty, patience) for level in range(1, tree.depth + 2)]
    for above, below in zip(levels, levels[1:], strict=False):
        above.below = below
    root, *others = levels
    return Hierarchy(root, tuple(others), privileges=("cells",) if tree.depth else ())
