"""The room as pictures show it: its parts, listed once, with their poses and looks in a state.

Every fixed part is an upright prism over a box or a disc, or paint on the floor. Maps, Bullet's cameras, the batched
cameras and the viewer draw the parts of a `RoomModel`, each in its own way. Metres and radians.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from hrl_escape.env.geometry import Footprint, Solid, make_footprint
from hrl_escape.env.instance import Rectangle, RoomInstance, Target, compute_floors
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.pictures import palette
from hrl_escape.env.puzzles.mixins import Barring, get_mixin

LAYER = 0.006
"""Height between two layers of paint on the floor, m."""
ABOVE_FLOOR = 0.02
"""Lowest edge of panels and doors, m."""


class RoomPart(NamedTuple):
    """An upright prism of one colour; paint on the floor if `low` and `high` are equal."""

    role: str  # key of `palette.LOOKS`
    shape: Footprint  # outline on the floor, m
    low: float  # lowest height, m
    high: float  # largest height, m


class Panel(NamedTuple):
    """Parts of a target."""

    face: RoomPart  # the part that lights up
    frame: RoomPart  # frame around the face, slightly thinner
    mat: RoomPart  # paint on the floor in front of it


class RoomPose(NamedTuple):
    """Poses of everything that moves."""

    x: float  # x of the body's axis, m
    y: float  # y of the body's axis, m
    z: float  # height of the base above the floor, m
    heading: float  # rad
    pitch: float  # rad
    roll: float  # rad
    angles: tuple[float, ...]  # angles of the arm's joints, rad
    door: float  # angle of the exit's door on its hinge, rad
    props: tuple[tuple[float, ...], ...]  # position x, y, z, m, and quaternion x, y, z, w of each prop


class RoomLook(NamedTuple):
    """Parts of a puzzle's state that pictures show."""

    lit: tuple[bool, ...]  # whether each target is on
    shut: tuple[bool, ...]  # whether each inner door or thing blocks the way
    is_open: bool  # whether the exit is open


