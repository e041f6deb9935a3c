"""The interface of all bases, and everything that follows from it.

Four pure functions of numbers, which planners compile unchanged, and their counterparts in tensors define a base. Poses
refer to its axis. Metres, radians.
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
"""Overlap with a shut door, m, above which the base counts as in the doorway. The door then does not block it."""


class TensorBase(Protocol):
    """A base placed in each room of a batch. In its tensors shapes come first, rooms last."""

    def find_free_fraction(self, dx: Tensor, dy: Tensor, solids: RoomSolids) -> Tensor:
        """Return the fraction, in [0, 1], of displacements before the contact with any solid, float64 (rooms,)."""
        ...

    def compute_first_contact(self, dx: Tensor, dy: Tensor, shapes: Shapes) -> Tensor:
        """Return the fraction, in [0, 1], of displacements before the contact with each outline, (shapes, rooms)."""
        ...

    def compute_distance(self, shapes: Shapes) -> Tensor:
        """Return the distance to boxes, (shapes, rooms); 0 if they overlap."""
        ...

    def stands_in(self, shapes: Shapes) -> Tensor:
        """Return whether the base overlaps outlines by more than `STANDS_IN`, bool (shapes, rooms)."""
        ...

    def is_turn_blocked(self, to_cos: Tensor, to_sin: Tensor, turn: Tensor, shapes: Shapes) -> Tensor:
        """Return whether an outline blocks a turn by an angle in rad, bool (shapes, rooms)."""
        ...


@dataclass(frozen=True)
class Base(ABC):
    """The outline of a robot on the floor."""

    size: tuple[float, ...]  # distances of the sides from the axis, m; clearance increases each
    turns_anywhere: ClassVar[bool] = False
    """True if the outline is the same at every heading. Puzzles with inner doors or props, paths of places and their
    smoothing, and repaired fields require such a base."""
    symmetry: ClassVar[int] = 1
    """Number of evenly spaced headings with the same outline; 0 if all have it."""
    front_field: ClassVar[str]  # setting with the distance to the front, for messages
    width_field: ClassVar[str]  # setting with the width, for messages
    contact: ClassVar[Callable[..., float]]
    """(x, y, cos, sin, size, dx, dy, footprint) -> fraction in [0, 1) of a displacement at which the base first meets
    the footprint, or infinity. A base already in contact stops (0) only if it moves inwards."""
    gap: ClassVar[Callable[..., float]]
    """(x, y, cos, sin, size, footprint) -> gap, negative if they overlap. It has the sign of the distance and never
    exceeds it."""
    distance: ClassVar[Callable[..., float]]  # (x, y, cos, sin, size, footprint) -> distance, 0 if they overlap
    blocks_turn: ClassVar[Callable[..., bool]]
    """(x, y, cos, sin, to_cos, to_sin, turn, size, footprint) -> whether the footprint, clear of the base, blocks its
    turn by an angle about its axis."""

    @classmethod
    @abstractmethod
    def measure(cls, robot: Any) -> Self:
        """Return the base of a `RobotConfig`, without clearance."""

    @property
    @abstractmethod
    def inner_radius(self) -> float:
        """Radius, m, of the largest disc inside the base. Where it does not fit, the base collides at every heading."""

    @property
    @abstractmethod
    def outer_radius(self) -> float:
        """Radius, m, of the smallest disc that encloses the base. Where it fits, the base is clear at every heading."""

    @property
    @abstractmethod
    def front(self) -> float:
        """Distance from the axis to the front, m."""

    @property
    @abstractmethod
    def corners(self) -> tuple[tuple[float, float], ...]:
        """Corners (x, y) in the base frame, counter-clockwise, m; empty for a round base."""

    @abstractmethod
    def describe(self) -> str:
        """Return shape and sizes in words, for messages."""

    @abstractmethod
    def make_link(self, name: str, mass: float, height: float) -> ElementTree.Element:
        """Make the base's URDF link, upright on the floor; kg, m."""

    @abstractmethod
    def place(self, x: Tensor, y: Tensor, find_rotation: Callable[[], tuple[Tensor, Tensor]]) -> TensorBase:
        """Place the base in each room of a batch at a rotation (cos, sin); all tensors are float64 (rooms,)."""

    def grow(self, margin: float) -> Self:
        """Return the base with a clearance on all sides, m."""
        return replace(self, size=tuple(side + margin for side in self.size))

    def find_free_fraction(self, x: float, y: float, rotation: tuple[float, float], dx: float, dy: float,
                           shapes: Iterable[Footprint]) -> float:
        """Return the fraction, in [0, 1], of a displacement before the first contact with any footprint."""
        contact, size, (cos, sin), least = self.contact, self.size, rotation, 1.0
        for shape in shapes:
            met = contact(x, y, cos, sin, size, dx, dy, shape)
            if met < least:
                least = met
        return least

    def measure_gap(self, x: float, y: float, rotation: tuple[float, float], shapes: Iterable[Footprint]) -> float:
        """Return the smallest gap to any footprint, m; see `gap`."""
        return min((self.gap(x, y, *rotation, self.size, shape) for shape in shapes), default=math.inf)

    def measure_distance(self, x: float, y: float, rotation: tuple[float, float], shape: Footprint) -> float:
        """Return the distance to a footprint, m; 0 if they overlap."""
        return self.distance(x, y, *rotation, self.size, shape)

    def stands_in(self, x: float, y: float, rotation: tuple[float, float], shape: Footprint) -> bool:
        """Return whether the base overlaps a footprint by more than `STANDS_IN`. A shut door then does not block it."""
        return self.gap(x, y, *rotation, self.size, shape) < -STANDS_IN

    def can_turn(self, x: float, y: float, rotation: tuple[float, float], to: tuple[float, float], turn: float,
                 shapes: Iterable[Footprint]) -> bool:
        """Return whether a turn from one rotation to another is free of all footprints."""
        return not any(self.blocks_turn(x, y, *rotation, *to, turn, self.size, shape) for shape in shapes)

    def find_corners_at(self, x: float, y: float, heading: float) -> Sequence[tuple[float, float]]:
        """Return the corners (x, y) of the base at a pose, counter-clockwise, m; empty for a round base."""
        cos, sin = math.cos(heading), math.sin(heading)
        return [(x + cos * a - sin * b, y + sin * a + cos * b) for a, b in self.corners]


def make_cylinder_link(name: str, mass: float, radius: float, length: float, xyz: str,
                       rpy: str) -> ElementTree.Element:
    """Make a link that is a cylinder along its z, placed in the link's frame; kg, m, rad."""
    side = mass * (3 * radius**2 + length**2) / 12
    shape = f'<cylinder radius="{radius!r}" length="{length!r}"/>'
    return _make_link(name, mass, shape, (side, side, mass * radius**2 / 2), f'<origin xyz="{xyz}" rpy="{rpy}"/>')


def make_box_link(name: str, mass: float, size: tuple[float, float, float], xyz: str) -> ElementTree.Element:
    """Make a link that is a box along its axes, placed in the link's frame; kg, m."""
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
