"""Check of untrusted rooms: the floor is walled in and every start on it is free of contact."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.config import CONTACT_SKIN, RobotConfig
from hrl_escape.env.geometry import Footprint, Solid, compute_distance_many, stack_footprints
from hrl_escape.errors import ConfigError

__all__ = ["Room", "check_room", "does_base_fit"]

_OVERLAP = 1e-6
"""Length by which the alcove behind a door counts as reaching into the floor, m."""


class FloorPose(Protocol):
    """A place and a heading on the floor."""

    @property
    def x(self) -> float:
        """Position along x, m."""
        ...

    @property
    def y(self) -> float:
        """Position along y, m."""
        ...

    @property
    def heading_steps(self) -> int:
        """Heading, in turn steps."""
        ...

    @property
    def heading_offset(self) -> float:
        """Heading beyond whole steps, rad."""
        ...


class FloorRectangle(Protocol):
    """A rectangle of the floor."""

    @property
    def x_min(self) -> float:
        """Lower edge along x, m."""
        ...

    @property
    def x_max(self) -> float:
        """Upper edge along x, m."""
        ...

    @property
    def y_min(self) -> float:
        """Lower edge along y, m."""
        ...

    @property
    def y_max(self) -> float:
        """Upper edge along y, m."""
        ...


class Room(Protocol):
    """The parts of a `RoomInstance` that are checked here."""

    @property
    def half_width(self) -> float:
        """Half of the floor's extent along x, m."""
        ...

    @property
    def half_depth(self) -> float:
        """Half of the floor's extent along y, m."""
        ...

    @property
    def solids(self) -> Sequence[Solid]:
        """Fixed solids: walls and obstacles, without the door."""
        ...

    @property
    def door(self) -> Solid | None:
        """Door that shuts the exit; None where the exit has none."""
        ...

    @property
    def robot(self) -> RobotConfig:
        """The robot's part of the schematic."""
        ...

    @property
    def exit(self) -> FloorRectangle:
        """Rectangle on the floor that ends the episode."""
        ...

    @property
    def starts(self) -> Sequence[FloorPose]:
        """Poses of the base in which episodes may begin."""
        ...

    @property
    def reach_x(self) -> float:
        """Largest |x| of the body's axis, m."""
        ...

    @property
    def reach_y(self) -> float:
        """Largest |y| of the body's axis, m."""
        ...


def check_room(instance: Room) -> None:
    """Refuse a room that the body could leave through a gap, or whose starts are not free.

    Interior walls, obstacles and targets are not checked: solvability is the certificate's matter.

    Raises:
        ConfigError: the message names the gap or the start.
    """
    solids = [solid.footprint for solid in (*instance.solids, *((instance.door,) if instance.door else ()))]
    shapes = stack_footprints(solids)
    radius = instance.robot.inner_radius
    rims = _trace_rim(instance, radius)
    away = compute_distance_many(rims, shapes)
    if (away > radius / 2).any():
        x, y = rims[int(away.argmax())].tolist()
        raise ConfigError("instance.solids", f"{len(instance.solids)} solids",
                          f"walls all round the floor (there is a gap at x = {x:.4g}, y = {y:.4g})")
    starts = np.array([(start.x, start.y) for start in instance.starts])
    free = compute_distance_many(starts, shapes) >= radius + CONTACT_SKIN - 1e-6
    free &= (np.abs(starts) <= (instance.reach_x, instance.reach_y)).all(axis=1)
    free &= [does_base_fit(instance.robot, start, solids) for start in instance.starts]
    if not free.all():
        number = int(free.argmin())
        raise ConfigError(f"instance.starts[{number}]", starts[number].tolist(),
                          f"a place on the floor where {instance.robot.base.describe()} is clear of every solid")


def does_base_fit(robot: RobotConfig, pose: FloorPose, solids: Sequence[Footprint]) -> bool:
    """Return whether a base is clear of solids at a heading; a round base fits at every heading."""
    heading = pose.heading_steps * math.radians(robot.turn_step_deg) + pose.heading_offset
    rotation = round(math.cos(heading), 15), round(math.sin(heading), 15)
    return robot.base.turns_anywhere or robot.base.grow(CONTACT_SKIN).measure_gap(
        pose.x, pose.y, rotation, solids) >= -1e-6


def _trace_rim(instance: Room, spacing: float) -> NDArray[np.float64]:
    """Points (n, 2) along the rim of the floor, at most `spacing` apart; behind a door it leads round the alcove."""
    areas, points = _list_areas(instance), []
    for number, area in enumerate(areas):
        rim = _trace_rectangle(*area, spacing)
        for other in areas[:number] + areas[number + 1 :]:
            x_min, x_max, y_min, y_max = other
            inside = (rim[:, 0] > x_min) & (rim[:, 0] < x_max) & (rim[:, 1] > y_min) & (rim[:, 1] < y_max)
            rim = rim[~inside]
        points.append(rim)
    return np.concatenate(points)


def is_on_floor(instance: Room, x: float, y: float, slack: float = 0.0) -> bool:
    """Return whether a point is on the floor, in the alcove behind a door, or at most `slack` m beyond their edges."""
    return any(x_min - slack <= x <= x_max + slack and y_min - slack <= y <= y_max + slack
               for x_min, x_max, y_min, y_max in _list_areas(instance))


def _list_areas(instance: Room) -> list[tuple[float, float, float, float]]:
    """Rectangles x_min, x_max, y_min, y_max of the floor: the room's, and that of the alcove behind a door."""
    half_x, half_y = instance.half_width, instance.half_depth
    areas = [(-half_x, half_x, -half_y, half_y)]
    if instance.door is not None:
        beyond = instance.robot.outer_radius + CONTACT_SKIN  # the body's axis stands in the exit
        area = instance.exit
        areas.append((*_stretch(area.x_min, area.x_max, half_x, beyond),
                      *_stretch(area.y_min, area.y_max, half_y, beyond)))
    return areas


def _stretch(low: float, high: float, half: float, beyond: float) -> tuple[float, float]:
    """Extent of an alcove along one axis: from inside the floor to the wall behind the exit."""
    low, high = min(low, half - _OVERLAP), max(high, _OVERLAP - half)
    return low - beyond * (low < -half), high + beyond * (high > half)


def _trace_rectangle(x_min: float, x_max: float, y_min: float, y_max: float, spacing: float) -> NDArray[np.float64]:
    xs = np.linspace(x_min, x_max, 1 + math.ceil((x_max - x_min) / spacing))
    ys = np.linspace(y_min, y_max, 1 + math.ceil((y_max - y_min) / spacing))
    sides = [np.stack([xs, np.full_like(xs, y)], axis=1) for y in (y_min, y_max)]
    sides += [np.stack([np.full_like(ys, x), ys], axis=1) for x in (x_min, x_max)]
    return np.concatenate(sides)
