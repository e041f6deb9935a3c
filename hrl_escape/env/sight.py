"""Lidar and lines of sight from one place among fixed outlines, fast enough for every step.

The rays of a heading are tabulated once, and a scan is then a few products over all rays and outlines. Metres, radians.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.geometry import Footprint
from hrl_escape.env.instance import RoomInstance

SIGHT_SLACK = 1e-3
"""Distance from an object, m, within which other solids never hide it, in addition to its half thickness."""
_TINY = 1e-30  # replaces a zero component of a direction


def list_hiders(instance: RoomInstance) -> list[Footprint]:
    """List the outlines that can hide one place on the floor from another, without the exit door.

    The outer walls of a room without an alcove cannot.
    """
    footprints = [solid.footprint for solid in instance.solids]
    if instance.door is not None:
        return footprints
    return [shape for shape in footprints if _reaches_into(shape, instance.half_width, instance.half_depth)]


def _reaches_into(shape: Footprint, half_width: float, half_depth: float) -> bool:
    """Return whether the bounding rectangle of an outline overlaps the open floor."""
    if shape.is_disc:
        wide = high = shape.half_x
    else:
        wide = abs(shape.cos) * shape.half_x + abs(shape.sin) * shape.half_y
        high = abs(shape.sin) * shape.half_x + abs(shape.cos) * shape.half_y
    slack = 1e-9
    return abs(shape.x) - wide < half_width - slack and abs(shape.y) - high < half_depth - slack


class Scanner:
    """Rays among fixed outlines. Lidar bearings are counter-clockwise from straight ahead."""

    def __init__(self, shapes: Sequence[Footprint], bearings: NDArray[np.float64]) -> None:
        boxes = np.array([shape[1:] for shape in shapes if not shape.is_disc], dtype=np.float64).reshape(-1, 6).T
        discs = np.array([(s.x, s.y, s.half_x) for s in shapes if s.is_disc], dtype=np.float64).reshape(-1, 3).T
        x, y, cos, sin, half_x, half_y = boxes
        self._axes = np.array([[cos, -sin], [sin, cos]])  # (of x or y, own x or y, boxes)
        self._origin = np.array([cos * x + sin * y, cos * y - sin * x])
        self._half = np.array([half_x, half_y])[:, :, None]
        self._discs = discs
        self._bearings = bearings
        self._tables: dict[int, tuple[NDArray[np.float64], ...]] = {}

    def measure(self, x: float, y: float, cos: float, sin: float, key: int | None = None) -> NDArray[np.float64]:
        """Return the range of each lidar ray from (x, y) to the first outline; infinity for a miss, 0 inside one.

        With a `key` of the heading, the rays of that heading are cached.
        """
        table = None if key is None else self._tables.get(key)
        if table is None:
            ray_cos, ray_sin = np.cos(self._bearings), np.sin(self._bearings)
            table = self._tabulate(cos * ray_cos - sin * ray_sin, sin * ray_cos + cos * ray_sin)
            if key is not None:
                self._tables[key] = table
        return self._meet(x, y, table)

    def see(self, x: float, y: float, points: NDArray[np.float64], slack: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether each point (n, 2) is in sight of (x, y). Solids never hide the last `slack` (n,) m."""
        away_x, away_y = points[:, 0] - x, points[:, 1] - y
        distance = np.hypot(away_x, away_y)
        per_metre = 1.0 / np.maximum(distance, _TINY)
        return self._meet(x, y, self._tabulate(away_x * per_metre, away_y * per_metre)) >= distance - slack

    def _tabulate(self, ray_x: NDArray[np.float64], ray_y: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        """Directions, and for each box the metres of ray per metre along its axes and across its half size."""
        along = self._axes[0][:, :, None] * ray_x + self._axes[1][:, :, None] * ray_y  # (axis, boxes, rays)
        per_metre = 1.0 / np.where(np.abs(along) < _TINY, _TINY, along)
        return per_metre, self._half * np.abs(per_metre), ray_x, ray_y

    def _meet(self, x: float, y: float, table: tuple[NDArray[np.float64], ...]) -> NDArray[np.float64]:
        per_metre, across, ray_x, ray_y = table
        middle = (self._origin - self._axes[0] * x - self._axes[1] * y)[:, :, None] * per_metre
        near, far = middle - across, middle + across
        enter = np.maximum(near[0], near[1])
        np.maximum(enter, 0.0, out=enter)
        enter[np.minimum(far[0], far[1]) < enter] = math.inf
        ranges = enter.min(axis=0, initial=math.inf)
        if self._discs.size:
            to_x, to_y, radius = (self._discs[0] - x)[:, None], (self._discs[1] - y)[:, None], self._discs[2][:, None]
            along = to_x * ray_x + to_y * ray_y
            root = along * along - (to_x * to_x + to_y * to_y - radius * radius)
            disc = np.where((root >= 0.0) & (along > 0.0), along - np.sqrt(np.maximum(root, 0.0)), math.inf)
            np.minimum(ranges, np.maximum(disc.min(axis=0), 0.0), out=ranges)
        return ranges
