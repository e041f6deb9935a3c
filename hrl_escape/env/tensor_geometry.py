"""Planar geometry of a disc among boxes and cylinders, in tensors: distances, first contact, rays.

The rules are those of `geometry.py`, written without branches so that they compile into one
loop over rooms. A cylinder is a box without extent, rounded by its radius; so every outline
here is a rounded box. Shapes come first, rooms last. Metres.

Places are double precision; offsets from an outline are computed in the outline's own
type: double, or single if thousands are searched (`Shapes.round`, `Shapes.split`).
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

_NEVER = 1e6  # position of the outlines that only pad a table
_TINY = 1e-18  # keeps a velocity from zero


def store(value: Tensor) -> Tensor:
    """Return the value itself, which a compiled kernel then computes once and stores.

    The compiler would compute again, in every turn of a loop over solids, whatever the rooms bring to it: gathers
    from tables, above all. Nothing fuses across a change of strides, be it to the same ones.
    """
    return value.as_strided(value.shape, value.stride())


def wrap(number: Tensor, period: Tensor | int) -> Tensor:
    """Remainder of whole numbers, 0 or more, of the same dtype; exact below 2^22.

    In single precision: vectors have no division of whole numbers.
    """
    whole = number.to(torch.float32)
    return (whole - torch.floor((whole + 0.5) / period) * period).to(number.dtype)


def as_flags(where: Tensor) -> Tensor:
    """The same truth values, found in double precision, in the form in which kernels combine truth values, bool.

    The compiler combines them 32 bits wide, and would narrow the 64-bit outcomes of comparisons one by one.
    """
    return torch.where(where, 1.0, 0.0).to(torch.float32) > 0.5


class Shapes(NamedTuple):
    """Outlines on the floor, one a row; each field is (shapes, rooms), or (shapes, 1) shared by all rooms."""

    x: Tensor  # centre, float64
    y: Tensor  # centre, float64
    cos: Tensor  # direction of its own x; this and the following are float64, or float32 once rounded
    sin: Tensor  # direction of its own x
    half_x: Tensor  # half size along its own x; 0 for a cylinder
    half_y: Tensor  # half size along its own y; 0 for a cylinder
    rounding: Tensor  # a cylinder's radius, else 0

    def round(self) -> Shapes:
        """The same outlines in single precision, about their exact centres."""
        return Shapes(self.x, self.y, *(field.to(torch.float32) for field in self[2:]))

    def look_from(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Places (rooms,), float64, relative to the centres, in the outlines' own type."""
        return (x - self.x).to(self.cos.dtype), (y - self.y).to(self.cos.dtype)

    def split(self) -> SplitShapes:
        """The same outlines in single precision throughout, which the search for the first contact takes."""
        near = (field.to(torch.float32) for field in self)
        return SplitShapes(*near, *((field - field.to(torch.float32)).to(torch.float32) for field in self[:2]))


