"""Exact planar geometry of a disc among boxes and cylinders: distances and first contact.

All functions are pure and independent of engines. The body is an upright cylinder and every solid an upright prism, so
the floor plane decides contacts. Scalar functions serve single steps; `*_many` functions take arrays of points for
planners and generation. `sight.py` handles rays. Lengths in metres, angles in radians.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import Annotated, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.schema import HashedSettings
from hrl_escape.settings import Range

Thing = TypeVar("Thing")

LARGEST_LENGTH = 1e6
"""Largest length and coordinate in a room, m."""


class Footprint(NamedTuple):
    """Outline of a solid on the floor, in a form for scalar arithmetic."""

    is_disc: bool
    x: float
    y: float
    cos: float
    sin: float
    half_x: float
    half_y: float


def make_footprint(x: float, y: float, half_x: float, half_y: float, yaw: float = 0.0,
                   is_disc: bool = False) -> Footprint:
    """Build a footprint. Quarter turns have exact sines, which keeps aligned boxes aligned."""
    return Footprint(is_disc, x, y, round(math.cos(yaw), 15), round(math.sin(yaw), 15), half_x, half_y)


@dataclasses.dataclass(frozen=True)
class Solid(HashedSettings):
    """An upright box or cylinder on the floor, in the room frame."""

    _section = "solid"
    shape: Literal["box", "cylinder"] = "box"
    """Outline on the floor: a rectangle (box) or a disc (cylinder)."""
    x: Annotated[float, Range(-LARGEST_LENGTH, LARGEST_LENGTH, "m")] = 0.0
    """x of the centre, room frame."""
    y: Annotated[float, Range(-LARGEST_LENGTH, LARGEST_LENGTH, "m")] = 0.0
    """y of the centre, room frame."""
    half_x: Annotated[float, Range(0, LARGEST_LENGTH, "m")] = 0.5
    """Half size along the solid's x, or the radius of a cylinder."""
    half_y: Annotated[float, Range(0, LARGEST_LENGTH, "m")] = 0.5
    """Half size along the solid's y, or the radius of a cylinder."""
    yaw: Annotated[float, Range(-10, 10, "rad")] = 0.0
    """Direction of the solid's x."""
    height: Annotated[float, Range(0, LARGEST_LENGTH, "m")] = 1.0
    """Height above the floor."""
    role: Literal["wall", "obstacle", "door"] = "obstacle"
    """Kind of solid in the room: wall, obstacle or door."""

    @cached_property
    def footprint(self) -> Footprint:
        """Outline of the solid on the floor."""
        return make_footprint(self.x, self.y, self.half_x, self.half_y, self.yaw, self.shape == "cylinder")


def compute_distance(x: float, y: float, shape: Footprint) -> float:
    """Return the distance from a point to a footprint; 0 inside."""
    is_disc, cx, cy, cos, sin, half_x, half_y = shape
    dx, dy = x - cx, y - cy
    if is_disc:
        return max(math.hypot(dx, dy) - half_x, 0.0)
    qx = abs(cos * dx + sin * dy) - half_x
    qy = abs(cos * dy - sin * dx) - half_y
    if qx <= 0.0:
        return qy if qy > 0.0 else 0.0
    return qx if qy <= 0.0 else math.hypot(qx, qy)


_GRAZE = 1e-9
_TANGENT = 1e-12


def compute_first_contact(x: float, y: float, dx: float, dy: float, radius: float, shape: Footprint) -> float:
    """Return the fraction of a displacement at which a moving disc first meets a footprint; `radius` has the clearance.

    The fraction is in [0, 1), or infinity if the disc passes. A disc already in contact stops (0) only if it moves
    towards the shape; it can slide along it. The set of touching centres is convex, so the disc crosses its boundary at
    most once.
    """
    is_disc, cx, cy, cos, sin, half_x, half_y = shape
    px, py = x - cx, y - cy
    if is_disc:
        return _meet_circle(px, py, dx, dy, half_x + radius)
    ox, oy = cos * px + sin * py, cos * py - sin * px
    vx, vy = cos * dx + sin * dy, cos * dy - sin * dx
    if ox < 0.0:  # mirror into the quadrant of the centre
        ox, vx = -ox, -vx
    if oy < 0.0:
        oy, vy = -oy, -vy
    qx, qy = ox - half_x, oy - half_y
    if qx > 0.0 and qy > 0.0:
        if qx * qx + qy * qy <= radius * radius:
            return _meet_circle(qx, qy, vx, vy, radius)
    elif max(qx, qy) <= radius:
        return 0.0 if (vx if qx > qy else vy) < -_GRAZE * (abs(vx) + abs(vy)) else math.inf
    # Outside: enter the box grown by the radius, then test whether that is at a rounded corner. The distances are those
    # compared above (radius - qx, not wide - ox); otherwise rounding could take a touching disc for one inside.
    wide, high = half_x + radius, half_y + radius
    enter, leave, side = 0.0, 1.0, -1
    if qx > radius or abs(vx) > 0.0:
        if vx == 0.0:
            return math.inf
        near, far = ((radius - qx) / vx, (-wide - ox) / vx) if vx < 0.0 else ((-wide - ox) / vx, (radius - qx) / vx)
        if near > enter:
            enter, side = near, 0
        leave = min(leave, far)
    if qy > radius or abs(vy) > 0.0:
        if vy == 0.0:
            return math.inf
        near, far = ((radius - qy) / vy, (-high - oy) / vy) if vy < 0.0 else ((-high - oy) / vy, (radius - qy) / vy)
        if near > enter:
            enter, side = near, 1
        leave = min(leave, far)
    if enter > leave:
        return math.inf
    ex, ey = ox + enter * vx, oy + enter * vy
    corner_x, corner_y = abs(ex) - half_x, abs(ey) - half_y
    if corner_x > 0.0 and corner_y > 0.0:
        return _meet_circle(ox - math.copysign(half_x, ex), oy - math.copysign(half_y, ey), vx, vy, radius)
    if side < 0 or abs(vx if side == 0 else vy) < _GRAZE * (abs(vx) + abs(vy)):
        return math.inf
    return enter


