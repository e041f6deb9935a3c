"""Sections: where a button hangs tells of the hidden graph, by a ranking of directions that all rooms share.

The floor is cut into equal sections around the room's middle, and the schematic ranks them. Buttons that must wait for
more others hang in sections of higher rank, and within one section further counter-clockwise. Which sections come first
follows no rule, so it can be learned in some rooms and used in others. Nothing is drawn but which button hangs where:
the places themselves are those of a room without sections.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hrl_escape.env.schema import Schematic
from hrl_escape.settings import Range


@dataclasses.dataclass(frozen=True)
class SectionsConfig(Schematic):
    """Ranking of the directions from a room's middle by which its buttons are hung."""

    _section = "sections"
    count: Annotated[int, Range(0, 64)] = 0
    """Equal sections around the middle, counter-clockwise from the right (0: places tell nothing of the graph)."""
    code: Annotated[int, Range(0, 2**63 - 1)] = 0
    """Seed of the ranking."""

    @cached_property
    def ranks(self) -> NDArray[np.int64]:
        """Rank of each section, (sections,)."""
        return np.random.default_rng([self.code, 5]).permutation(self.count)

    def sort_places(self, places: ArrayLike) -> NDArray[np.int64]:
        """Numbers of places (n, 2), m from the room's middle, in the order in which the buttons there come."""
        x, y = np.asarray(places, dtype=np.float64).T
        turns = np.arctan2(y, x) % math.tau / math.tau * self.count
        return np.lexsort((turns, self.ranks[np.minimum(turns.astype(np.int64), self.count - 1)]))

    def deal(self, places: ArrayLike, depths: Sequence[int], rng: np.random.Generator) -> NDArray[np.int64]:
        """Number of the place of each button; buttons that are equally deep are dealt at random."""
        dealt = np.empty(len(depths), dtype=np.int64)
        dealt[np.lexsort((rng.random(len(depths)), np.array(depths)))] = self.sort_places(places)
        return dealt

    def compute_likelihood(self, places: ArrayLike, depths: NDArray[np.int64]) -> NDArray[np.float64]:
        """Probability that buttons were dealt to the places where they hang, under each of several graphs.

        Args:
            places: of the buttons, (buttons, 2).
            depths: of each button under each graph, (graphs, buttons).

        Returns:
            float64 (graphs,); all 1 without sections.
        """
        if not self.count:
            return np.ones(len(depths))
        ways = np.array([math.prod(map(math.factorial, np.bincount(own).tolist())) for own in depths])
        return (np.diff(depths[:, self.sort_places(places)], axis=1) >= 0).all(axis=1) / ways
