"""Exact planar geometry of a rectangular base among boxes and cylinders: first contact, gaps and turns.

The counterpart of `geometry.py`, which has the disc. Pure functions on numbers, which planners compile as they
stand. A translating rectangle meets a box where its axis enters the polygon that both span (their Minkowski sum,
whose sides are perpendicular to the four axes of the two), and a cylinder where its axis enters the rectangle grown
by the cylinder's radius. A rectangle that turns about its axis covers its first and its last place and the four
sectors that its corners sweep. Where a convex solid meets neither place, it meets a sector exactly if its point
nearest to the axis does: from any other of its points in the sector a straight line leads to that one within the
circle of the corners, and could leave the sector only across a half diagonal of the first or last place. So turns are
decided in closed form too, for any angle. Metres, radians.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from hrl_escape.env.config import CONTACT_SKIN, RobotConfig
from hrl_escape.env.geometry import Footprint, compute_distance, compute_first_contact

__all__ = ["TOUCH", "RectangularBase", "compute_base_contact", "compute_base_distance", "is_turn_blocked",
           "measure_base_gap"]

TOUCH = 1e-9
"""Depth in metres to which a base that touches a solid may be inside it, by rounding."""
_GRAZE = 1e-9


def _compute_sides(x: float, y: float, cos: float, sin: float, half_length: float, half_width: float,
                   shape: Footprint) -> tuple[tuple[float, float, float, float], ...]:
    """The polygon of touching places round a box: (x and y of an axis, place on it, half extent) of each pair of sides.

    The place is that of the base's axis, from the box's centre.
    """
    _, cx, cy, box_cos, box_sin, half_x, half_y = shape
    px, py = x - cx, y - cy
    ahead, aside = abs(cos * box_cos + sin * box_sin), abs(sin * box_cos - cos * box_sin)
    return (
        (box_cos, box_sin, px * box_cos + py * box_sin, half_x + half_length * ahead + half_width * aside),
        (-box_sin, box_cos, py * box_cos - px * box_sin, half_y + half_length * aside + half_width * ahead),
        (cos, sin, px * cos + py * sin, half_length + half_x * ahead + half_y * aside),
        (-sin, cos, py * cos - px * sin, half_width + half_x * aside + half_y * ahead),
    )


def compute_base_contact(x: float, y: float, cos: float, sin: float, half_length: float, half_width: float,
                         dx: float, dy: float, shape: Footprint) -> float:
    """Fraction of a displacement at which a moving rectangle first meets a footprint.

    Args:
        x: centre of the rectangle.
        y: centre of the rectangle.
        cos: of its heading.
        sin: of its heading.
        half_length: half its size along its heading, clearance included.
        half_width: half its size across, clearance included.
        dx: displacement.
        dy: displacement.
        shape: the outline that may be hit.

    Returns:
        The fraction in [0, 1), or infinity if the rectangle gets by. One that touches already is stopped (0) only if
        it moves towards the shape; sliding along it is free.
    """
    if shape[0]:
        grown = Footprint(False, shape[1], shape[2], cos, sin, half_length, half_width)
        return compute_first_contact(x, y, dx, dy, shape[5], grown)
    sides = _compute_sides(x, y, cos, sin, half_length, half_width, shape)
    graze, deepest = _GRAZE * (abs(dx) + abs(dy)), -math.inf
    for _, _, place, half in sides:
        deepest = max(deepest, abs(place) - half)
    enter, leave = 0.0, 1.0
    for axis_x, axis_y, place, half in sides:
        away, speed = abs(place) - half, dx * axis_x + dy * axis_y
        if place < 0.0:
            speed = -speed
        if deepest <= TOUCH:  # it touches: stopped if it moves inwards across all sides that it is at
            if away >= deepest - TOUCH and speed >= -graze:
                return math.inf
        elif away >= -TOUCH and speed >= -graze:  # a side that is grazed is no hit, however it is rounded
            return math.inf
        elif away > 0.0:
            enter, leave = max(enter, away / -speed), min(leave, (away + 2.0 * half) / -speed)
        elif speed > 0.0:
            leave = min(leave, -away / speed)
        elif speed < 0.0:
            leave = min(leave, (away + 2.0 * half) / -speed)
    if deepest <= TOUCH:
        return 0.0
    return enter if enter < leave else math.inf


def measure_base_gap(x: float, y: float, cos: float, sin: float, half_length: float, half_width: float,
                     shape: Footprint) -> float:
    """Gap between a rectangle and a footprint across the axis that separates them best; negative where they overlap.

    It has the sign of the distance and is never larger (separating axis theorem).
    """
    if shape[0]:
        base = Footprint(False, x, y, cos, sin, half_length, half_width)
        return compute_distance(shape[1], shape[2], base) - shape[5]
    gap = -math.inf
    for _, _, place, half in _compute_sides(x, y, cos, sin, half_length, half_width, shape):
        gap = max(gap, abs(place) - half)
    return gap


def compute_base_distance(x: float, y: float, cos: float, sin: float, half_length: float, half_width: float,
                          shape: Footprint) -> float:
    """Distance between a rectangle and a footprint; 0 where they overlap.

    That of two boxes apart is the distance of some corner of one to the other.
    """
    gap = measure_base_gap(x, y, cos, sin, half_length, half_width, shape)
    if gap <= 0.0 or shape[0]:
        return max(gap, 0.0)
    base = Footprint(False, x, y, cos, sin, half_length, half_width)
    return min(_find_nearest_corner(base, shape), _find_nearest_corner(shape, base))


def _find_nearest_corner(box: Footprint, other: Footprint) -> float:
    """Least distance of a corner of a box to another footprint."""
    _, cx, cy, cos, sin, half_x, half_y = box
    nearest = math.inf
    for along, across in ((half_x, half_y), (half_x, -half_y), (-half_x, half_y), (-half_x, -half_y)):
        corner_x, corner_y = cx + cos * along - sin * across, cy + sin * along + cos * across
        nearest = min(nearest, compute_distance(corner_x, corner_y, other))
    return nearest


def is_turn_blocked(x: float, y: float, cos: float, sin: float, to_cos: float, to_sin: float, turn: float,
                    half_length: float, half_width: float, shape: Footprint) -> bool:
    """Return whether a footprint is in the way of a rectangle, clear of it, that turns about its centre.

    Args:
        x: centre of the rectangle.
        y: centre of the rectangle.
        cos: of its heading before.
        sin: of its heading before.
        to_cos: of its heading afterwards.
        to_sin: of its heading afterwards.
        turn: angle, rad, counter-clockwise positive.
        half_length: half its size along its heading, clearance included.
        half_width: half its size across, clearance included.
        shape: the outline that may be hit.
    """
    around = math.hypot(half_length, half_width)
    is_disc, cx, cy, box_cos, box_sin, half_x, half_y = shape
    px, py = cx - x, cy - y  # the shape's point nearest to the axis is at (px, py)
    if is_disc:
        if math.hypot(px, py) - half_x >= around - TOUCH:
            return False
    else:
        along, across = -(box_cos * px + box_sin * py), -(box_cos * py - box_sin * px)
        along, across = min(max(along, -half_x), half_x), min(max(across, -half_y), half_y)
        px, py = px + box_cos * along - box_sin * across, py + box_sin * along + box_cos * across
        if math.hypot(px, py) >= around - TOUCH:
            return False
    if measure_base_gap(x, y, to_cos, to_sin, half_length, half_width, shape) < -TOUCH:
        return True
    bearing = math.atan2(cos * py - sin * px, cos * px + sin * py)
    corner = math.atan2(half_width, half_length)
    if turn < 0.0:
        bearing, turn = -bearing, -turn
    return (bearing - corner) % math.pi <= turn or (bearing + corner) % math.pi <= turn


class RectangularBase(NamedTuple):
    """A rectangle round the axis of the base.

    Attributes:
        half_length: half its size along its heading, m.
        half_width: half its size across, m.
    """

    half_length: float
    half_width: float

    @classmethod
    def make(cls, robot: RobotConfig, margin: float = CONTACT_SKIN) -> RectangularBase | None:
        """The outline of a robot's base, grown on all sides by a margin, m; None if it is a disc."""
        return None if robot.footprint == "disc" else cls(*(half + margin for half in robot.half_sizes))

    def find_free_fraction(self, x: float, y: float, rotation: tuple[float, float], dx: float, dy: float,
                           shapes: Iterable[Footprint]) -> float:
        """Share in [0, 1] of a displacement until the first contact with any of some footprints."""
        met = (compute_base_contact(x, y, *rotation, *self, dx, dy, shape) for shape in shapes)
        return min(1.0, min(met, default=1.0))

    def measure_gap(self, x: float, y: float, rotation: tuple[float, float], shapes: Iterable[Footprint]) -> float:
        """Least gap to any of some footprints, m; see `measure_base_gap`."""
        return min((measure_base_gap(x, y, *rotation, *self, shape) for shape in shapes), default=math.inf)

    def can_turn(self, x: float, y: float, rotation: tuple[float, float], to: tuple[float, float], turn: float,
                 shapes: Iterable[Footprint]) -> bool:
        """Return whether a turn from one rotation to another is free of all of some footprints."""
        return not any(is_turn_blocked(x, y, *rotation, *to, turn, *self, shape) for shape in shapes)
