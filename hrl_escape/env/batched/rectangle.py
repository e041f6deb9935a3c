"""Planar geometry of a rectangular base in tensors: first contact, gaps, distances and turns.

The rules are those of `env/body/rectangle.py`, which says why they are exact, written without branches over shapes
and rooms. Everything is double precision: a base is one of few, and rectangles touch walls along whole sides.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from hrl_escape.env.batched.geometry import Shapes, compute_distance, compute_first_contact
from hrl_escape.env.body.rectangle import TOUCH, RectangularBase

__all__ = ["TensorBase"]

_GRAZE = 1e-9
_SIGNS = ((1, 1), (1, -1), (-1, 1), (-1, -1))


class TensorBase(NamedTuple):
    """A rectangle in each room; all tensors are float64 (rooms,).

    Attributes:
        x: centre, m.
        y: centre, m.
        cos: of the heading.
        sin: of the heading.
        size: half its sizes, the same in all rooms.
    """

    x: Tensor
    y: Tensor
    cos: Tensor
    sin: Tensor
    size: RectangularBase

    def _as_shapes(self, shapes: Shapes) -> Shapes:
        """The rectangle about each shape's centre, grown by a cylinder's radius: a cylinder meets it as a point."""
        half_length, half_width = self.size
        return Shapes(shapes.x, shapes.y, self.cos, self.sin, torch.full_like(self.cos, half_length),
                      torch.full_like(self.cos, half_width), shapes.rounding)

    def _compute_sides(self, shapes: Shapes) -> list[tuple[Tensor, Tensor, Tensor, Tensor]]:
        """Sides of the polygon of touching places round boxes: (x and y of an axis, place on it, half extent)."""
        half_length, half_width = self.size
        px, py = shapes.look_from(self.x, self.y)
        ahead = (self.cos * shapes.cos + self.sin * shapes.sin).abs()
        aside = (self.sin * shapes.cos - self.cos * shapes.sin).abs()
        return [
            (shapes.cos, shapes.sin, px * shapes.cos + py * shapes.sin,
             shapes.half_x + half_length * ahead + half_width * aside),
            (-shapes.sin, shapes.cos, py * shapes.cos - px * shapes.sin,
             shapes.half_y + half_length * aside + half_width * ahead),
            (self.cos, self.sin, px * self.cos + py * self.sin,
             half_length + shapes.half_x * ahead + shapes.half_y * aside),
            (-self.sin, self.cos, py * self.cos - px * self.sin,
             half_width + shapes.half_x * aside + shapes.half_y * ahead),
        ]

    def measure_gap(self, shapes: Shapes) -> Tensor:
        """Gap to outlines across the axis that separates them best, (shapes, rooms); negative where they overlap."""
        box = torch.stack([place.abs() - half for _, _, place, half in self._compute_sides(shapes)]).amax(0)
        to_disc = compute_distance(self.x, self.y, self._as_shapes(shapes)._replace(
            rounding=torch.zeros_like(shapes.rounding))) - shapes.rounding
        return torch.where(shapes.rounding > 0.0, to_disc, box)

    def compute_distance(self, shapes: Shapes) -> Tensor:
        """Distance to boxes, (shapes, rooms); 0 where they overlap."""
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

    def compute_first_contact(self, dx: Tensor, dy: Tensor, shapes: Shapes) -> Tensor:
        """Share in [0, 1] of displacements until the first contact with each outline, (shapes, rooms)."""
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
        """Return true where an outline is in the way of a turn by an angle in rad, bool (shapes, rooms)."""
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
