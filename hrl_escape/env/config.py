"""Room configurations: a `RoomConfig` describes a distribution over rooms (Menashe and Stone 2019, section 4).

Every field has a unit, a range and a default. Invalid values raise `ConfigError`, which names the field, its value and
the valid values. Lengths are in metres. Fields whose name ends in `_deg` are in degrees; all other angles are in
radians. `generate` samples a `RoomInstance` from a room configuration. Numbers of the floor plan, obstacles, start,
exit and puzzle may be ranges, such as `Between(3, 5)`; each instance draws a value from them.
"""

from __future__ import annotations

import dataclasses
import math
from functools import lru_cache
from typing import Annotated, Literal

from hrl_escape.env.bases import Base, bases
from hrl_escape.env.primitives import ActionTable, DriveKind, Move, SlipKind, make_action_table
from hrl_escape.env.puzzles.base import PuzzleConfig
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.rewards import RewardConfig
from hrl_escape.env.schema import HashedSettings
from hrl_escape.errors import ConfigError
from hrl_escape.settings import Between, Range

__all__ = ["CONTACT_SKIN", "PASSAGE_SLACK", "Between", "DynamicsConfig", "ExitConfig", "ObstaclesConfig",
           "RewardConfig", "RobotConfig", "RoomConfig", "ShapeConfig", "StartConfig", "Wall", "compute_resolution"]

CONTACT_SKIN = 1e-3
"""Clearance between the body and every solid, m."""

PASSAGE_SLACK = 0.15
"""Free width on each side of the body, m, in every passage that the certificate of a room relies on.

It leaves enough space for motions made of whole primitives."""

FINEST_CELL = 0.1
MOST_CELLS_A_SIDE = 800


def compute_resolution(half_x: float, half_y: float) -> float:
    """Return the cell size, m, of the certificate's grid over a floor of the given half sizes, m."""
    return max(FINEST_CELL, 2 * max(half_x, half_y) / MOST_CELLS_A_SIDE)


@dataclasses.dataclass(frozen=True)
class Wall(HashedSettings):
    """An explicit interior wall, straight along x or y."""

    _section = "wall"
    x: Annotated[float, Range(-110, 110, "m")] = 0.0
    """x of the first end."""
    y: Annotated[float, Range(-110, 110, "m")] = 0.0
    """y of the first end."""
    to_x: Annotated[float, Range(-110, 110, "m")] = 0.0
    """x of the other end; equal to `x` for a wall along y."""
    to_y: Annotated[float, Range(-110, 110, "m")] = 1.0
    """y of the other end; equal to `y` for a wall along x."""

    def check(self) -> None:
        """Check that the wall is parallel to x or y."""
        if (self.x == self.to_x) == (self.y == self.to_y):
            raise ConfigError("wall", (self.x, self.y, self.to_x, self.to_y), "two places on one line along x or y")


@dataclasses.dataclass(frozen=True)
class ShapeConfig(HashedSettings):
    """Floor plan: a rectangle centred on the origin, split into rooms by interior walls."""

    _section = "room"
    _takes_ranges = True
    width: Annotated[float, Range(5, 200, "m")] = 20.0
    """Inner size along x."""
    depth: Annotated[float, Range(5, 200, "m")] = 20.0
    """Inner size along y."""
    wall_height: Annotated[float, Range(0.1, 50, "m")] = 3.0
    """Height of all walls."""
    wall_thickness: Annotated[float, Range(0.02, 2, "m")] = 0.2
    """Thickness of all walls."""
    rooms: Annotated[int, Range(1, 16)] = 1
    """Number of rooms that interior walls split the floor into."""
    doorway_width: Annotated[float, Range(0.2, 50, "m")] = 2.5
    """Width of the doorway in each interior wall."""
    cell: Annotated[float, Range(0.5, 20, "m")] = 1.0
    """Side of the cells of a grid world. Used by `map` and by starts in cells."""
    map: tuple[str, ...] = ()
    """Rows of a grid world from the top, one character per cell: # is wall, anything else is floor."""
    walls: tuple[Wall, ...] = ()
    """Interior walls at given places, added to the walls that `rooms` generates."""

    def check(self) -> None:
        """Check that the map covers the floor exactly."""
        if self.map:
            wide = {len(row) for row in self.map}
            if wide != {round(self.width / self.cell, 9)} or len(self.map) != round(self.depth / self.cell, 9):
                raise ConfigError("room.map", f"{len(self.map)} rows of {sorted(wide)} cells",
                                  "rows and columns of cells that fill room.width and room.depth")


