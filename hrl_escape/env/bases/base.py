"""The contract of all bases, and what follows from it.

A base is defined by four pure functions of numbers, which planners compile unchanged, and by their counterparts in
tensors. Poses are those of its axis. Metres, radians.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Protocol
from xml.etree import ElementTree

from typing_extensions import Self

from hrl_escape.env.geometry import Footprint

if TYPE_CHECKING:
    from torch import Tensor

    from hrl_escape.env.tensor_geometry import RoomSolids, Shapes


STANDS_IN = 1e-6
"""Overlap with a shut door, m, beyond which a base counts as standing in it: the door then lets it out."""


class TensorBase(Protocol):
    """A base placed in each room of a batch; in its tensors shapes come first, rooms last."""

    def find_free_fraction(self, dx: Tensor, dy: Tensor, solids: RoomSolids) -> Tensor:
        """Share in [0, 1] of displacements until the first contact with any solid, float64 (rooms,)."""
        ...

    def compute_first_contact(self, dx: Tensor, dy: Tensor, shapes: Shapes) -> Tensor:
        """Share in [0, 1] of displacements until the first contact with each outline, (shapes, rooms)."""
        ...

    def compute_distance(self, shapes: Shapes) -> Tensor:
        """Distance to boxes, (shapes, rooms); 0 where they overlap."""
        ...

    def stands_in(self, shapes: Shapes) -> Tensor:
        """Return true where the base overlaps outlines by more than `STANDS_IN`, bool (shapes, rooms)."""
        ...

    def is_turn_blocked(self, to_cos: Tensor, to_sin: Tensor, turn: Tensor, shapes: Shapes) -> Tensor:
        """Return true where an outline blocks a turn by an angle in rad, bool (shapes, rooms)."""
        ...


@dataclass(frozen=True)
class Base(ABC):
    """The outline of a robot on the floor."""

    size: tuple[float, ...]  # distances of its sides from its axis, m; each grows by the clearance
    turns_anywhere: ClassVar[bool] = False
    """True if it covers the same floor at every heading. Parts that ignore headings need such a base: puzzles with
    inner doors or props, paths of places and their smoothing, repaired fields."""
    symmetry: ClassVar[int] = 1
    """Number of headings, evenly spread over a full turn, at which it covers the same; 0 if all do."""
    front_field: ClassVar[str]  # name of the setting that gives the distance to its front, for messages
    width_field: ClassVar[str]  # name of the setting that gives its width, for messages
    contact: ClassVar[Callable[..., float]]
    """(x, y, cos, sin, size, dx, dy, footprint) -> share in [0, 1) of a displacement at which it first meets the
    footprint, or infinity; one that touches already is stopped (0) only if it moves inwards."""
    gap: ClassVar[Callable[..., float]]
    """(x, y, cos, sin, size, footprint) -> gap, negative where they overlap: it has the sign of the distance and is
    never larger."""
    distance: ClassVar[Callable[..., float]]  # (x, y, cos, sin, size, footprint) -> distance, 0 where they overlap
    blocks_turn: ClassVar[Callable[..., bool]]
    """(x, y, cos, sin, to_cos, to_sin, turn, size, footprint) -> whether the footprint, clear of it, is in the way of a
    turn by an angle about its axis."""

    @classmethod
    @abstractmethod
    def measure(cls, robot: Any) -> Self:
        """The base of a `RobotConfig`, without clearance."""

    @property
    @abstractmethod
    def inner_radius(self) -> float:
        """Radius of the largest disc round the axis within the base, m: where it does not fit, no heading helps."""

    @property
    @abstractmethod
    def outer_radius(self) -> float:
        """Radius of the smallest disc round the axis that holds the base, m: where it fits, any heading does."""

    @property
    @abstractmethod
    def front(self) -> float:
        """Distance from the axis to the front, m."""

    @property
    @abstractmethod
    def corners(self) -> tuple[tuple[float, float], ...]:
        """Corners (x, y) in the base's own frame, counter-clockwise, m; empty for a round base."""

    @abstractmethod
    def describe(self) -> str:
        """Describe shape and sizes in words, for messages."""

    @abstractmethod
    def make_link(self, name: str, mass: float, height: float) -> ElementTree.Element:
        """Make the base's URDF link, upright on the floor; kg, m."""

    @abstractmethod
    def place(self, x: Tensor, y: Tensor, find_rotation: Callable[[], tuple[Tensor, Tensor]]) -> TensorBase:
        """Place it in each room of a batch, at the heading of a cosine and sine; all tensors are float64 (rooms,)."""

    def grow(self, margin: float) -> Self:
        """The base with a clearance on all sides, m."""
        return replace(self, size=tuple(side + margin for side in self.size))

    def find_free_fraction(self, x: float, y: float, rotation: tuple[float, float], dx: float, dy: float,
                           shapes: Iterable[Footprint]) -> float:
        """Share in [0, 1] of a displacement until the first contact with any of some footprints."""
        contact, size, (cos, sin), least = self.contact, self.size, rotation, 1.0
        for shape in shapes:
            met = contact(x, y, cos, sin, size, dx, dy, shape)
            if met < least:
                least = met
        return least

    def measure_gap(self, x: float, y: float, rotation: tuple[float, float], shapes: Iterable[Footprint]) -> float:
        """Least gap to any of some footprints, m; see `gap`."""
        return min((self.gap(x, y, *rotation, self.size, shape) for shape in shapes), default=math.inf)

    def measure_distance(self, x: float, y: float, rotation: tuple[float, float], shape: Footprint) -> float:
        """Distance to a footprint, m; 0 where they overlap."""
        return self.distance(x, y, *rotation, self.size, shape)

    def stands_in(self, x: float, y: float, rotation: tuple[float, float], shape: Footprint) -> bool:
        """Return whether the base overlaps a footprint by more than `STANDS_IN`: a shut door then lets it out."""
        return self.gap(x, y, *rotation, self.size, shape) < -STANDS_IN

    def can_turn(self, x: float, y: float, rotation: tuple[float, float], to: tuple[float, float], turn: float,
                 shapes: Iterable[Footprint]) -> bool:
        """Return whether a turn from one rotation to another is free of all of some footprints."""
        return not any(self.blocks_turn(x, y, *rotation, *to, turn, self.size, shape) for shape in shapes)

    def find_corners_at(self, x: float, y: float, heading: float) -> Sequence[tuple[float, float]]:
        """Corners (x, y) of the base at a pose, counter-clockwise, m; empty for a round base."""
        cos, sin = math.cos(heading), math.sin(heading)
        return [(x + cos * a - sin * b, y + sin * a + cos * b) for a, b in self.corners]


