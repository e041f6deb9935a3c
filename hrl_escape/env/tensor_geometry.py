"""Planar geometry of a disc among boxes and cylinders, in tensors: distances, first contact, rays.

The rules are those in `geometry.py`, without branches, which compile into one loop over rooms. A cylinder is a box
without extent, rounded by its radius: every outline here is a rounded box. Shapes come first, rooms last. Metres.

Positions have double precision. Offsets from an outline have the outline's own type: double, or single for searches
over thousands of outlines (`Shapes.round`, `Shapes.split`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.geometry import Footprint

_NEVER = 1e6  # position of outlines that only pad a table
_TINY = 1e-18  # keeps a velocity from zero


def store(value: Tensor) -> Tensor:
    """Return the value itself, which a compiled kernel then computes once and stores.

    Otherwise the compiler would repeat the computation in every iteration of a loop over solids, most of all gathers
    from tables. It does not fuse operations across a change of strides, even an identity.
    """
    return value.as_strided(value.shape, value.stride())


def wrap(number: Tensor, period: Tensor | int) -> Tensor:
    """Return the non-negative remainder of integers, in the same dtype; exact below 2^22.

    It computes in single precision, because vector units have no integer division.
    """
    whole = number.to(torch.float32)
    return (whole - torch.floor((whole + 0.5) / period) * period).to(number.dtype)


def as_flags(where: Tensor) -> Tensor:
    """Return truth values found in double precision as bool, in the form that kernels combine.

    The compiler combines truth values in 32 bits, and would narrow the 64-bit results of comparisons one by one.
    """
    return torch.where(where, 1.0, 0.0).to(torch.float32) > 0.5


class Shapes(NamedTuple):
    """Outlines on the floor, one per row; each field is (shapes, rooms), or (shapes, 1) if all rooms share it."""

    x: Tensor  # centre, float64
    y: Tensor  # centre, float64
    cos: Tensor  # direction of the outline's x; this and the following are float64, or float32 after `round`
    sin: Tensor  # direction of the outline's x
    half_x: Tensor  # half size along the outline's x; 0 for a cylinder
    half_y: Tensor  # half size along the outline's y; 0 for a cylinder
    rounding: Tensor  # radius of a cylinder, otherwise 0

    def round(self) -> Shapes:
        """Return the same outlines in single precision, around their exact centres."""
        return Shapes(self.x, self.y, *(field.to(torch.float32) for field in self[2:]))

    def look_from(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Return positions (rooms,), float64, relative to the centres, in the outlines' own type."""
        return (x - self.x).to(self.cos.dtype), (y - self.y).to(self.cos.dtype)

    def split(self) -> SplitShapes:
        """Return the same outlines in single precision throughout, for the search for the first contact."""
        near = (field.to(torch.float32) for field in self)
        return SplitShapes(*near, *((field - field.to(torch.float32)).to(torch.float32) for field in self[:2]))