@dataclasses.dataclass(frozen=True)
class RobotConfig(HashedSettings):
    """A wheeled base (an upright cylinder or box) with an arm of 1-DoF joints."""

    _section = "robot"
    kind: Literal["arm", "kuka-iiwa", "franka-panda", "urdf"] = "arm"
    """Arm on the base: generated links, a named arm, or a URDF."""
    body_radius: Annotated[float, Range(0.05, 5, "m")] = 0.75
    """Radius of a base with the footprint of a disc."""
    body_height: Annotated[float, Range(0.05, 10, "m")] = 1.0
    """Height of the base; the arm is mounted on top."""
    joints: Annotated[int, Range(0, 7)] = 0
    """Number of arm joints that primitives move (the first ones of a named arm)."""
    link_length: Annotated[float, Range(0.01, 20, "m")] = 0.5
    """Length of each link of the generated arm. Longer links reach targets from further away."""
    mount_forward: Annotated[float, Range(-5, 5, "m")] = 0.0
    """Offset of the arm's mount ahead of the base's axis."""
    joint_limit_deg: Annotated[float, Range(0, 180, "deg", open_low=True)] = 60.0
    """Largest angle of the generated arm's joints in each direction."""
    hand_radius: Annotated[float, Range(0.001, 1, "m")] = 0.05
    """Radius of the hand, the sphere at the end of the last link that presses targets."""
    move_step: Annotated[float, Range(0, 20, "m", open_low=True)] = 1.0
    """Distance of one forward, back or strafe primitive. Smaller steps make episodes longer."""
    turn_step_deg: Annotated[float, Range(1, 180, "deg")] = 10.0
    """Angle of one turn primitive; must divide 360. Smaller steps allow more headings."""
    joint_step_deg: Annotated[float, Range(0.1, 180, "deg")] = 10.0
    """Angle of one joint primitive."""
    urdf: str | None = None
    """URDF text of the user's arm (kind 'urdf'); see `load_urdf`."""
    hand_link: str | None = None
    """Link of the URDF whose origin is the hand; the last link if empty."""
    gripper: bool = False
    """Adds the primitives grip and release, for puzzles with things that the robot can carry."""
    use: bool = False
    """Adds the primitive use, which opens and shuts things ahead. Requires `gripper`."""
    drive: DriveKind = "strafing"
    """Holonomic bases move along and across their heading; differential ones move along it and turn on the spot."""
    moves: tuple[Move, ...] = ()
    """Additional primitives of the base, each with its own displacement and turn."""
    footprint: str = "disc"
    """Outline of the base on the floor, centred on its axis: a disc or a rectangle."""
    body_length: Annotated[float, Range(0.1, 10, "m")] = 1.2
    """Size of a rectangular base along its heading."""
    body_width: Annotated[float, Range(0.1, 10, "m")] = 0.8
    """Size of a rectangular base across its heading."""

    @property
    def base(self) -> Base:
        """Outline of the base, without clearance."""
        return _measure_base(self)

    @property
    def inner_radius(self) -> float:
        """Radius, m, of the largest disc inside the base. Where it does not fit, the base collides at every heading."""
        return self.base.inner_radius

    @property
    def outer_radius(self) -> float:
        """Radius, m, of the smallest disc that encloses the base. Where it fits, the base is clear at every heading."""
        return self.base.outer_radius

    @property
    def symmetry(self) -> int:
        """Number of evenly spaced headings with the same outline and the same moves."""
        return math.gcd(self.actions.symmetry, self.base.symmetry)

    @property
    def actions(self) -> ActionTable:
        """Table of the robot's primitives."""
        return make_action_table(self.joints, self.gripper, self.drive, self.use, self.move_step, self.moves)

    def check(self) -> None:
        """Check the limits that relate several fields."""
        turns = 360 / self.turn_step_deg
        if abs(turns - round(turns)) > 1e-9:
            raise ConfigError("robot.turn_step_deg", self.turn_step_deg, "a divisor of 360, such as 10, 15 or 30")
        for move in self.moves:
            if abs(move.turn) > turns / 2:
                raise ConfigError("move.turn", move.turn, f"at most {turns // 2:g} turn steps, half a full turn")
            if self.actions.names.count(move.name) > 1:
                raise ConfigError("move.name", move.name, "a name that no other primitive of the robot has")
        if (self.kind == "urdf") != (self.urdf is not None):
            raise ConfigError("robot.urdf", self.urdf and "(text)", "the URDF text exactly when robot.kind is 'urdf'")
        if self.kind != "arm" and self.joints == 0:
            raise ConfigError("robot.joints", 0, f"from 1 to 7 for robot.kind = {self.kind!r}")
        if self.use and not self.gripper:
            raise ConfigError("robot.use", self.use, "false without robot.gripper")
        if self.footprint not in bases:
            raise ConfigError("robot.footprint", self.footprint, f"one of {', '.join(bases)}")
        if abs(self.mount_forward) > self.base.front:
            raise ConfigError("robot.mount_forward", self.mount_forward,
                              f"at most robot.{self.base.front_field} = {self.base.front:g} either way")