class RoomModel:
    """Parts of one room, in the room frame unless stated.

    Attributes:
        instance: the room.
        rules: rules of the room, which compute poses.
        floors: floors of the room and of an alcove at its exit.
        exit: painted area of the exit, and the edge below it.
        solids: walls and obstacles, in the order of `instance.solids`.
        panels: targets, in their order.
        inner_doors: doors between rooms, and things that fill cells.
        leaf: exit door in the frame of its hinge, or None without one.
        hinge: (x, y) of this hinge, m.
        props: blocks and plates, each in its own frame.
    """

    def __init__(self, instance: RoomInstance) -> None:
        self.instance = instance
        self.rules = Kinematics(instance)
        self.floors = tuple(_make_paint("tile", floor, 0.0) for floor in compute_floors(instance))
        area, half_x, half_y = instance.exit, *_measure(instance.exit)
        rim = min(0.12, 0.1 * half_x, 0.1 * half_y)
        inner = Rectangle(area.x_min + rim, area.x_max - rim, area.y_min + rim, area.y_max - rim)
        self.exit = _make_paint("exit", inner, 3 * LAYER), _make_paint("exit edge", area, 2 * LAYER)
        self.solids = tuple(RoomPart("wall" if solid.role == "wall" else "obstacle", solid.footprint, 0.0, solid.height)
                            for solid in instance.solids)
        self.panels = tuple(_make_panel(instance, target) for target in instance.targets)
        self.inner_doors = tuple(map(_make_inner_door, instance.inner_doors))
        door = instance.door
        self.leaf = None if door is None else RoomPart(
            "door", make_footprint(door.half_x, 0.0, door.half_x, 0.6 * door.half_y), ABOVE_FLOOR, door.height)
        self.hinge = (0.0, 0.0) if door is None else (door.x - math.cos(door.yaw) * door.half_x,
                                                      door.y - math.sin(door.yaw) * door.half_x)
        self.props = tuple(RoomPart(
            placed.prop.kind, make_footprint(0.0, 0.0, placed.prop.half_size, placed.prop.half_size),
            *((3 * LAYER,) * 2 if placed.prop.kind == "plate" else (-placed.prop.height / 2, placed.prop.height / 2)))
            for placed in instance.props)

    def make_pose(self, state: RoomState) -> RoomPose:
        """Return the poses of everything in a state."""
        rules, physics = self.rules, state.physics
        props = (numbers[:7] for numbers in physics.props) if physics else (
            (p.x, p.y, p.prop.height / 2, 0.0, 0.0, math.sin(p.yaw / 2), math.cos(p.yaw / 2))
            for p in self.instance.props)
        placed = tuple((x, y, 0.0 if part.role == "plate" else z, *turn)
                       for part, (x, y, z, *turn) in zip(self.props, props, strict=True))
        return RoomPose(state.x, state.y, state.z, rules.get_heading(state), state.pitch, state.roll,
                        tuple(rules.get_angles(state)), self._find_door_angle(state), placed)

    def _find_door_angle(self, state: RoomState) -> float:
        """Angle of the exit door, rad. Without physics it is open as soon as the robot can pass."""
        if self.instance.dynamics.kind == "physics":
            return state.physics.door[0] if state.physics and state.physics.door else 0.0
        rotation = self.rules.get_rotation(state.heading_steps, state.heading_offset)
        is_shut = self.leaf is None or self.rules.is_door_shut(state.x, state.y, state.puzzle, rotation)
        return 0.0 if is_shut else math.pi / 2 * self.instance.door_swing

    def make_look(self, state: RoomState) -> RoomLook:
        """Return which targets are on, which inner doors are shut and whether the exit is open in a state."""
        puzzle = self.instance.puzzle
        shut = get_mixin(puzzle, Barring).get_shut(state.puzzle)
        return RoomLook(tuple(map(bool, puzzle.get_lit(state.puzzle))),
                        tuple(bool(shut >> number & 1) for number in range(len(self.inner_doors))),
                        puzzle.is_solved(state.puzzle))

    def place_leaf(self, angle: float) -> RoomPart:
        """Return the exit door in the room frame, at an angle on its hinge, rad."""
        assert self.leaf is not None and self.instance.door is not None
        yaw, (x, y), half = self.instance.door.yaw + angle, self.hinge, self.leaf.shape.half_x
        return self.leaf._replace(shape=make_footprint(x + half * math.cos(yaw), y + half * math.sin(yaw), half,
                                                       self.leaf.shape.half_y, yaw))


def _measure(area: Rectangle) -> tuple[float, float]:
    """Half sizes of a rectangle, m."""
    return (area.x_max - area.x_min) / 2, (area.y_max - area.y_min) / 2


def _make_paint(role: str, area: Rectangle, height: float) -> RoomPart:
    return RoomPart(role, make_footprint(*area.centre, *_measure(area)), height, height)


def _make_panel(instance: RoomInstance, target: Target) -> Panel:
    low, high = max(ABOVE_FLOOR, target.z - target.half_z), target.z + target.half_z
    rim = min(0.08, 0.2 * min(target.half_x, target.half_z))
    frame = make_footprint(target.x, target.y, target.half_x + rim, 0.7 * target.half_y, target.yaw)
    ahead = palette.find_front(instance, target)
    deep = target.half_y + (min(0.4, 0.5 * instance.robot.inner_radius) if target.kind == "panel" else 0.0)
    mat = make_footprint(target.x + ahead[0] * deep / 2, target.y + ahead[1] * deep / 2, target.half_x, deep / 2,
                         target.yaw)
    return Panel(RoomPart("off", target.footprint, low, high),
                 RoomPart("frame", frame, max(0.0, low - rim), high + rim),
                 RoomPart("mat", mat, 4 * LAYER, 4 * LAYER))


def _make_inner_door(door: Solid) -> RoomPart:
    """A door that fills its cell, or a thing that fills half of it."""
    role, share = ("door", 0.98) if door.role == "door" else ("thing", 0.5)
    shape = make_footprint(door.x, door.y, share * door.half_x, share * door.half_y, door.yaw)
    return RoomPart(role, shape, ABOVE_FLOOR, door.height)
