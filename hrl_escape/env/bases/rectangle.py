"""A rectangle: exact first contact, gaps and turns among boxes and cylinders.

A translating rectangle meets a box where its axis enters the Minkowski sum of both, a polygon whose sides are
perpendicular to the four axes. It meets a cylinder where its axis enters the rectangle grown by the cylinder's radius.

A rectangle that turns about its axis covers its first and last place and the four sectors that its corners sweep. If a
convex solid is clear of both places, it meets a sector exactly if its point nearest to the axis is in the sector. The
reason: from any other of its points in the sector, a straight line leads to that nearest point inside the circle of the
corners. The line could leave the sector only across a half diagonal of the first or last place. Turns by any angle are
therefore decided in closed form.

Tensors have double precision throughout: there is one base for many solids, and rectangles touch walls along whole
sides.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree import ElementTree

from typing_extensions import Self

from hrl_escape.env.bases.base import STANDS_IN, Base, make_box_link
from hrl_escape.env.geometry import Footprint, compute_distance, compute_first_contact

if TYPE_CHECKING:
    from torch import Tensor

    from hrl_escape.env.tensor_geometry import RoomSolids, Shapes

TOUCH = 1e-9
"""Depth, m, to which rounding can move a base into a solid that it touches."""
_GRAZE = 1e-9
_SIGNS = ((1, 1), (1, -1), (-1, 1), (-1, -1))


def _compute_sides(px: Any, py: Any, cos: Any, sin: Any, size: tuple[float, ...], box_cos: Any, box_sin: Any,
                   half_x: Any, half_y: Any) -> tuple[tuple[Any, Any, Any, Any], ...]:
    """Sides of the polygon of touching places around a box: (x and y of an axis, place on it, half extent) per pair.

    The place is the position of the base's axis, at (px, py) from the box's centre. Accepts numbers and tensors.
    """
    half_length, half_width = size[0], size[1]
    ahead, aside = abs(cos * box_cos + sin * box_sin), abs(sin * box_cos - cos * box_sin)
    return (
        (box_cos, box_sin, px * box_cos + py * box_sin, half_x + half_length * ahead + half_width * aside),
        (-box_sin, box_cos, py * box_cos - px * box_sin, half_y + half_length * aside + half_width * ahead),
        (cos, sin, px * cos + py * sin, half_length + half_x * ahead + half_y * aside),
        (-sin, cos, py * cos - px * sin, half_width + half_x * aside + half_y * ahead),
    )


def compute_base_contact(x: float, y: float, cos: float, sin: float, size: tuple[float, ...],
                         dx: float, dy: float, shape: Footprint) -> float:
    """Return the fraction in [0, 1) of a displacement at which a rectangle meets a footprint; infinity if it passes.

    `size` is half its size along its heading (cos, sin) and across, with clearance. A rectangle already in contact
    stops (0) only if it moves towards the shape; it can slide along it.
    """
    half_length, half_width = size[0], size[1]
    if shape[0]:
        grown = Footprint(False, shape[1], shape[2], cos, sin, half_length, half_width)
        return compute_first_contact(x, y, dx, dy, shape[5], grown)
    sides = _compute_sides(x - shape[1], y - shape[2], cos, sin, size, shape[3], shape[4], shape[5], shape[6])
    graze, deepest = _GRAZE * (abs(dx) + abs(dy)), -math.inf
    for _, _, place, half in sides:
        deepest = max(deepest, abs(place) - half)
    enter, leave = 0.0, 1.0
    for axis_x, axis_y, place, half in sides:
        away, speed = abs(place) - half, dx * axis_x + dy * axis_y
        if place < 0.0:
            speed = -speed
        if deepest <= TOUCH:  # in contact: stops if it moves inwards across every side that it touches
            if away >= deepest - TOUCH and speed >= -graze:
                return math.inf
        elif away >= -TOUCH and speed >= -graze:  # grazing a side is not a contact, independent of rounding
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


def measure_base_gap(x: float, y: float, cos: float, sin: float, size: tuple[float, ...],
                     shape: Footprint) -> float:
    """Return the gap between a rectangle and a footprint along the best separating axis; negative if they overlap.

    It has the sign of the distance and never exceeds it (separating axis theorem).
    """
    half_length, half_width = size[0], size[1]
    if shape[0]:
        base = Footprint(False, x, y, cos, sin, half_length, half_width)
        return compute_distance(shape[1], shape[2], base) - shape[5]
    gap = -math.inf
    sides = _compute_sides(x - shape[1], y - shape[2], cos, sin, size, shape[3], shape[4], shape[5], shape[6])
    for _, _, place, half in sides:
        gap = max(gap, abs(place) - half)
    return gap


def compute_base_distance(x: float, y: float, cos: float, sin: float, size: tuple[float, ...],
                          shape: Footprint) -> float:
    """Return the distance between a rectangle and a footprint; 0 if they overlap.

    For two separate boxes it is the smallest distance of a corner of one to the other.
    """
    half_length, half_width = size[0], size[1]
    gap = measure_base_gap(x, y, cos, sin, size, shape)
    if gap <= 0.0 or shape[0]:
        return max(gap, 0.0)
    base = Footprint(False, x, y, cos, sin, half_length, half_width)
    return min(_find_nearest_corner(base, shape), _find_nearest_corner(shape, base))


def _find_nearest_corner(box: Footprint, other: Footprint) -> float:
    """Smallest distance of a corner of a box to another footprint."""
    _, cx, cy, cos, sin, half_x, half_y = box
    nearest = math.inf
    for along, across in ((half_x, half_y), (half_x, -half_y), (-half_x, half_y), (-half_x, -half_y)):
        corner_x, corner_y = cx + cos * along - sin * across, cy + sin * along + cos * across
        nearest = min(nearest, compute_distance(corner_x, corner_y, other))
    return nearest


def is_turn_blocked(x: float, y: float, cos: float, sin: float, to_cos: float, to_sin: float, turn: float,
                    size: tuple[float, ...], shape: Footprint) -> bool:
    """Return whether a footprint blocks the turn of a rectangle about its centre; they must be apart before the turn.

    `size` is half its size along its heading and across, with clearance; `turn` is in rad, counter-clockwise.
    """
    half_length, half_width = size[0], size[1]
    around = math.hypot(half_length, half_width)
    is_disc, cx, cy, box_cos, box_sin, half_x, half_y = shape
    px, py = cx - x, cy - y  # (px, py) becomes the shape's point nearest to the axis
    if is_disc:
        if math.hypot(px, py) - half_x >= around - TOUCH:
            return False
    else:
        along, across = -(box_cos * px + box_sin * py), -(box_cos * py - box_sin * px)
        along, across = min(max(along, -half_x), half_x), min(max(across, -half_y), half_y)
        px, py = px + box_cos * along - box_sin * across, py + box_sin * along + box_cos * across
        if math.hypot(px, py) >= around - TOUCH:
            return False
    if measure_base_gap(x, y, to_cos, to_sin, size, shape) < -TOUCH:
        return True
    bearing = math.atan2(cos * py - sin * px, cos * px + sin * py)
    corner = math.atan2(half_width, half_length)
    if turn < 0.0:
        bearing, turn = -bearing, -turn
    return (bearing - corner) % math.pi <= turn or (bearing + corner) % math.pi <= turn


class RectangularBase(Base):
    """A rectangle around the axis; `size` is half its length along its heading and half its width."""

    front_field, width_field = "body_length / 2", "body_width"
    contact, gap = staticmethod(compute_base_contact), staticmethod(measure_base_gap)
    distance, blocks_turn = staticmethod(compute_base_distance), staticmethod(is_turn_blocked)
    symmetry = 2

    @classmethod
    def measure(cls, robot: Any) -> Self:
        """Return the base of a `RobotConfig`, without clearance."""
        return cls((robot.body_length / 2, robot.body_width / 2))

    @property
    def inner_radius(self) -> float:
        """Radius of the largest disc around the axis inside the rectangle, m."""
        return min(self.size)

    @property
    def outer_radius(self) -> float:
        """Half the diagonal, m."""
        return math.hypot(*self.size)

    @property
    def front(self) -> float:
        """Half the length, m."""
        return self.size[0]

    @property
    def corners(self) -> tuple[tuple[float, float], ...]:
        """Corners in the base frame, counter-clockwise, m."""
        long, wide = self.size
        return (-long, -wide), (long, -wide), (long, wide), (-long, wide)

    def describe(self) -> str:
        """Return shape and sizes in words, for messages."""
        return f"a base of {2 * self.size[0]:g} x {2 * self.size[1]:g} m"

    def make_link(self, name: str, mass: float, height: float) -> ElementTree.Element:
        """Make the base's URDF link, upright on the floor; kg, m."""
        return make_box_link(name, mass, (2 * self.size[0], 2 * self.size[1], height), f"0 0 {height / 2!r}")

    def place(self, x: Tensor, y: Tensor, find_rotation: Callable[[], tuple[Tensor, Tensor]]) -> TensorRectangle:
        """Place the rectangle in each room of a batch."""
        return TensorRectangle(x, y, *find_rotation(), self.size)


