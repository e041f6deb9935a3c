"""Collision test of the body: by a grid of clearances where its bounds decide, by the exact distance near surfaces.

Connected parts of the grid also prove that two places cannot be connected.
"""

from __future__ import annotations

import array
import copy
import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.bases.rectangle import TOUCH
from hrl_escape.env.config import CONTACT_SKIN
from hrl_escape.env.floor_grid import FloorGrid, label_parts
from hrl_escape.env.geometry import Footprint, Neighbourhood, compute_distance, compute_first_contact
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.poses import RobotPoses

FINEST = 0.02
MOST_CELLS = 1_000_000


class CollisionMap:
    """Clearances of one room with its exit door either shut or gone; immutable and picklable.

    The floor's bounding box (the alcove behind a door included) is a grid of square cells, each with the distance from
    its centre to the nearest solid, capped at `horizon`; the distance anywhere in it differs by at most `slack`.

    Attributes:
        radius: radius of the smallest disc that contains the base, plus contact skin, m. Where it fits, any heading
            fits.
        inner: radius of the largest disc within the base, m. Where it does not fit, no heading fits. Equal to `radius`
            for a disc.
        base: the base, plus contact skin.
        grid: its cells.
        low: corner of the grid with the smallest coordinates, shape (2,), m.
        resolution: side of a cell, m: a sixth of the inner radius, at most 0.125, coarser in
            rooms of more than a million such cells.
        slack: half a cell's diagonal, m.
        distance: shape (columns, rows), float32, m.
        horizon: cap of the distances, m.
        solids: rows of `stack_footprints`, shape (n, 7); a shut door comes last.
    """

    def __init__(self, instance: RoomInstance, *, door_shut: bool, reach: float = 0.0) -> None:
        """Build the map, with the exit door shut or not; distances up to the radius and `reach`, m, are stored."""
        robot = instance.robot
        self.radius, self.inner = robot.outer_radius + CONTACT_SKIN, robot.inner_radius + CONTACT_SKIN
        self.base = robot.base.grow(CONTACT_SKIN)
        self._rotations = RobotPoses(robot).rotations
        self._take_solids(_list_footprints(instance, door_shut))
        width, depth = 2 * instance.reach_x, 2 * instance.reach_y
        finest = max(FINEST, min(0.125, robot.inner_radius / 6))
        self.resolution = max(finest, math.sqrt(width * depth / MOST_CELLS))
        self.slack = self.resolution * math.sqrt(0.5) + 1e-5  # and the rounding of float32
        self.horizon = self.radius + max(reach, self.resolution) + 2 * self.slack
        self.grid = FloorGrid.cover(instance.reach_x, instance.reach_y, self.resolution)
        self.low = self.grid.low
        self._low_x, self._low_y, self._per_metre = -instance.reach_x, -instance.reach_y, 1.0 / self.resolution
        self.distance = np.full(self.grid.shape, self.horizon, dtype=np.float32)
        for footprint in self.footprints:
            self._lower(footprint)
        self._index()

    def _take_solids(self, footprints: tuple[Footprint, ...]) -> None:
        self.footprints, self._neighbourhood = footprints, Neighbourhood(footprints)
        self.solids = self._neighbourhood.shapes

    def _copy(self, footprints: tuple[Footprint, ...]) -> CollisionMap:
        """Return a copy of the map with other solids, which keeps the distances to the present ones."""
        new = copy.copy(self)
        new.__dict__.pop("_labels", None)
        new._take_solids(footprints)
        new.distance = self.distance.copy()
        return new

    def _index(self) -> None:
        self._distances = array.array("f", self.distance.tobytes())  # scalar look-ups are ten times as fast as numpy's
        self._near: dict[int, tuple[Footprint, ...]] = {}

    def adapt(self, instance: RoomInstance, door_shut: bool, changed: Sequence[Footprint]) -> CollisionMap:
        """Map of a room that differs in some solids alone, `changed`: their footprints before and after."""
        new = self._copy(_list_footprints(instance, door_shut))
        windows = [self.grid.find_window(shape, self.horizon) for shape in changed]
        for low, high in windows:
            new.distance[low[0] : high[0], low[1] : high[1]] = self.horizon
        for low, high in windows:
            for footprint in new.footprints:
                new._lower(footprint, (low, high))
        new._index()
        return new

    def keep_out(self, footprints: Sequence[Footprint]) -> CollisionMap:
        """Return the map of the room with these footprints as further solids."""
        new = self._copy((*self.footprints, *footprints))
        for footprint in footprints:
            new._lower(footprint)
        new._index()
        return new

    def _lower(self, footprint: Footprint, within: tuple[Any, Any] | None = None) -> None:
        """Lower the distances of cells, in a window or everywhere, to those from a footprint."""
        window, away = self.grid.measure(footprint, self.horizon, within)
        part = self.distance[window]
        np.minimum(part, away, out=part, casting="same_kind")

    def _find_cell(self, x: float, y: float) -> int:
        """Index of the cell that holds a place; -1 off the floor."""
        i = (x - self._low_x) * self._per_metre
        j = (y - self._low_y) * self._per_metre
        columns, rows = self.distance.shape
        return int(i) * rows + int(j) if 0.0 <= i < columns and 0.0 <= j < rows else -1

    # --- exact answers -----------------------------------------------------------------

    def is_clear(self, x: float, y: float, need: float) -> bool:
        """Return whether a place on the floor is at least `need` metres (at most `horizon`) from every solid. Exact."""
        cell = self._find_cell(x, y)
        if cell < 0:
            return False
        middle = self._distances[cell]
        if middle - self.slack >= need:
            return True
        if middle + self.slack < need:
            return False
        return all(compute_distance(x, y, f) >= need for f in self._list_near(cell))

    def _list_near(self, cell: int) -> tuple[Footprint, ...]:
        """Solids within the horizon of some place in a cell; cached."""
        near = self._near.get(cell)
        if near is None:
            i, j = divmod(cell, self.distance.shape[1])
            at_x, at_y = self._low_x + (i + 0.5) * self.resolution, self._low_y + (j + 0.5) * self.resolution
            limit = self.horizon + self.slack
            near = tuple(f for f in self.footprints if compute_distance(at_x, at_y, f) <= limit)
            self._near[cell] = near
        return near

    def does_fit(self, x: float, y: float, rotation: tuple[float, float], margin: float = 0.0) -> bool:
        """Return whether the body, with its clearance, fits at a place and heading (cosine, sine). Exact for no margin.

        The margin is a further clearance on all sides, at most `horizon` less `radius`, m.
        """
        if self.base.turns_anywhere or self.is_clear(x, y, self.radius + margin):
            return self.is_clear(x, y, self.radius + margin - TOUCH)
        if not self.is_clear(x, y, self.inner + margin - TOUCH):
            return False
        return self.base.grow(margin).measure_gap(x, y, rotation, self._list_near(self._find_cell(x, y))) >= -TOUCH

    def is_free(self, x: float, y: float) -> bool:
        """Return whether the body, with its clearance, fits at a place on the floor at some heading. Exact."""
        if self.base.turns_anywhere or self.is_clear(x, y, self.radius):
            return self.is_clear(x, y, self.radius - TOUCH)
        return any(self.does_fit(x, y, rotation) for rotation in self._rotations)

    def are_free(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return `is_free` of each of the points (n, 2)."""
        return np.array([self.is_free(x, y) for x, y in points.tolist()], dtype=bool)

    def is_move_free(self, x: float, y: float, to_x: float, to_y: float,
                     rotation: tuple[float, float] = (1.0, 0.0)) -> bool:
        """Return whether the body at this heading can go straight from one free place to another. Exact."""
        if not (self.does_fit(x, y, rotation) and self.does_fit(to_x, to_y, rotation)):
            return False
        dx, dy = to_x - x, to_y - y
        near = self._neighbourhood.list_near(x + dx / 2, y + dy / 2, math.hypot(dx, dy) / 2 + self.radius)
        if not self.base.turns_anywhere:
            return self.base.find_free_fraction(x, y, rotation, dx, dy, near) == 1.0
        return not any(compute_first_contact(x, y, dx, dy, self.radius - TOUCH, shape) < 1.0 for shape in near)

    def is_turn_free(self, x: float, y: float, heading: float, turn: float) -> bool:
        """Return whether the body can turn by an angle at a place where it fits at a heading; rad. Exact."""
        if self.is_clear(x, y, self.radius):
            return True
        cell = self._find_cell(x, y)
        rotation, to = ((math.cos(angle), math.sin(angle)) for angle in (heading, heading + turn))
        return cell >= 0 and self.base.can_turn(x, y, rotation, to, turn, self._list_near(cell))

    # --- connectivity ------------------------------------------------------------------

    @cached_property
    def _labels(self) -> NDArray[np.int32]:
        """Connected parts of the cells that may hold a free place; no path leads from one part to another."""
        return label_parts(self.distance >= self.inner - self.slack, corners=True)

    def get_parts(self, points: NDArray[np.float64]) -> NDArray[np.int32]:
        """Part of the floor of each of the points (n, 2), 0 where the body does not fit; no path connects two parts."""
        cells = self.grid.find_numbers(points.reshape(-1, 2))
        return np.where(cells >= 0, self._labels.ravel()[cells], 0)

    def find_proof(self, x: float, y: float, goal: Footprint, reach: float) -> Literal["solid", "apart"] | None:
        """Prove by the grid that the body cannot get within `reach` of a footprint; return None without a proof.

        `"solid"`: it fits nowhere there; `"apart"`: no path leads there.
        """
        window, away = self.grid.measure(goal, reach + self.slack)
        if reach < 0.0:
            return "solid"
        there = self._labels[window][away <= reach + self.slack]
        if not there.any():
            return "solid"
        here = int(self.get_parts(np.array([x, y]))[0])
        return None if here == 0 or (there == here).any() else "apart"


def _list_footprints(instance: RoomInstance, door_shut: bool) -> tuple[Footprint, ...]:
    return tuple(solid.footprint for solid in (instance.all_solids if door_shut else instance.solids))
