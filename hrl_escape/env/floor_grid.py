"""The grid over a room's floor: cells and their clearances, connected parts, and waves from a goal.

Every grid over the floor is a `FloorGrid` with its own cell size: the certificate (`sampling/certificate.py`),
clearances and cost-to-go (`hrl_escape.floor`), batched options, pushes and maps of reach. This module is independent of
robots.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.geometry import Footprint, compute_distance_many, stack_footprints


def compute_extent_radius(shape: Footprint) -> float:
    """Return the radius, m, of the smallest circle around a footprint's centre that encloses it."""
    return shape.half_x if shape.is_disc else math.hypot(shape.half_x, shape.half_y)


class FloorGrid(NamedTuple):
    """Square cells over the bounding box of a floor and alcove; the index of cell (i, j) is i * rows + j."""

    low: NDArray[np.float64]  # corner with the smallest coordinates, shape (2,), m
    size: float  # side of a cell, m
    shape: tuple[int, int]  # columns and rows

    @classmethod
    def cover(cls, reach_x: float, reach_y: float, size: float) -> FloorGrid:
        """Cover the floor |x| <= reach_x, |y| <= reach_y, m."""
        columns, rows = (max(1, math.ceil(2 * reach / size)) for reach in (reach_x, reach_y))
        return cls(np.array([-reach_x, -reach_y]), size, (columns, rows))

    @property
    def cells(self) -> int:
        """Number of cells: columns times rows."""
        return self.shape[0] * self.shape[1]

    def list_cells(self, low: Any = (0, 0), high: Any = None) -> NDArray[np.int64]:
        """List the cells (n, 2) from corner `low` to corner `high` (exclusive), row-major; by default all."""
        sides = np.maximum(np.subtract(self.shape if high is None else high, low), 0)
        return np.indices(tuple(sides)).reshape(2, -1).T + np.asarray(low)

    def get_centres(self, cells: Any = None) -> NDArray[np.float64]:
        """Return the centres (n, 2) of cells (n, 2), m; by default of all, row-major."""
        cells = self.list_cells() if cells is None else np.asarray(cells)
        return np.add(self.low, (cells + 0.5) * self.size, dtype=np.float64)

    def find_number(self, x: float, y: float) -> int:
        """Return the index of the cell that contains a point; -1 outside the grid."""
        low_x, low_y = self.low.tolist()
        i, j = math.floor((x - low_x) / self.size), math.floor((y - low_y) / self.size)
        return i * self.shape[1] + j if 0 <= i < self.shape[0] and 0 <= j < self.shape[1] else -1

    def find_numbers(self, points: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the indices of the cells that contain points (..., 2); -1 outside the grid."""
        i, j = np.moveaxis(np.floor((points - self.low) / self.size).astype(int), -1, 0)
        inside = (i >= 0) & (i < self.shape[0]) & (j >= 0) & (j < self.shape[1])
        return np.where(inside, i * self.shape[1] + j, -1)

    def find_window(self, shape: Footprint, around: float) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
        """Return the corners (first cell, end cell) of a window with all cells within `around` m of a footprint.

        The distance is measured to the centres of cells.
        """
        middle, extent = np.array([shape.x, shape.y]), compute_extent_radius(shape) + around
        low = np.maximum(np.floor((middle - extent - self.low) / self.size).astype(int), 0)
        high = np.minimum(np.floor((middle + extent - self.low) / self.size).astype(int) + 1, self.shape)
        return low, np.maximum(low, high)

    def measure(self, shape: Footprint, around: float, within: tuple[Any, Any] | None = None
                ) -> tuple[tuple[slice, slice], NDArray[np.float64]]:
        """Compute the distances, m, from a footprint to the centres of all cells that can be within `around` of it.

        Returns the window of these cells, as an index into arrays of the grid's shape, clipped to the corners `within`,
        and the distances.
        """
        low, high = self.find_window(shape, around)
        if within is not None:
            low, high = np.maximum(low, within[0]), np.minimum(high, within[1])
        sides = np.maximum(high - low, 0)
        away = np.zeros(sides)
        if away.size:
            centres = self.get_centres(self.list_cells(low, high))
            away = compute_distance_many(centres, stack_footprints([shape])).reshape(sides)
        return (slice(low[0], low[0] + sides[0]), slice(low[1], low[1] + sides[1])), away


def label_parts(free: NDArray[np.bool_], corners: bool) -> NDArray[np.int32]:
    """Number the connected parts of free cells (columns, rows) from 1; 0 elsewhere. `corners` connects diagonally."""
    columns, rows = np.flatnonzero(free.any(axis=1)), np.flatnonzero(free.any(axis=0))
    if len(columns) and free[columns[0] : columns[-1] + 1, rows[0] : rows[-1] + 1].all():
        return free.astype(np.int32)  # an empty room: one rectangle
    runs = _list_runs(free)
    parent = list(range(len(runs)))

    def find_root(run: int) -> int:
        while parent[run] != run:
            parent[run] = run = parent[parent[run]]
        return run

    before = 0  # the first run of the last column that may meet this run or a later one
    for run, (column, low, high) in enumerate(runs):
        while runs[before][0] < column - 1 or (runs[before][0] == column - 1 and runs[before][2] + corners <= low):
            before += 1
        other = before
        while runs[other][0] == column - 1 and runs[other][1] < high + corners:
            one, two = sorted((find_root(other), find_root(run)))
            parent[two] = one
            other += 1
    labels = np.zeros(free.shape, dtype=np.int32)
    numbers = dict[int, int]()
    for run, (column, low, high) in enumerate(runs):
        labels[column, low:high] = numbers.setdefault(find_root(run), len(numbers) + 1)
    return labels


def _list_runs(free: NDArray[np.bool_]) -> list[tuple[int, int, int]]:
    """List the runs of free cells in each column: the column, the first row and the row after the last."""
    edges = np.diff(np.pad(free, ((0, 0), (1, 1))).view(np.int8), axis=1)
    columns, low = np.nonzero(edges > 0)
    return list(zip(columns.tolist(), low.tolist(), np.nonzero(edges < 0)[1].tolist(), strict=True))


def coarsen(free: NDArray[np.bool_], stride: int) -> NDArray[np.bool_]:
    """Return the blocks of `stride` by `stride` cells that contain a free cell."""
    columns, rows = (-(-side // stride) * stride for side in free.shape)
    whole = np.zeros((columns, rows), dtype=bool)
    whole[: free.shape[0], : free.shape[1]] = free
    return np.any(whole.reshape(columns // stride, stride, rows // stride, stride), axis=(1, 3))


def spread_waves(free: NDArray[np.bool_], seeds: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the fewest moves between neighbouring free cells from any seed to each cell; infinity if unreachable.

    Args:
        free: cells that moves may enter, bool (columns, rows).
        seeds: cells at 0 moves, bool (columns, rows).
    """
    left, waves = np.pad(free & ~seeds, 1), np.full((free.shape[0] + 2, free.shape[1] + 2), np.inf)
    waves[1:-1, 1:-1][seeds] = 0.0
    front, count = np.flatnonzero(np.pad(seeds & free, 1)), 0
    neighbours = np.array([[left.shape[1]], [-left.shape[1]], [1], [-1]])
    while front.size:
        count += 1
        reached = (front + neighbours).ravel()
        front = np.unique(reached[left.ravel()[reached]])
        left.ravel()[front], waves.ravel()[front] = False, count
    return waves[1:-1, 1:-1]
