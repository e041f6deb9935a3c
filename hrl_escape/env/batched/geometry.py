"""Planar geometry of a disc among boxes and cylinders, in tensors: distances, first contact, rays.

The rules are those of `geometry.py`, written without branches so that they compile into one
loop over rooms. A cylinder is a box without extent, rounded by its radius; so every outline
here is a rounded box. Shapes come first, rooms last. Metres.

Places are double precision; offsets from an outline are computed in the outline's own
type: double, or single if thousands are searched (`Shapes.round`).
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

__all__ = ["Shapes", "cast_rays", "compute_distance", "compute_first_contact", "stack_shapes"]

_NEVER = 1e6  # place of the outlines that only pad a table
_TINY = 1e-30  # stands in for a velocity of zero


class Shapes(NamedTuple):
    """Outlines on the floor, one a row; each field is (shapes, rooms), or (shapes, 1) shared by all rooms.

    Attributes:
        x: centre, float64.
        y: centre, float64.
        cos: direction of its own x; this and the following are float64, or float32 once rounded.
        sin: direction of its own x.
        half_x: half size along its own x; 0 for a cylinder.
        half_y: half size along its own y; 0 for a cylinder.
        rounding: a cylinder's radius, else 0.
    """

    x: Tensor
    y: Tensor
    cos: Tensor
    sin: Tensor
    half_x: Tensor
    half_y: Tensor
    rounding: Tensor

    def round(self) -> Shapes:
        """The same outlines in single precision, about their exact centres."""
        return Shapes(self.x, self.y, *(field.to(torch.float32) for field in self[2:]))

    def look_from(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Places (rooms,), float64, relative to the centres, in the outlines' own type."""
        return (x - self.x).to(self.cos.dtype), (y - self.y).to(self.cos.dtype)


def stack_shapes(rows: Sequence[Sequence[Footprint]], least: int = 1) -> NDArray[np.float64]:
    """Stack the footprints of several instances, filled up to the same number (at least `least`) with far ones.

    Returns:
        Shape (7, shapes, instances), float64; the fields of `Shapes`.
    """
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


def compute_first_contact(x: Tensor, y: Tensor, dx: Tensor, dy: Tensor, radius: float, shapes: Shapes) -> Tensor:
    """Share of displacements that discs can make before they meet each outline.

    The branch-free form of `geometry.compute_first_contact`: where the disc's centre enters the box
    grown by the radius, and, if that is at a rounded corner, where it enters the corner's
    circle. A disc that touches already is stopped only if it moves inwards.

    Args:
        x: disc centres (rooms,), float64.
        y: disc centres (rooms,), float64.
        dx: displacements (rooms,), float64.
        dy: displacements (rooms,), float64.
        radius: disc radius, clearance included.
        shapes: the outlines that may be hit.

    Returns:
        Shape (shapes, rooms), in [0, 1]; 1 if a shape lets the disc pass. Less than 0 if the disc touches already
        and is stopped: the less, the straighter inwards it moves, so that of several the least is the surest.
    """
    dx, dy = dx.to(shapes.cos.dtype), dy.to(shapes.cos.dtype)
    eps = torch.finfo(dx.dtype).eps
    graze = max(1e-9, 8 * eps)
    reach = shapes.rounding + radius
    px, py = shapes.look_from(x, y)
    ox, oy = shapes.cos * px + shapes.sin * py, shapes.cos * py - shapes.sin * px
    vx, vy = shapes.cos * dx + shapes.sin * dy, shapes.cos * dy - shapes.sin * dx
    vx, vy = torch.where(ox < 0.0, -vx, vx), torch.where(oy < 0.0, -vy, vy)  # mirror into the centre's quadrant
    ox, oy = ox.abs(), oy.abs()
    qx, qy = ox - shapes.half_x, oy - shapes.half_y
    square = dx * dx + dy * dy
    reach_square = reach * reach
    rounding = reach * (1e-12 * reach + 16 * eps * (reach + shapes.half_x + shapes.half_y))  # of a squared distance

    # touching already, to the last bits: along the outward normal, or along the nearer axis from within the box
    within = torch.maximum(qx, qy) <= 0.0
    normal_x = torch.where(within & (qx > qy), 1.0, qx.clamp(min=0.0))
    normal_y = torch.where(within & (qx <= qy), 1.0, qy.clamp(min=0.0))
    touching = within | (normal_x * normal_x + normal_y * normal_y <= reach_square + rounding)
    inwards = normal_x * vx + normal_y * vy
    stopped = (inwards < 0.0) & (inwards * inwards > graze * graze * reach_square * square)

    # entering the grown box
    per_x, per_y = _invert(vx), _invert(vy)
    front_x, back_x = (reach - qx) * per_x, (-(shapes.half_x + reach) - ox) * per_x
    front_y, back_y = (reach - qy) * per_y, (-(shapes.half_y + reach) - oy) * per_y
    near_x, near_y = torch.minimum(front_x, back_x), torch.minimum(front_y, back_y)
    near = torch.maximum(near_x, near_y)
    enter = near.clamp(min=0.0)
    leave = torch.minimum(torch.maximum(front_x, back_x), torch.maximum(front_y, back_y)).clamp(max=1.0)
    across = torch.where(near_x > near_y, vx, vy)
    face = (near > 0.0) & (across * across > graze * graze * square)

    # entering at a rounded corner
    ex, ey = ox + enter * vx, oy + enter * vy
    is_corner = (ex.abs() > shapes.half_x) & (ey.abs() > shapes.half_y)
    kx = ox - torch.where(ex < 0.0, -shapes.half_x, shapes.half_x)
    ky = oy - torch.where(ey < 0.0, -shapes.half_y, shapes.half_y)
    along, cross = kx * vx + ky * vy, kx * vy - ky * vx
    root = square * reach_square - cross * cross  # along**2 - square * gap, without its cancellation
    corner = (along < 0.0) & (root > square * rounding)  # a tangent is no hit, however it is rounded
    met_corner = (kx * kx + ky * ky - reach_square) / (torch.sqrt(root.clamp(min=0.0)) - along)

    met = torch.where(torch.where(is_corner, corner, face), torch.where(is_corner, met_corner, enter), 1.0)
    met = torch.where(enter <= leave, met, 1.0)
    return torch.where(touching, torch.where(stopped, inwards, 1.0), met.clamp(0.0, 1.0))


def _invert(velocity: Tensor) -> Tensor:
    return 1.0 / torch.where(velocity.abs() < _TINY, _TINY, velocity)


def cast_rays(x: Tensor, y: Tensor, ray_x: Tensor, ray_y: Tensor, shapes: Shapes) -> Tensor:
    """Range of rays from points (rooms,) to each outline; infinity where one is missed.

    Args:
        x: origins (rooms,), float64.
        y: origins (rooms,), float64.
        ray_x: unit directions (rays, 1, rooms).
        ray_y: unit directions (rays, 1, rooms).
        shapes: outlines with (shapes, rooms) fields.

    Returns:
        Shape (rays, shapes, rooms), metres; 0 or less from inside a box.
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