def make_cylinder_link(name: str, mass: float, radius: float, length: float, xyz: str,
                       rpy: str) -> ElementTree.Element:
    """Make a link that is a cylinder along its own z, placed in the link's frame; kg, m, rad."""
    side = mass * (3 * radius**2 + length**2) / 12
    shape = f'<cylinder radius="{radius!r}" length="{length!r}"/>'
    return _make_link(name, mass, shape, (side, side, mass * radius**2 / 2), f'<origin xyz="{xyz}" rpy="{rpy}"/>')


def make_box_link(name: str, mass: float, size: tuple[float, float, float], xyz: str) -> ElementTree.Element:
    """Make a link that is a box along its own axes, placed in the link's frame; kg, m."""
    squares = [side**2 for side in size]
    x, y, z = (mass * (sum(squares) - square) / 12 for square in squares)
    return _make_link(name, mass, f'<box size="{" ".join(map(repr, size))}"/>', (x, y, z),
                      f'<origin xyz="{xyz}" rpy="0 0 0"/>')


def _make_link(name: str, mass: float, geometry: str, inertia: tuple[float, float, float],
               place: str) -> ElementTree.Element:
    (x, y, z), shape = inertia, f"{place}<geometry>{geometry}</geometry>"
    return ElementTree.fromstring(
        f'<link name="{name}"><inertial>{place}<mass value="{mass!r}"/>'
        f'<inertia ixx="{x!r}" iyy="{y!r}" izz="{z!r}" ixy="0" ixz="0" iyz="0"/>'
        f"</inertial><visual>{shape}</visual><collision>{shape}</collision></link>"
    )