class SplitShapes(NamedTuple):
    """Outlines in single precision, their centres as sums of two numbers; each field is float32, as in `Shapes`."""

    x: Tensor  # centre, its leading bits
    y: Tensor  # centre, its leading bits
    cos: Tensor  # direction of its own x
    sin: Tensor  # direction of its own x
    half_x: Tensor  # half size along its own x; 0 for a cylinder
    half_y: Tensor  # half size along its own y; 0 for a cylinder
    rounding: Tensor  # a cylinder's radius, else 0
    x_rest: Tensor  # what the centre has beyond its leading bits
    y_rest: Tensor  # likewise

    def look_from(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Places (rooms,), float64, relative to the centres, in single precision."""
        return _subtract(x, self.x, self.x_rest), _subtract(y, self.y, self.y_rest)


class RoomSolids(NamedTuple):
    """Walls and obstacles of each room of a batch."""

    every: Shapes  # those of all instances, (solids, instances)
    in_single: SplitShapes  # the same in single precision
    instance: Tensor | None  # index of each room's instance, int64 (rooms,); None where there is one

    def list_all(self) -> Shapes:
        """All of them, (solids, rooms)."""
        return self.every if self.instance is None else Shapes(*(field[..., self.instance] for field in self.every))

    def list_split(self) -> SplitShapes:
        """All of them in single precision, (solids, rooms)."""
        if self.instance is None:
            return self.in_single
        return SplitShapes(*(field[..., self.instance] for field in self.in_single))

    def gather(self, which: Tensor) -> Shapes:
        """One of each room, (1, rooms), by its number, int64 (rooms,)."""
        column = torch.zeros_like(which) if self.instance is None else self.instance
        return Shapes(*(field[which, column].unsqueeze(0) for field in self.every))


def stack_shapes(rows: Sequence[Sequence[Footprint]], least: int = 1) -> NDArray[np.float64]:
    """Stack the `Shapes` of several instances, filled up to the same number with far ones: (7, shapes, instances)."""
    most = max(least, 1, *(len(row) for row in rows))
    table = np.zeros((7, most, len(rows)))
    table[0], table[2] = _NEVER, 1.0
    for k, row in enumerate(rows):
        for s, (is_disc, x, y, cos, sin, half_x, half_y) in enumerate(row):
            table[:, s, k] = (x, y, 1.0, 0.0, 0.0, 0.0, half_x) if is_disc else (x, y, cos, sin, half_x, half_y, 0.0)
    return table


def compute_distance(x: Tensor, y: Tensor, shapes: Shapes) -> Tensor:
    """Distance from points (rooms,), float64, to outlines; 0 inside. Shape (shapes, rooms)."""
    px, py = shapes.look_from(x, y)
    qx = ((shapes.cos * px + shapes.sin * py).abs() - shapes.half_x).clamp(min=0.0)
    qy = ((shapes.cos * py - shapes.sin * px).abs() - shapes.half_y).clamp(min=0.0)
    return (torch.sqrt(qx * qx + qy * qy) - shapes.rounding).clamp(min=0.0)


def compute_first_contact(x: Tensor, y: Tensor, dx: Tensor, dy: Tensor, radius: float,
                          shapes: Shapes | SplitShapes) -> Tensor:
    """Share of displacements that discs can make before they meet each outline; radii include the clearance.

    The branch-free form of `geometry.compute_first_contact`: the disc's centre enters the box grown by the radius;
    from there, it enters the circle about the point of the box that is nearest to it, which is the corner where it
    entered at a rounded corner, and next to nothing away elsewhere. A disc that touches already is stopped only if
    it moves inwards.

    Returns:
        Shape (shapes, rooms), in [0, 1]; 1 if a shape lets the disc pass. Less than 0 if the disc touches already
        and is stopped: the less, the straighter inwards it moves, so that of several the least is the surest.
    """
    motion = _Motion.make(x, y, dx, dy, shapes)
    eps = torch.finfo(motion.vx.dtype).eps
    graze = max(1e-9, 8 * eps)
    reach = shapes.rounding + radius
    wide_x, wide_y = shapes.half_x + reach, shapes.half_y + reach
    rounding = max(1e-12, 16 * eps) * reach * (wide_x + shapes.half_y)  # of a squared distance

    # passing through the grown box: time until the centre is level with the outline's, and time from there to the edge
    ux, uy = motion.vx + _TINY, motion.vy + _TINY
    per = torch.reciprocal(ux * uy)
    per_x, per_y = per * uy, per * ux
    mid_x, mid_y = motion.ox * per_x, motion.oy * per_y  # with the other sign
    half_x, half_y = wide_x * per_x.abs(), wide_y * per_y.abs()
    entered = torch.minimum(mid_x + half_x, mid_y + half_y)  # with the other sign: 0 or more if it is in it already
    enter = torch.relu(-entered)
    passes = (enter > half_x - mid_x) | (enter > half_y - mid_y)

    # from there, seen from the nearest point of the box
    wx = _shrink(motion.ox + enter * motion.vx, shapes.half_x)
    wy = _shrink(motion.oy + enter * motion.vy, shapes.half_y)
    along, cross = wx * motion.vx + wy * motion.vy, wx * motion.vy - wy * motion.vx
    away, reach_square = wx * wx + wy * wy, reach * reach
    gap, root = away - reach_square, motion.square * reach_square - cross * cross  # along**2 - square * gap
    share = enter + gap / (torch.sqrt(torch.relu(root)) - along)
    is_inwards = along < -graze * cross.abs()
    is_near = gap <= rounding
    is_met = is_inwards & (is_near | (root > motion.square * rounding))  # a tangent is no hit, whatever the rounding
    # from within the box itself: along the nearer axis
    is_along_x = motion.ox.abs() - shapes.half_x > motion.oy.abs() - shapes.half_y
    outwards = torch.where(is_along_x, motion.ox * motion.vx, motion.oy * motion.vy)
    is_met = (is_met | ((away == 0.0) & (outwards < 0.0))) & ~passes & (share < 1.0)
    return torch.where(is_met, torch.where(is_near & (entered >= 0.0), along, torch.relu(share)), 1.0)


def refine_first_contact(x: Tensor, y: Tensor, dx: Tensor, dy: Tensor, radius: float, shapes: Shapes,
                         share: Tensor) -> Tensor:
    """Share of displacements until discs meet outlines, one a room, from shares (shapes, rooms) that are nearly right.

    The outline is met at the side or corner that faces the disc after that share. The result is exact to the
    outlines' type if the disc is moving inwards there, and else means nothing; it may not be a number.
    """
    motion, reach = _Motion.make(x, y, dx, dy, shapes), shapes.rounding + radius
    ex, ey = motion.ox + share * motion.vx, motion.oy + share * motion.vy
    is_beside_x, is_beside_y = ex.abs() > shapes.half_x, ey.abs() > shapes.half_y
    kx = motion.ox - torch.where(ex < 0.0, -shapes.half_x, shapes.half_x)
    ky = motion.oy - torch.where(ey < 0.0, -shapes.half_y, shapes.half_y)
    along, cross = kx * motion.vx + ky * motion.vy, kx * motion.vy - ky * motion.vx
    reach_square = reach * reach
    root = motion.square * reach_square - cross * cross  # along**2 - square * gap, without its cancellation
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
    """Differences of places in double precision, as single ones: of the leading bits, and of the rest."""
    near = store(place.to(torch.float32))
    return (near - centre) + (store((place - near).to(torch.float32)) - rest)


def _shrink(offset: Tensor, half: Tensor) -> Tensor:
    """Offsets from the nearest place within `half` of 0. `relu`, not `clamp`, which treats NaN differently."""
    return torch.relu(offset - half) - torch.relu(-half - offset)


def _invert(velocity: Tensor) -> Tensor:
    return 1.0 / torch.where(velocity.abs() < _TINY, _TINY, velocity)


def cast_rays(x: Tensor, y: Tensor, ray_x: Tensor, ray_y: Tensor, shapes: Shapes) -> Tensor:
    """Range (rays, shapes, rooms), m, of rays from points (rooms,) to each outline; infinity where one is missed.

    Directions are unit vectors (rays, 1, rooms), outlines have (shapes, rooms) fields. 0 or less from inside a box.
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