def _meet_circle(px: float, py: float, vx: float, vy: float, radius: float) -> float:
    """Smallest fraction t at which p + t v is inside a circle around the origin."""
    along = px * vx + py * vy
    if along >= 0.0:
        return math.inf
    square = vx * vx + vy * vy
    gap = px * px + py * py - radius * radius
    if gap <= 0.0:
        return 0.0 if along < -_GRAZE * radius * math.sqrt(square) else math.inf
    cross, most = px * vy - py * vx, square * radius * radius
    root = most - cross * cross  # equals along**2 - square * gap, without its cancellation
    if root <= _TANGENT * most:  # a tangent is not a contact, independent of rounding
        return math.inf
    fraction = gap / (-along + math.sqrt(root))
    return fraction if fraction < 1.0 else math.inf


def stack_footprints(shapes: Sequence[Footprint]) -> NDArray[np.float64]:
    """Stack footprints into rows (is_disc, x, y, cos, sin, half_x, half_y); shape (n, 7), float64."""
    return np.array(shapes, dtype=np.float64).reshape(-1, 7)


def compute_distance_many(points: NDArray[np.float64], shapes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distance from each point (n, 2) to the nearest row of `stack_footprints`, (n,).

    The distance is 0 inside a footprint, and infinity if there are none.
    """
    best = np.full(len(points), np.inf)
    for is_disc, cx, cy, cos, sin, half_x, half_y in shapes.tolist():
        dx, dy = points[:, 0] - cx, points[:, 1] - cy
        if is_disc:
            distance = np.maximum(np.hypot(dx, dy) - half_x, 0.0)
        else:
            qx = np.maximum(np.abs(cos * dx + sin * dy) - half_x, 0.0)
            qy = np.maximum(np.abs(cos * dy - sin * dx) - half_y, 0.0)
            distance = np.hypot(qx, qy)
        np.minimum(best, distance, out=best)
    return best


class Neighbourhood:
    """Footprints of a room with queries for those near a place."""

    def __init__(self, footprints: Sequence[Footprint]) -> None:
        self.footprints = list(footprints)
        self.shapes = stack_footprints(self.footprints)
        self._around = np.where(self.shapes[:, 0] > 0.5, self.shapes[:, 5],
                                np.hypot(self.shapes[:, 5], self.shapes[:, 6]))

    def find_near(self, x: float, y: float, distance: float) -> NDArray[np.int_]:
        """Return the indices of the footprints that can be within a distance, m, of a place."""
        away = np.hypot(self.shapes[:, 1] - x, self.shapes[:, 2] - y)
        return np.flatnonzero(away <= self._around + distance)

    def list_near(self, x: float, y: float, distance: float) -> list[Footprint]:
        """List the footprints that can be within a distance, m, of a place."""
        return [self.footprints[number] for number in self.find_near(x, y, distance)]


class NearCells(dict[tuple[int, int], tuple[Thing, ...]]):
    """Things that can be within reach of floor cells, computed at the first query of a cell.

    The key of a place is (floor(x / size), floor(y / size)).

    Args:
        things: all things.
        outlines: outline of each thing and its reach from the outline, m; a negative reach for never.
        size: side of a cell, m.
    """

    def __init__(self, things: Iterable[Thing], outlines: Iterable[tuple[Footprint, float]], size: float = 1.0) -> None:
        super().__init__()
        self._size = size
        self._all = tuple(zip(things, outlines, strict=True))

    def __missing__(self, cell: tuple[int, int]) -> tuple[Thing, ...]:
        x, y, far = (cell[0] + 0.5) * self._size, (cell[1] + 0.5) * self._size, 0.75 * self._size
        near = self[cell] = tuple(thing for thing, (shape, reach) in self._all
                                  if reach >= 0.0 and compute_distance(x, y, shape) <= reach + far)
        return near
