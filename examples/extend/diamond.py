"""A base: a square that points ahead with a corner."""

from __future__ import annotations

import math
from typing import Any

from typing_extensions import Self

from hrl_escape.env.bases.base import Base, make_box_link
from hrl_escape.env.bases.rectangle import (
    TensorRectangle,
    compute_base_contact,
    compute_base_distance,
    is_turn_blocked,
    measure_base_gap,
)

HALF = math.sqrt(0.5)  # cosine and sine of the eighth of a turn between its corner and its side


def meet(x, y, cos, sin, size, dx, dy, shape):
    """Compute the share of a move up to the first contact with a shape."""
    return compute_base_contact(x, y, HALF * (cos - sin), HALF * (sin + cos), size, dx, dy, shape)


def leave(x, y, cos, sin, size, shape):
    """Measure the gap to a shape."""
    return measure_base_gap(x, y, HALF * (cos - sin), HALF * (sin + cos), size, shape)


def part(x, y, cos, sin, size, shape):
    """Compute the distance to a shape."""
    return compute_base_distance(x, y, HALF * (cos - sin), HALF * (sin + cos), size, shape)


def bar(x, y, cos, sin, to_cos, to_sin, turn, size, shape):
    """Return whether a shape blocks a turn."""
    return is_turn_blocked(x, y, HALF * (cos - sin), HALF * (sin + cos), HALF * (to_cos - to_sin),
                           HALF * (to_sin + to_cos), turn, size, shape)


class TensorDiamond(TensorRectangle):
    """The base in tensors, for batches."""

    def is_turn_blocked(self, to_cos, to_sin, turn, shapes):
        """Return which shapes block a turn."""
        return super().is_turn_blocked(HALF * (to_cos - to_sin), HALF * (to_sin + to_cos), turn, shapes)


class Diamond(Base):
    """Its corners are `body_radius` from its axis."""

    front_field = width_field = "body_radius"
    contact, gap, distance, blocks_turn = staticmethod(meet), staticmethod(leave), staticmethod(part), staticmethod(bar)
    symmetry = 4

    @classmethod
    def measure(cls, robot: Any) -> Self:
        """Make the base of a robot's configuration."""
        return cls((HALF * robot.body_radius, HALF * robot.body_radius))

    @property
    def inner_radius(self):
        """Radius of the largest disc within the base, m."""
        return self.size[0]

    @property
    def outer_radius(self):
        """Radius of the smallest disc round the base, m."""
        return self.size[0] / HALF

    front = outer_radius

    @property
    def corners(self):
        """Corners at heading 0, m."""
        reach = self.size[0] / HALF
        return (reach, 0.0), (0.0, reach), (-reach, 0.0), (0.0, -reach)

    def describe(self):
        """Describe the base for messages."""
        return f"a diamond of {2 * self.outer_radius:g} m"

    def make_link(self, name, mass, height):
        """Make the URDF link of the base."""
        link = make_box_link(name, mass, (2 * self.size[0], 2 * self.size[1], height), f"0 0 {height / 2!r}")
        for origin in link.iter("origin"):
            origin.set("rpy", f"0 0 {math.pi / 4!r}")
        return link

    def place(self, x, y, find_rotation):
        """Place the base of each room of a batch."""
        cos, sin = find_rotation()
        return TensorDiamond(x, y, HALF * (cos - sin), HALF * (sin + cos), self.size)