@lru_cache(maxsize=256)
def _measure_base(robot: RobotConfig) -> Base:
    return bases.get(robot.footprint).measure(robot)


@dataclasses.dataclass(frozen=True)
class ObstaclesConfig(HashedSettings):
    """Boxes and cylinders on the floor. They may touch, but never block the way to a target or the exit."""

    _section = "obstacles"
    _takes_ranges = True
    count: Annotated[int, Range(0, 200)] = 0
    """Number of obstacles that generation places."""
    cylinder_share: Annotated[float, Range(0, 1)] = 0.5
    """Share of cylinders among the obstacles; the rest are boxes."""
    size_min: Annotated[float, Range(0.05, 50, "m")] = 0.5
    """Smallest side or diameter."""
    size_max: Annotated[float, Range(0.05, 50, "m")] = 2.0
    """Largest side or diameter."""
    height: Annotated[float, Range(0.05, 50, "m")] = 1.0
    """Height of all obstacles."""
    aligned: bool = False
    """If true, boxes are parallel to the walls; otherwise their yaw is random."""

    def check(self) -> None:
        """Check the limits that relate several fields."""
        if self.size_min > self.size_max:
            raise ConfigError("obstacles.size_min", self.size_min,
                              f"at most obstacles.size_max = {self.size_max:g}")


@dataclasses.dataclass(frozen=True)
class StartConfig(HashedSettings):
    """Start pose of episodes: fixed, or sampled among free places that are connected to the targets and the exit."""

    _section = "start"
    _takes_ranges = True
    place: Literal["random", "fixed", "cells"] = "random"
    """Choice of start poses: sampled with the instance, fixed at x, y and heading_deg, or any free grid cell."""
    x: Annotated[float, Range(-100, 100, "m")] = 0.0
    """Start position along x, for a fixed place."""
    y: Annotated[float, Range(-100, 100, "m")] = 0.0
    """Start position along y, for a fixed place."""
    heading_deg: Annotated[float, Range(-360, 360, "deg")] = 0.0
    """Fixed start heading, 0 along +x, counter-clockwise."""
    choices: Annotated[int, Range(1, 10_000)] = 1
    """Number of random start poses per instance; the episode seed selects one. More of them make starts more varied."""

    def check(self) -> None:
        """Check the limits that relate several fields."""
        if self.place != "random" and self.choices != 1:
            raise ConfigError("start.choices", self.choices, "1 unless start.place is 'random'")


@dataclasses.dataclass(frozen=True)
class ExitConfig(HashedSettings):
    """The rectangle on the floor that ends the episode once the puzzle is solved."""

    _section = "exit"
    _takes_ranges = True
    place: Literal["random", "fixed"] = "random"
    """Place of the exit: against a random outer wall, or fixed at x, y."""
    x: Annotated[float, Range(-110, 110, "m")] = 0.0
    """Centre of a fixed exit along x."""
    y: Annotated[float, Range(-110, 110, "m")] = 0.0
    """Centre of a fixed exit along y."""
    width: Annotated[float, Range(0.1, 200, "m")] = 2.0
    """Size along x (with a door: along the wall)."""
    depth: Annotated[float, Range(0.1, 200, "m")] = 2.0
    """Size along y (with a door: away from the wall)."""
    door: bool = False
    """If true, the exit is an alcove behind the outer wall, closed by a door until the puzzle is solved."""