class SplitShapes(NamedTuple):
    """Outlines in single precision, with centres as sums of two numbers; each field is float32, as in `Shapes`."""

    x: Tensor  # centre, leading bits
    y: Tensor  # centre, leading bits
    cos: Tensor  # direction of the outline's x
    sin: Tensor  # direction of the outline's x
    half_x: Tensor  # half size along the outline's x; 0 for a cylinder
    half_y: Tensor  # half size along the outline's y; 0 for a cylinder
    rounding: Tensor  # radius of a cylinder, otherwise 0
    x_rest: Tensor  # remaining bits of the centre
    y_rest: Tensor  # remaining bits of the centre

    def look_from(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Return positions (rooms,), float64, relative to the centres, in single precision."""
        return _subtract(x, self.x, self.x_rest), _subtract(y, self.y, self.y_rest)


class RoomSolids(NamedTuple):
    """Walls and obstacles of each room of a batch."""

    every: Shapes  # solids of all instances, (solids, instances)
    in_single: SplitShapes  # the same in single precision
    instance: Tensor | None  # index of each room's instance, int64 (rooms,), or None if there is only one

    def list_all(self) -> Shapes:
        """Return all solids, (solids, rooms)."""
        return self.every if self.instance is None else Shapes(*(field[..., self.instance] for field in self.every))

    def list_split(self) -> SplitShapes:
        """Return all solids in single precision, (solids, rooms)."""
        if self.instance is None:
            return self.in_single
        return SplitShapes(*(field[..., self.instance] for field in self.in_single))

    def gather(self, which: Tensor) -> Shapes:
        """Return one solid of each room, (1, rooms), by its index, int64 (rooms,)."""
        column = torch.zeros_like(which) if self.instance is None else self.instance
        return Shapes(*(field[which, column].unsqueeze(0) for field in self.every))


def stack_shapes(rows: Sequence[Sequence[Footprint]], least: int = 1) -> NDArray[np.float64]:
    """Stack the `Shapes` of several instances, padded with distant outlines: (7, shapes, instances)."""
    most = max(least, 1, *(len(row) for row in rows))
    table = np.zeros((7, most, len(rows)))
    table[0], table[2] = _NEVER, 1.0
    for k, row in enumerate(rows):
        for s, (is_disc, x, y, cos, sin, half_x, half_y) in enumerate(row):
            table[:, s, k] = (x, y, 1.0, 0.0, 0.0, 0.0, half_x) if is_disc else (x, y, cos, sin, half_x, half_y, 0.0)
    return table


def compute_distance(x: Tensor, y: Tensor, shapes: Shapes) -> Tensor:
    """Return the distance from points (rooms,), float64, to outlines; 0 inside. Shape (shapes, rooms)."""
    px, py = shapes.look_from(x, y)
    qx = ((shapes.cos * px + shapes.sin * py).abs() - shapes.half_x).clamp(min=0.0)
    qy = ((shapes.cos * py - shapes.sin * px).abs() - shapes.half_y).clamp(min=0.0)
    return (torch.sqrt(qx * qx + qy * qy) - shapes.rounding).clamp(min=0.0)


def compute_first_contact(x: Tensor, y: Tensor, dx: Tensor, dy: Tensor, radius: float,
                          shapes: Shapes | SplitShapes) -> Tensor:
    """Return the fraction of displacements that discs make before they meet each outline; radii include the clearance.

    This is `geometry.compute_first_contact` without branches. The disc's centre enters the box grown by the radius.
    From there it enters the circle around the nearest point of the box: the corner, if it entered at a rounded corner,
    and otherwise a point at almost no distance. A disc already in contact stops only if it moves inwards.

    Returns:
        Shape (shapes, rooms), in [0, 1]; 1 if the disc passes a shape. Negative if the disc is in contact and stopped:
        the straighter it moves inwards, the lower the value. The lowest of several is the most reliable.
    """
    motion = _Motion.make(x, y, dx, dy, shapes)
    eps = torch.finfo(motion.vx.dtype).eps
    graze = max(1e-9, 8 * eps)
    reach = shapes.rounding + radius
    wide_x, wide_y = shapes.half_x + reach, shapes.half_y + reach
    rounding = max(1e-12, 16 * eps) * reach * (wide_x + shapes.half_y)  # rounding error of a squared distance

    # Pass through the grown box: time until the centre is level with the outline's, and from there to the edge.
    ux, uy = motion.vx + _TINY, motion.vy + _TINY
    per = torch.reciprocal(ux * uy)
    per_x, per_y = per * uy, per * ux
    mid_x, mid_y = motion.ox * per_x, motion.oy * per_y  # negated
    half_x, half_y = wide_x * per_x.abs(), wide_y * per_y.abs()
    entered = torch.minimum(mid_x + half_x, mid_y + half_y)  # negated: at least 0 if it starts inside
    enter = torch.relu(-entered)
    passes = (enter > half_x - mid_x) | (enter > half_y - mid_y)

    # The circle, seen from the nearest point of the box.
    wx = _shrink(motion.ox + enter * motion.vx, shapes.half_x)
    wy = _shrink(motion.oy + enter * motion.vy, shapes.half_y)
    along, cross = wx * motion.vx + wy * motion.vy, wx * motion.vy - wy * motion.vx
    away, reach_square = wx * wx + wy * wy, reach * reach
    gap, root = away - reach_square, motion.square * reach_square - cross * cross  # equals along**2 - square * gap
    share = enter + gap / (torch.sqrt(torch.relu(root)) - along)
    is_inwards = along < -graze * cross.abs()
    is_near = gap <= rounding
    is_met = is_inwards & (is_near | (root > motion.square * rounding))  # a tangent is not a contact
    # From inside the box itself, the nearer axis decides.
    is_along_x = motion.ox.abs() - shapes.half_x > motion.oy.abs() - shapes.half_y
    outwards = torch.where(is_along_x, motion.ox * motion.vx, motion.oy * motion.vy)
    is_met = (is_met | ((away == 0.0) & (outwards < 0.0))) & ~passes & (share < 1.0)
    return torch.where(is_met, torch.where(is_near & (entered >= 0.0), along, torch.relu(share)), 1.0)


def refine_first_contact(x: Tensor, y: Tensor, dx: Tensor, dy: Tensor, radius: float, shapes: Shapes,
                         share: Tensor) -> Tensor:
    """Return the fraction of displacements until discs meet one outline per room, from approximate fractions `share`.

    `share` has shape (shapes, rooms). The disc meets the side or corner that faces it after that fraction. The result
    is exact to the outlines' type if the disc moves inwards there. Otherwise it has no meaning and can be NaN.
    """
    motion, reach = _Motion.make(x, y, dx, dy, shapes), shapes.rounding + radius
    ex, ey = motion.ox + share * motion.vx, motion.oy + share * motion.vy
    is_beside_x, is_beside_y = ex.abs() > shapes.half_x, ey.abs() > shapes.half_y
    kx = motion.ox - torch.where(ex < 0.0, -shapes.half_x, shapes.half_x)
    ky = motion.oy - torch.where(ey < 0.0, -shapes.half_y, shapes.half_y)
    along, cross = kx * motion.vx + ky * motion.vy, kx * motion.vy - ky * motion.vx
    reach_square = reach * reach
    root = motion.square * reach_square - cross * cross  # equals along**2 - square * gap, without its cancellation
    side = torch.where(is_beside_x, motion.ox.abs() - shapes.half_x, motion.oy.abs() - shapes.half_y) - reach
    speed = torch.where(is_beside_x, motion.vx, motion.vy).abs()
    gap = torch.where(is_beside_x, torch.where(is_beside_y, kx * kx + ky * ky - reach_square, side), side)
    return gap / torch.where(is_beside_x, torch.where(is_beside_y, torch.sqrt(torch.relu(root)) - along, speed), speed)


class _Motion(NamedTuple):
    """Centres and displacements of discs in the frames of outlines, and the squares of the displacements."""

    ox: Tensor
    oy: Tensor
    vx: Tensor
    vy: Tensor
    square: Tensor

    @classmethod
    def make(cls, x: Tensor, y: Tensor, dx: Tensor, dy: Tensor, shapes: Shapes | SplitShapes) -> _Motion:
        px, py = shapes.look_from(x, y)
        square = dx * dx + dy * dy
        if shapes.cos.dtype == torch.float32:
            dx, dy, square = (store(number.to(torch.float32)) for number in (dx, dy, square))
        return cls(shapes.cos * px + shapes.sin * py, shapes.cos * py - shapes.sin * px,
                   shapes.cos * dx + shapes.sin * dy, shapes.cos * dy - shapes.sin * dx, square)


def _subtract(place: Tensor, centre: Tensor, rest: Tensor) -> Tensor:
    """Difference of positions in double precision, rounded to single: leading bits and rest separately."""
    near = store(place.to(torch.float32))
    return (near - centre) + (store((place - near).to(torch.float32)) - rest)


def _shrink(offset: Tensor, half: Tensor) -> Tensor:
    """Offset from the nearest point within `half` of 0. `relu`, because `clamp` treats NaN differently."""
    return torch.relu(offset - half) - torch.relu(-half - offset)


def _invert(velocity: Tensor) -> Tensor:
    return 1.0 / torch.where(velocity.abs() < _TINY, _TINY, velocity)


def cast_rays(x: Tensor, y: Tensor, ray_x: Tensor, ray_y: Tensor, shapes: Shapes) -> Tensor:
    """Return the range (rays, shapes, rooms), m, of rays from points (rooms,) to each outline; infinity for a miss.

    Directions are unit vectors (rays, 1, rooms); outlines have (shapes, rooms) fields. At most 0 from inside a box.
    """
    px, py = shapes.look_from(x, y)
    along = px * ray_x + py * ray_y
    root = along * along - (px * px + py * py - shapes.rounding * shapes.rounding)
    disc = torch.where((root >= 0.0) & (along < 0.0), -along - torch.sqrt(root.clamp(min=0.0)), math.inf)
    ox, oy = shapes.cos * px + shapes.sin * py, shapes.cos * py - shapes.sin * px
    vx, vy = shapes.cos * ray_x + shapes.sin * ray_y, shapes.cos * ray_y - shapes.sin * ray_x
    per_x, per_y = _invert(vx), _invert(vy)
    x1, x2 = (-shapes.half_x - ox) * per_x, (shapes.half_x - ox) * per_x
    y1, y2 = (-shapes.half_y - oy) * per_y, (shapes.half_y - oy) * per_y
    enter = torch.maximum(torch.minimum(x1, x2), torch.minimum(y1, y2))
    leave = torch.minimum(torch.maximum(x1, x2), torch.maximum(y1, y2))
    box = torch.where((enter <= leave) & (leave >= 0.0), enter, math.inf)
    return torch.where(shapes.rounding > 0.0, disc, box)