class TensorRectangle(NamedTuple):
    """A rectangle in each room; all tensors are float64 (rooms,)."""

    x: Tensor  # centre, m
    y: Tensor  # centre, m
    cos: Tensor  # cosine of the heading
    sin: Tensor  # sine of the heading
    size: tuple[float, ...]  # half sizes, equal in all rooms, m

    def _as_shapes(self, shapes: Shapes) -> Shapes:
        """The rectangle around each shape's centre, grown by a cylinder's radius, which reduces cylinders to points."""
        import torch

        half_length, half_width = self.size
        return shapes._replace(cos=self.cos, sin=self.sin, half_x=torch.full_like(self.cos, half_length),
                               half_y=torch.full_like(self.cos, half_width))

    def _compute_sides(self, shapes: Shapes) -> tuple[tuple[Tensor, Tensor, Tensor, Tensor], ...]:
        """Sides of the polygon of touching places around boxes: (x and y of an axis, place on it, half extent)."""
        return _compute_sides(*shapes.look_from(self.x, self.y), self.cos, self.sin, self.size, *shapes[2:6])

    def measure_gap(self, shapes: Shapes) -> Tensor:
        """Return the gap to outlines along the best separating axis, (shapes, rooms); negative if they overlap."""
        import torch

        from hrl_escape.env.tensor_geometry import compute_distance

        box = torch.stack([place.abs() - half for _, _, place, half in self._compute_sides(shapes)]).amax(0)
        to_disc = compute_distance(self.x, self.y, self._as_shapes(shapes)._replace(
            rounding=torch.zeros_like(shapes.rounding))) - shapes.rounding
        return torch.where(shapes.rounding > 0.0, to_disc, box)

    def compute_distance(self, shapes: Shapes) -> Tensor:
        """Return the distance to boxes, (shapes, rooms); 0 if they overlap."""
        import torch

        from hrl_escape.env.tensor_geometry import Shapes, compute_distance

        half_length, half_width = self.size
        base = Shapes(self.x, self.y, self.cos, self.sin, torch.full_like(self.cos, half_length),
                      torch.full_like(self.cos, half_width), torch.zeros_like(self.cos))
        corners = []
        for along, across in _SIGNS:
            a, b = along * half_length, across * half_width
            corners.append(compute_distance(self.x + self.cos * a - self.sin * b, self.y + self.sin * a + self.cos * b,
                                            shapes))
            a, b = along * shapes.half_x, across * shapes.half_y
            corners.append(compute_distance(shapes.x + shapes.cos * a - shapes.sin * b,
                                            shapes.y + shapes.sin * a + shapes.cos * b, base))
        return torch.where(self.measure_gap(shapes) <= 0.0, 0.0, torch.stack(corners).amin(0))

    def find_free_fraction(self, dx: Tensor, dy: Tensor, solids: RoomSolids) -> Tensor:
        """Return the fraction, in [0, 1], of displacements before the contact with any solid, float64 (rooms,)."""
        return self.compute_first_contact(dx, dy, solids.list_all()).amin(0)

    def stands_in(self, shapes: Shapes) -> Tensor:
        """Return whether the rectangle overlaps outlines by more than `STANDS_IN`, bool (shapes, rooms)."""
        return self.measure_gap(shapes) < -STANDS_IN

    def compute_first_contact(self, dx: Tensor, dy: Tensor, shapes: Shapes) -> Tensor:
        """Return the fraction, in [0, 1], of displacements before the contact with each outline, (shapes, rooms)."""
        import torch

        from hrl_escape.env.tensor_geometry import compute_first_contact

        disc = compute_first_contact(self.x, self.y, dx, dy, 0.0, self._as_shapes(shapes)).clamp(min=0.0)
        sides = self._compute_sides(shapes)
        graze = _GRAZE * (dx.abs() + dy.abs())
        away = torch.stack([place.abs() - half for _, _, place, half in sides])  # (sides, shapes, rooms)
        speed = torch.stack([torch.where(place < 0.0, -1.0, 1.0) * (dx * axis_x + dy * axis_y)
                             for axis_x, axis_y, place, _ in sides])
        extent = torch.stack([half for _, _, _, half in sides])
        deepest = away.amax(0)
        is_leaving = ((away >= deepest - TOUCH) & (speed >= -graze)).any(0)
        is_outside = away > 0.0
        passes = ((away >= -TOUCH) & (speed >= -graze)).any(0)
        per = 1.0 / torch.where(speed == 0.0, 1.0, speed.abs())
        enter = torch.where(is_outside, away * per, 0.0).amax(0)
        far = torch.where(speed > 0.0, -away * per, (away + 2.0 * extent) * per)
        leave = torch.where(speed == 0.0, 1.0, far).amin(0).clamp(max=1.0)
        met = torch.where(~passes & (enter < leave), enter, 1.0)
        box = torch.where(deepest <= TOUCH, is_leaving.to(torch.float64), met)
        return torch.where(shapes.rounding > 0.0, disc, box)

    def is_turn_blocked(self, to_cos: Tensor, to_sin: Tensor, turn: Tensor, shapes: Shapes) -> Tensor:
        """Return whether an outline blocks a turn by an angle in rad, bool (shapes, rooms)."""
        import torch

        half_length, half_width = self.size
        around, corner = math.hypot(half_length, half_width), math.atan2(half_width, half_length)
        px, py = (-offset for offset in shapes.look_from(self.x, self.y))
        along, across = -(shapes.cos * px + shapes.sin * py), -(shapes.cos * py - shapes.sin * px)
        along = torch.maximum(torch.minimum(along, shapes.half_x), -shapes.half_x)
        across = torch.maximum(torch.minimum(across, shapes.half_y), -shapes.half_y)
        px, py = px + shapes.cos * along - shapes.sin * across, py + shapes.sin * along + shapes.cos * across
        is_near = torch.sqrt(px * px + py * py) - shapes.rounding < around - TOUCH
        overlaps = self._replace(cos=to_cos, sin=to_sin).measure_gap(shapes) < -TOUCH
        bearing = torch.atan2(self.cos * py - self.sin * px, self.cos * px + self.sin * py)
        bearing = torch.where(turn < 0.0, -bearing, bearing)
        is_swept = [torch.remainder(bearing + side, math.pi) <= turn.abs() for side in (-corner, corner)]
        return is_near & (overlaps | is_swept[0] | is_swept[1])
