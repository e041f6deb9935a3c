"""Settings of the panels, pads and props that a puzzle asks the room to place."""

from __future__ import annotations

import dataclasses
import math
from functools import cached_property
from typing import Annotated, Literal

from hrl_escape.env.schema import HashedSettings
from hrl_escape.settings import Range


@dataclasses.dataclass(frozen=True)
class Place(HashedSettings):
    """An explicit place of a panel's centre.

    `yaw_deg` is the direction of its width. If `z` is None, the panels' `centre_height` applies.
    """

    _section = "place"
    x: Annotated[float, Range(-110, 110, "m")] = 0.0
    """Centre along x, room frame."""
    y: Annotated[float, Range(-110, 110, "m")] = 0.0
    """Centre along y, room frame."""
    yaw_deg: Annotated[float, Range(-360, 360, "deg")] = 0.0
    """Direction of the width, counter-clockwise from +x."""
    z: Annotated[float, Range(0, 50, "m")] | None = None
    """Height of the centre."""


@dataclasses.dataclass(frozen=True)
class Panels(HashedSettings):
    """Sizes and places of panels: boxes on the walls that are pressed by touch."""

    _section = "panels"
    _takes_ranges = True
    width: Annotated[float, Range(0.02, 200, "m")] = 1.0
    """Size along the wall."""
    height: Annotated[float, Range(0.02, 50, "m")] = 1.0
    """Vertical size of a panel."""
    thickness: Annotated[float, Range(0.005, 10, "m")] = 0.1
    """Size away from the wall."""
    centre_height: Annotated[float, Range(0, 50, "m")] = 0.75
    """Height of the centre."""
    height_spread: Annotated[float, Range(0, 50, "m")] = 0.0
    """Largest deviation of a centre from `centre_height`. More variation requires an arm with more reach."""
    inset: Annotated[float, Range(0, 50, "m")] | None = None
    """Distance of the centre from its wall, or None for flush panels."""
    places: Literal["random", "paper"] | tuple[Place, ...] = "random"
    """Places of panels: anywhere on the walls, at the four places of the paper, or at explicit places."""
    gap: Annotated[float, Range(0, 50, "m")] = 0.0
    """Smallest gap between two random panels. Twice the robot's reach ensures that it touches only one at a time."""


@dataclasses.dataclass(frozen=True)
class Pads(HashedSettings):
    """Size and places of pads: rectangles on the floor, pressed when the body's axis enters them."""

    _section = "pads"
    _takes_ranges = True
    width: Annotated[float, Range(0.02, 200, "m")] = 2.0
    """Size along the pad's x."""
    depth: Annotated[float, Range(0.02, 200, "m")] = 2.0
    """Size along the pad's y."""
    places: Literal["random"] | tuple[Place, ...] = "random"
    """Places of pads: anywhere on the floor parallel to the walls, or at explicit places."""


@dataclasses.dataclass(frozen=True)
class Capsule(HashedSettings):
    """A region of the floor: all points within a radius of a segment. The robot can drive through it."""

    _section = "capsule"
    x1: Annotated[float, Range(-110, 110, "m")] = 0.0
    """x of one end of the segment."""
    y1: Annotated[float, Range(-110, 110, "m")] = 0.0
    """y of one end of the segment."""
    x2: Annotated[float, Range(-110, 110, "m")] = 0.0
    """x of the other end of the segment."""
    y2: Annotated[float, Range(-110, 110, "m")] = 0.0
    """y of the other end of the segment."""
    radius: Annotated[float, Range(0.01, 100, "m")] = 1.0
    """Radius of the region around the segment."""

    @cached_property
    def _segment(self) -> tuple[float, float, float, float, float]:
        """The first end of the segment, the way to the other, and its squared length."""
        along_x, along_y = self.x2 - self.x1, self.y2 - self.y1
        return self.x1, self.y1, along_x, along_y, along_x * along_x + along_y * along_y

    def compute_depth(self, x: float, y: float) -> float:
        """Return the depth of a point inside the region, m: its distance from the edge, or 0 outside."""
        x1, y1, along_x, along_y, length = self._segment
        to_x, to_y = x - x1, y - y1
        share = (to_x * along_x + to_y * along_y) / length if length else 0.0
        share = 0.0 if share < 0.0 else 1.0 if share > 1.0 else share  # a third of the time of min and max
        off_x, off_y = to_x - share * along_x, to_y - share * along_y
        depth = self.radius - math.sqrt(off_x * off_x + off_y * off_y)
        return depth if depth > 0.0 else 0.0


@dataclasses.dataclass(frozen=True)
class Prop(HashedSettings):
    """A prop on the floor: a movable block (physics dynamics only), or a flat plate."""

    _section = "prop"
    name: str = "block"
    """Unique name of the prop within the puzzle."""
    kind: Literal["block", "plate"] = "block"
    """A movable solid, or a flat region."""
    half_size: Annotated[float, Range(0.05, 10, "m")] = 0.3
    """Half the side of the square footprint."""
    height: Annotated[float, Range(0.01, 10, "m")] = 0.4
    """Height of a block; plates are flat."""
    mass: Annotated[float, Range(0.01, 10_000, "kg")] = 5.0
    """Mass of a block; plates do not move."""
