"""Divisions of the state space: landmarks with their regions, and trees of cells within cells.

HDG walks from landmark to landmark; feudal learning commands from cell to cell. What a state is, or
where it lies, a user says by a function of the observation.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any

from hrl_escape.errors import AgentSettingsError

DIRECTIONS = ((-1, 0), (1, 0), (0, -1), (0, 1))
"""North, south, west, east: how row and column change."""


@dataclass(frozen=True)
class Landmarks:
    """States that stand for the region around them."""

    states: tuple[Hashable, ...]  # the landmarks' states
    region: Callable[[Hashable], int]  # state -> number of the landmark whose region it lies in
    state: Callable[[Any], Hashable] = int  # observation -> state; the observation itself by default

    def __post_init__(self) -> None:
        for number, state in enumerate(self.states):
            if self.region(state) != number:
                raise AgentSettingsError("Landmarks.region", state, f"{number}, its own region, for landmark {number}")


@dataclass(frozen=True)
class Quadtree:
    """A square that is cut into four at every level: at level n into 2^n x 2^n cells."""

    depth: int  # finest level; level 0 is the whole square
    place: Callable[[Any], tuple[float, float]]
    """Observation -> (row, column) in the square, each from 0 up to but not including 1."""
    phase: Callable[[Any], tuple[int, ...]] | None = None
    """Observation -> what every manager sees beside its cell, as numbers; nothing by default."""
    has_found: Callable[[Any, Any], bool] | None = None
    """(observation at the order, observation) -> whether a search has found what it was for; by default only the end of
    the episode is that."""
    policy: Callable[[Any, tuple[int, int], int], int | None] | None = None
    """(observation, cell, order) -> the primitive by which the last level obeys an order about a cell of the finest
    level, None where none does; by default that is learned."""

    def __post_init__(self) -> None:
        if self.depth < 0:
            raise AgentSettingsError("Quadtree.depth", self.depth, "0 or more")

    def find_cell(self, observation: Any, level: int) -> tuple[int, int]:
        """Row and column of the cell of a level that an observation lies in.

        Raises:
            AgentSettingsError: `place` leads out of the square.
        """
        place = self.place(observation)
        if not all(0 <= coordinate < 1 for coordinate in place):
            raise AgentSettingsError("Quadtree.place", place, "a row and a column from 0 up to but not including 1")
        row, column = (int(coordinate * 2**level) for coordinate in place)
        return row, column

    def has_neighbour(self, cell: tuple[int, int], level: int, direction: int) -> bool:
        """The cell next to a cell in a direction lies in the square."""
        return all(0 <= here + step < 2**level for here, step in zip(cell, DIRECTIONS[direction], strict=True))
