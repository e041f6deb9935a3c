"""Free space of the body: a conservative grid over the floor, with exact links.

Two neighbouring free cells are joined by a straight move that exactly keeps the clearance and
some slack, so cells connected in the grid are connected in the room. Generation certifies
instances with it.

Sampling counts its operations against a budget of work, so that it ends after the same work on every machine.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.config import CONTACT_SKIN, PASSAGE_SLACK, compute_resolution
from hrl_escape.env.floor_grid import FloorGrid, label_parts
from hrl_escape.env.geometry import (
    Footprint,
    Neighbourhood,
    Solid,
    compute_distance,
    compute_distance_many,
    compute_first_contact,
)


class OutOfWork(Exception):
    """The budget is spent."""


class Work:
    """Counter of work against a limit, in units of about a microsecond on one core; `done` are spent."""

    def __init__(self, limit: float) -> None:
        self.limit, self.done = limit, 0.0

    def spend(self, units: float) -> None:
        """Charge units of work to the budget.

        Raises:
            OutOfWork: the budget is spent.
        """
        self.done += units
        if self.done > self.limit:
            raise OutOfWork


class FreeSpace:
    """Free cells of a floor for a body of a given radius.

    Attributes:
        radius: body radius plus clearance, m.
        resolution: cell size, m.
        grid: its cells.
        free: those in which the body fits, shape (columns, rows), bool.
        work: budget to which its queries are charged.
        labels: shape (columns, rows), int32; connected cells share a positive number.
    """

    def __init__(self, reach_x: float, reach_y: float, body_radius: float, solids: Sequence[Solid],
                 work: Work | None = None) -> None:
        self.radius = body_radius + CONTACT_SKIN
        self.resolution = compute_resolution(reach_x, reach_y)
        self.grid = FloorGrid.cover(reach_x, reach_y, self.resolution)
        self._low = self.grid.low
        self.footprints: list[Footprint] = []
        self.work = work or Work(math.inf)
        self.free = np.ones(self.grid.shape, dtype=bool)
        self._add(solids)

    def extend(self, solids: Sequence[Solid]) -> FreeSpace:
        """Return the floor with more solids on it; this one does not change."""
        other = copy.copy(self)
        other.free, other.footprints = self.free.copy(), list(self.footprints)
        other._add(solids)
        return other

    def _add(self, solids: Sequence[Solid]) -> None:
        for solid in solids:
            self.footprints.append(solid.footprint)
            self._carve(solid.footprint)
        self._neighbourhood = Neighbourhood(self.footprints)
        self.work.spend(self.free.size / 100)
        self.labels = label_parts(self.free, corners=False)

    def _carve(self, footprint: Footprint) -> None:
        need = self.radius + PASSAGE_SLACK + self.resolution / 2
        window, away = self.grid.measure(footprint, need)
        self.work.spend(away.size / 15)
        self.free[window] &= away >= need

    def find_cell(self, x: float, y: float) -> tuple[int, int]:
        """Cell of a place; for a place off the grid, the nearest cell at its rim."""
        i, j = int((x - self._low[0]) / self.resolution), int((y - self._low[1]) / self.resolution)
        return min(max(i, 0), self.free.shape[0] - 1), min(max(j, 0), self.free.shape[1] - 1)

    def get_cells(self, label: int) -> NDArray[np.int_]:
        """Cells (n, 2) of a connected part."""
        self.work.spend(self.free.size / 50)
        return np.argwhere(self.labels == label)

    def get_cells_near(self, label: int, x: float, y: float, distance: float) -> NDArray[np.int_]:
        """Cells (n, 2) of a connected part within a square round a place, in the order of `get_cells`."""
        low = ((np.array([x, y]) - distance - self._low) / self.resolution).astype(int) - 1
        high = ((np.array([x, y]) + distance - self._low) / self.resolution).astype(int) + 2
        low = low.clip(0)
        part = self.labels[low[0] : max(high[0], 0), low[1] : max(high[1], 0)]
        self.work.spend(part.size / 30)
        return np.argwhere(part == label) + low

    def is_clear(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return true where the body fits exactly, one value for each of the points (n, 2)."""
        if not len(points):
            return np.zeros(0, dtype=bool)
        (x, y), reach = points.mean(axis=0), np.ptp(points, axis=0)
        near = self._neighbourhood.find_near(x, y, self.radius + math.hypot(*reach))
        self.work.spend(20 + len(near) * (10 + len(points) / 20))
        return compute_distance_many(points, self._neighbourhood.shapes[near]) >= self.radius - 1e-9

    def find_labels(self, points: NDArray[np.float64]) -> NDArray[np.int32]:
        """`find_label` of many positions (n, 2); those in the middle of free cells are looked up at once."""
        cells = ((points - self._low) / self.resolution).astype(int).clip(0, np.array(self.free.shape) - 1)
        is_centre = (self.grid.get_centres(cells) == points).all(axis=1) & self.free[cells[:, 0], cells[:, 1]]
        labels = np.where(is_centre, self.labels[cells[:, 0], cells[:, 1]], 0).astype(np.int32)
        for number in np.flatnonzero(~is_centre):
            labels[number] = self.find_label(*points[number].tolist())
        return labels

    def find_label(self, x: float, y: float) -> int:
        """Part of the floor that a free position belongs to; 0 if it is not free or linked to none.

        A position is linked if a straight move that keeps the clearance leads to a free cell.
        """
        cell = self.find_link(x, y)
        return 0 if cell is None else int(self.labels[cell])

    def find_link(self, x: float, y: float) -> tuple[int, int] | None:
        """Free cell that a free position is linked to, the nearest; None if there is none."""
        self.work.spend(200)
        at = ((np.array([x, y]) - self._low) / self.resolution).astype(int)
        span = 3 + math.ceil((PASSAGE_SLACK + 0.3) / self.resolution)
        i, j = np.mgrid[at[0] - span : at[0] + span + 1, at[1] - span : at[1] + span + 1]
        cells = np.stack([i.ravel(), j.ravel()], axis=1)
        inside = ((cells >= 0) & (cells < self.free.shape)).all(axis=1)
        cells = cells[inside]
        cells = cells[self.free[cells[:, 0], cells[:, 1]]]
        moves = self.grid.get_centres(cells) - (x, y)
        lengths = np.hypot(*moves.T)
        near = self._neighbourhood.list_near(x, y, self.radius + lengths.max(initial=0.0))
        if not len(cells) or any(compute_distance(x, y, f) < self.radius - 1e-9 for f in near):
            return None
        order = np.argsort(lengths, kind="stable")
        for k, (dx, dy) in zip(order.tolist(), moves[order].tolist(), strict=True):
            if all(compute_first_contact(x, y, dx, dy, self.radius, f) > 1.0 for f in near):
                return tuple(cells[k].tolist())
        return None

    def keeps_link(self, x: float, y: float, cell: tuple[int, int], solids: Sequence[Solid]) -> bool:
        """Return whether an existing link stays free with more solids on the floor."""
        dx, dy = (self.grid.get_centres(np.array([cell]))[0] - (x, y)).tolist()
        return bool(self.free[cell]) and all(
            compute_distance(x, y, solid.footprint) >= self.radius - 1e-9
            and compute_first_contact(x, y, dx, dy, self.radius, solid.footprint) > 1.0 for solid in solids)
