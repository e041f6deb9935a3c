"""Where the body can be and get to: a conservative grid over the floor, with exact links.

Two neighbouring free cells are joined by a straight move that truly keeps the clearance and
some slack besides, so whatever the grid calls connected is connected. Generation certifies
instances with it.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.config import CONTACT_SKIN, PASSAGE_SLACK, compute_resolution
from hrl_escape.env.geometry import (
    Footprint,
    Solid,
    compute_distance,
    compute_distance_many,
    compute_first_contact,
    stack_footprints,
)

__all__ = ["FreeSpace"]


class FreeSpace:
    """Free cells of a floor for a body of a given radius.

    Attributes:
        radius: body radius plus clearance, m.
        resolution: cell size, m.
        free: shape (columns, rows), bool; cell (i, j) has its centre at `get_centres`.
        labels: shape (columns, rows), int32; connected cells share a positive number.
    """

    def __init__(self, reach_x: float, reach_y: float, body_radius: float, solids: Sequence[Solid]) -> None:
        self.radius = body_radius + CONTACT_SKIN
        self.resolution = compute_resolution(reach_x, reach_y)
        self._low = np.array([-reach_x, -reach_y])
        self.footprints: list[Footprint] = []
        shape = tuple(max(1, math.ceil(2 * reach / self.resolution)) for reach in (reach_x, reach_y))
        self.free = np.ones(shape, dtype=bool)
        self._add(solids)

    def extend(self, solids: Sequence[Solid]) -> FreeSpace:
        """The same floor with more solids on it; this one stays as it is."""
        other = copy.copy(self)
        other.free, other.footprints = self.free.copy(), list(self.footprints)
        other._add(solids)
        return other

    def _add(self, solids: Sequence[Solid]) -> None:
        for solid in solids:
            self.footprints.append(solid.footprint)
            self._carve(solid.footprint)
        self.labels = self._label()

    def _carve(self, footprint: Footprint) -> None:
        need = self.radius + PASSAGE_SLACK + self.resolution / 2
        around = math.hypot(footprint.half_x, footprint.half_y) if not footprint.is_disc else footprint.half_x
        box = [footprint.x - around - need, footprint.x + around + need]
        i0, i1 = ((np.array(box) - self._low[0]) / self.resolution).astype(int)
        box = [footprint.y - around - need, footprint.y + around + need]
        j0, j1 = ((np.array(box) - self._low[1]) / self.resolution).astype(int)
        i0, j0 = max(i0, 0), max(j0, 0)
        i1, j1 = min(i1 + 1, self.free.shape[0]), min(j1 + 1, self.free.shape[1])
        if i0 >= i1 or j0 >= j1:
            return
        cells = np.indices((i1 - i0, j1 - j0)).reshape(2, -1).T + (i0, j0)
        points = self.get_centres(cells)
        far = compute_distance_many(points, stack_footprints([footprint])) >= need
        self.free[i0:i1, j0:j1] &= far.reshape(i1 - i0, j1 - j0)

    def _label(self) -> NDArray[np.int32]:
        columns, rows = np.flatnonzero(self.free.any(axis=1)), np.flatnonzero(self.free.any(axis=0))
        if len(columns) and self.free[columns[0] : columns[-1] + 1, rows[0] : rows[-1] + 1].all():
            return self.free.astype(np.int32)  # an empty room: one rectangle
        from scipy import ndimage  # only rooms with something in the way pay for this import

        labels = np.zeros(self.free.shape, dtype=np.int32)
        ndimage.label(self.free, output=labels)
        return labels

    def get_centres(self, cells: NDArray[np.int_]) -> NDArray[np.float64]:
        """Positions (n, 2) of cells (n, 2)."""
        return np.asarray(self._low + (np.asarray(cells) + 0.5) * self.resolution, dtype=np.float64)

    def get_cells(self, label: int) -> NDArray[np.int_]:
        """Cells (n, 2) of a connected part."""
        return np.argwhere(self.labels == label)

    def is_clear(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether the body fits exactly at each of the points (n, 2)."""
        return compute_distance_many(points, stack_footprints(self.footprints)) >= self.radius - 1e-9

    def find_label(self, x: float, y: float) -> int:
        """Part of the floor that a free position belongs to; 0 if it is not free or linked to none.

        A position is linked if a straight move that keeps the clearance leads to a free cell.
        """
        if not self.is_clear(np.array([[x, y]]))[0]:
            return 0
        at = ((np.array([x, y]) - self._low) / self.resolution).astype(int)
        span = 3 + math.ceil((PASSAGE_SLACK + 0.3) / self.resolution)
        i, j = np.mgrid[at[0] - span : at[0] + span + 1, at[1] - span : at[1] + span + 1]
        cells = np.stack([i.ravel(), j.ravel()], axis=1)
        inside = ((cells >= 0) & (cells < self.free.shape)).all(axis=1)
        cells = cells[inside]
        cells = cells[self.free[cells[:, 0], cells[:, 1]]]
        moves = self.get_centres(cells) - (x, y)
        lengths = np.hypot(*moves.T)
        near = [f for f in self.footprints if compute_distance(x, y, f) <= self.radius + lengths.max(initial=0.0)]
        for k in np.argsort(lengths, kind="stable"):
            dx, dy = moves[k]
            if all(compute_first_contact(x, y, dx, dy, self.radius, f) > 1.0 for f in near):
                return int(self.labels[tuple(cells[k])])
        return 0