@dataclasses.dataclass(frozen=True)
class DynamicsConfig(HashedSettings):
    """Dynamics: exact kinematics or rigid-body physics, noise, slips, and the part of the robot that presses."""

    _section = "dynamics"
    kind: Literal["kinematic", "physics"] = "kinematic"
    """Exact kinematics, or rigid-body physics in Bullet. Physics is slower and makes contacts less predictable."""
    press_with: Literal["body", "hand"] = "body"
    """Part of the robot that presses buttons."""
    press_margin: Annotated[float, Range(0, 1, "m")] = 0.02
    """Distance from a button's box within which the button counts as touched. Larger values make pressing easier."""
    noise: Annotated[float, Range(0, 1)] = 0.0
    """Standard deviation of the relative error of every displacement. 0 makes primitives exact."""
    slip: Annotated[float, Range(0, 1, open_high=True)] = 0.0
    """Probability that a primitive slips: it does nothing, or a move goes elsewhere (`slip_kind`)."""
    slip_kind: SlipKind = "stay"
    """Effect of a slip: the primitive does nothing, or a move goes to either side, to either side if it is not blocked
    ahead, in any of the other three directions, or to a free neighbouring cell."""
    blocked: Literal["contact", "stay"] = "contact"
    """Effect of a blocked move: the base moves up to contact, or stays in place. If it stays, it remains on the lattice
    of its moves."""

    def check(self) -> None:
        """Check that physics leaves `blocked` and `slip_kind` at their defaults."""
        if self.kind == "physics" and (self.blocked, self.slip_kind) != ("contact", "stay"):
            raise ConfigError("dynamics.blocked", (self.blocked, self.slip_kind),
                              "'contact', and slip_kind 'stay', under physics")

    @property
    def is_random(self) -> bool:
        """True if primitives are noisy or can slip."""
        return bool(self.noise or self.slip)


@dataclasses.dataclass(frozen=True)
class RoomConfig(HashedSettings):
    """A room configuration: everything that `generate(config, seed)` needs to sample room instances.

    Example:
        >>> config = RoomConfig(puzzle=ButtonsConfig(count=3), obstacles=ObstaclesConfig(count=10))
        >>> instance = generate(config, seed=0)
    """

    _section = "config"
    name: str = "custom"
    """Name of the room configuration in reports."""
    room: ShapeConfig = ShapeConfig()
    """Floor plan: size, interior walls, doorways."""
    robot: RobotConfig = RobotConfig()
    """Robot: base, arm, and sizes of its primitives."""
    puzzle: PuzzleConfig = ButtonsConfig()
    """Puzzle that opens the exit; `kind` names it in JSON."""
    obstacles: ObstaclesConfig = ObstaclesConfig()
    """Obstacles on the floor: boxes and cylinders."""
    start: StartConfig = StartConfig()
    """Start pose of episodes."""
    exit: ExitConfig = ExitConfig()
    """Exit: the region on the floor where an episode ends once the puzzle is solved."""
    reward: RewardConfig = RewardConfig()
    """Reward of each primitive and of the exit; `kind` names it in JSON."""
    dynamics: DynamicsConfig = DynamicsConfig()
    """Dynamics of the primitives: kinematic or physical, noise and slips."""
    horizon: Annotated[int, Range(1, 100_000_000)] = 1000
    """Largest number of primitives in an episode, which is then truncated."""

    def check(self) -> None:
        """Check the limits that relate several sections."""
        cell = compute_resolution(self.room.width / 2, self.room.depth / 2)
        body = 2 * (self.robot.inner_radius + CONTACT_SKIN + PASSAGE_SLACK + cell)
        if self.room.rooms > 1 and self.room.doorway_width <= body:
            raise ConfigError("room.doorway_width", self.room.doorway_width,
                              f"more than the {body:g} m that the robot needs to pass")
        if body >= min(self.room.width, self.room.depth):
            part = self.robot.base.width_field
            raise ConfigError(f"robot.{part}", getattr(self.robot, part), "a body that fits into the room")
        if self.exit.door and self.exit.width <= body:
            raise ConfigError("exit.width", self.exit.width, f"more than the {body:g} m that the robot needs to pass")
        if self.robot.drive == "differential" and self.dynamics.slip_kind.startswith("lateral"):
            raise ConfigError("dynamics.slip_kind", self.dynamics.slip_kind, "'stay', 'any' or 'neighbour' for a "
                              "differential drive, which makes no moves sideways")
        if self.dynamics.press_with == "hand" and self.robot.joints == 0:
            raise ConfigError("dynamics.press_with", "hand", "'body', or a robot with robot.joints >= 1")
        if self.puzzle.pads is not None and (self.dynamics.press_with, self.dynamics.kind) != ("body", "kinematic"):
            raise ConfigError("dynamics", (self.dynamics.press_with, self.dynamics.kind),
                              "press_with 'body' and kind 'kinematic' for a puzzle with pads")
        if self.puzzle.needs_physics and self.dynamics.kind != "physics":
            raise ConfigError("dynamics.kind", self.dynamics.kind, f"'physics' for puzzle {self.puzzle.kind!r}")
