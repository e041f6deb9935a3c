"""The schematic: a `RoomConfig` says what kind of rooms to sample (Menashe and Stone 2019, section 4).

Every field has a unit, a range and a default; impossible values raise `ConfigError` naming
field, value and what is allowed. Lengths are metres; angles are degrees here only, in
fields whose name ends in `_deg`. What is sampled from a schematic is in `instance.py`.
"""

from __future__ import annotations

import dataclasses
from typing import Any, cast

from typing_extensions import Self

from hrl_escape.env.puzzles.base import PuzzleConfig, get_puzzle_kind
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.settings import Settings, knob
from hrl_escape.errors import ConfigError

__all__ = [
    "CONTACT_SKIN",
    "PASSAGE_SLACK",
    "DynamicsConfig",
    "ExitConfig",
    "ObstaclesConfig",
    "RewardConfig",
    "RobotConfig",
    "RoomConfig",
    "ShapeConfig",
    "StartConfig",
    "compute_resolution",
]

CONTACT_SKIN = 1e-3
"""Clearance in metres that the body keeps from every solid."""

PASSAGE_SLACK = 0.15
"""Free metres on each side of the body in every passage that a room's certificate counts on,
so that whole primitives find their way through."""

FINEST_CELL = 0.1
MOST_CELLS_A_SIDE = 800


def compute_resolution(half_x: float, half_y: float) -> float:
    """Cell size in metres of the certificate's grid over a floor of given half sizes."""
    return max(FINEST_CELL, 2 * max(half_x, half_y) / MOST_CELLS_A_SIDE)


ROBOT_KINDS = ("arm", "kuka-iiwa", "franka-panda", "urdf")


@dataclasses.dataclass(frozen=True)
class ShapeConfig(Settings):
    """Floor plan: a rectangle centred on the origin, split into rooms by interior walls."""

    _section = "room"
    width: float = knob(20.0, "Inner size along x.", "m", 5, 200)
    depth: float = knob(20.0, "Inner size along y.", "m", 5, 200)
    wall_height: float = knob(3.0, "Height of all walls.", "m", 0.1, 50)
    wall_thickness: float = knob(0.2, "Thickness of all walls.", "m", 0.02, 2)
    rooms: int = knob(1, "Rooms that interior walls divide the floor into.", "", 1, 16)
    doorway_width: float = knob(2.5, "Width of the doorway in each interior wall.", "m", 0.2, 50)

    @property
    def resolution(self) -> float:
        """Cell size in metres of the grid on which rooms of this size are certified."""
        return compute_resolution(self.width / 2, self.depth / 2)


@dataclasses.dataclass(frozen=True)
class RobotConfig(Settings):
    """A wheeled base (an upright cylinder) with an arm of 1-DoF joints."""

    _section = "robot"
    kind: str = knob("arm", "Which arm is mounted on the base.", choices=ROBOT_KINDS)
    body_radius: float = knob(0.75, "Radius of the base.", "m", 0.05, 5)
    body_height: float = knob(1.0, "Height of the base; the arm is mounted on top.", "m", 0.05, 10)
    joints: int = knob(0, "Arm joints that can be moved (the first ones of a named arm).", "", 0, 7)
    link_length: float = knob(0.5, "Length of each link of the generated arm.", "m", 0.01, 20)
    mount_forward: float = knob(0.0, "Where the arm stands on the base, ahead of its axis.", "m", -5, 5)
    joint_limit_deg: float = knob(60.0, "Joints of the generated arm move within plus or minus this.",
                                  "deg", 0, 180, open_low=True)
    hand_radius: float = knob(0.05, "Radius of the sphere at the last link's end that presses.", "m", 0.001, 1)
    move_step: float = knob(1.0, "Distance of one forward, back or strafe primitive.", "m", 0, 20, open_low=True)
    turn_step_deg: float = knob(10.0, "Angle of one turn primitive; must divide 360.", "deg", 1, 180)
    joint_step_deg: float = knob(10.0, "Angle of one joint primitive.", "deg", 0.1, 180)
    urdf: str | None = knob(None, "URDF text of the user's arm (kind 'urdf'); see `load_urdf`.")
    hand_link: str | None = knob(None, "Link of the URDF whose origin is the hand (default: the last link).")

    def check(self) -> None:
        """Check what spans several fields."""
        turns = 360 / self.turn_step_deg
        if abs(turns - round(turns)) > 1e-9:
            raise ConfigError("robot.turn_step_deg", self.turn_step_deg, "a divisor of 360, such as 10, 15 or 30")
        if (self.kind == "urdf") != (self.urdf is not None):
            raise ConfigError("robot.urdf", self.urdf and "(text)", "the URDF text exactly when robot.kind is 'urdf'")
        if self.kind != "arm" and self.joints == 0:
            raise ConfigError("robot.joints", 0, f"from 1 to 7 for robot.kind = {self.kind!r}")
        if abs(self.mount_forward) > self.body_radius:
            raise ConfigError("robot.mount_forward", self.mount_forward,
                              f"at most robot.body_radius = {self.body_radius:g} either way")


@dataclasses.dataclass(frozen=True)
class ObstaclesConfig(Settings):
    """Boxes and cylinders strewn over the floor; they may touch each other, never block the way."""

    _section = "obstacles"
    count: int = knob(0, "How many obstacles.", "", 0, 200)
    cylinder_share: float = knob(0.5, "Share of cylinders among them; the rest are boxes.", "", 0, 1)
    size_min: float = knob(0.5, "Smallest side or diameter.", "m", 0.05, 50)
    size_max: float = knob(2.0, "Largest side or diameter.", "m", 0.05, 50)
    height: float = knob(1.0, "Height of all obstacles.", "m", 0.05, 50)
    aligned: bool = knob(False, "Boxes stand parallel to the walls instead of at any yaw.")

    def check(self) -> None:
        """Check what spans several fields."""
        if self.size_min > self.size_max:
            raise ConfigError("obstacles.size_min", self.size_min,
                              f"at most obstacles.size_max = {self.size_max:g}")


@dataclasses.dataclass(frozen=True)
class StartConfig(Settings):
    """Where episodes begin: fixed here, or sampled with the instance among connected free places."""

    _section = "start"
    place: str = knob("random", "Sampled with the instance, or fixed to x, y, heading_deg.",
                      choices=("random", "fixed"))
    x: float = knob(0.0, "Fixed start.", "m", -100, 100)
    y: float = knob(0.0, "Fixed start.", "m", -100, 100)
    heading_deg: float = knob(0.0, "Fixed start heading, 0 along +x, counter-clockwise.", "deg", -360, 360)
    choices: int = knob(1, "Random places held by the instance; the episode seed picks one.", "", 1, 10_000)

    def check(self) -> None:
        """Check what spans several fields."""
        if self.place == "fixed" and self.choices != 1:
            raise ConfigError("start.choices", self.choices, "1 where start.place is 'fixed'")


@dataclasses.dataclass(frozen=True)
class ExitConfig(Settings):
    """The rectangle on the floor that ends the episode once the puzzle is solved."""

    _section = "exit"
    place: str = knob("random", "Against a random outer wall, or fixed to x, y.", choices=("random", "fixed"))
    x: float = knob(0.0, "Centre of a fixed exit.", "m", -110, 110)
    y: float = knob(0.0, "Centre of a fixed exit.", "m", -110, 110)
    width: float = knob(2.0, "Size along x (with a door: along the wall).", "m", 0.1, 200)
    depth: float = knob(2.0, "Size along y (with a door: away from the wall).", "m", 0.1, 200)
    door: bool = knob(False, "The exit is an alcove behind the outer wall, shut by a door until solved.")


@dataclasses.dataclass(frozen=True)
class RewardConfig(Settings):
    """Sparse reward of the paper: -1 a primitive, +100 at the exit."""

    _section = "reward"
    step: float = knob(-1.0, "Reward of every primitive.", "", -1e6, 1e6)
    exit: float = knob(100.0, "Reward of the primitive that exits, on top of its step.", "", -1e6, 1e6)
    exit_replaces_step: bool = knob(False, "The exiting primitive earns `exit` alone (the published 2019 code).")


@dataclasses.dataclass(frozen=True)
class DynamicsConfig(Settings):
    """How primitives act: exact kinematics, or Bullet's rigid bodies; noise and slip; what presses."""

    _section = "dynamics"
    kind: str = knob("kinematic", "Exact kinematics or rigid-body physics.", choices=("kinematic", "physics"))
    press_with: str = knob("body", "What presses buttons.", choices=("body", "hand"))
    press_margin: float = knob(0.02, "A button is touched within this distance of its box.", "m", 0, 1)
    noise: float = knob(0.0, "Standard deviation of the relative error of every displacement.", "", 0, 1)
    slip: float = knob(0.0, "Probability that a primitive does nothing.", "", 0, 1, open_high=True)


@dataclasses.dataclass(frozen=True)
class RoomConfig(Settings):
    """A schematic: everything `generate(config, seed)` needs to sample room instances.

    Example:
        >>> config = RoomConfig(puzzle=ButtonsConfig(count=3), obstacles=ObstaclesConfig(count=10))
        >>> instance = generate(config, seed=0)
    """

    _section = "config"
    name: str = knob("custom", "Name shown in reports.")
    room: ShapeConfig = knob(factory=ShapeConfig, doc="Floor plan.")
    robot: RobotConfig = knob(factory=RobotConfig, doc="Base and arm.")
    puzzle: PuzzleConfig = knob(factory=ButtonsConfig, doc="What must be solved; `kind` names it in JSON.")
    obstacles: ObstaclesConfig = knob(factory=ObstaclesConfig, doc="Boxes and cylinders.")
    start: StartConfig = knob(factory=StartConfig, doc="Where episodes begin.")
    exit: ExitConfig = knob(factory=ExitConfig, doc="Where they end.")
    reward: RewardConfig = knob(factory=RewardConfig, doc="Sparse reward.")
    dynamics: DynamicsConfig = knob(factory=DynamicsConfig, doc="How primitives act.")
    horizon: int = knob(1000, "Primitives after which an episode is truncated.", "", 1, 100_000_000)

    def check(self) -> None:
        """Check what spans several parts."""
        body = 2 * (self.robot.body_radius + CONTACT_SKIN + PASSAGE_SLACK + self.room.resolution)
        if self.room.rooms > 1 and self.room.doorway_width <= body:
            raise ConfigError("room.doorway_width", self.room.doorway_width,
                              f"more than the {body:g} m that the robot needs to pass")
        if body >= min(self.room.width, self.room.depth):
            raise ConfigError("robot.body_radius", self.robot.body_radius, "a body that fits into the room")
        if self.exit.door and self.exit.width <= body:
            raise ConfigError("exit.width", self.exit.width, f"more than the {body:g} m that the robot needs to pass")
        if self.dynamics.press_with == "hand" and self.robot.joints == 0:
            raise ConfigError("dynamics.press_with", "hand", "'body', or a robot with robot.joints >= 1")
        if self.puzzle.needs_physics and self.dynamics.kind != "physics":
            raise ConfigError("dynamics.kind", self.dynamics.kind, f"'physics' for puzzle {self.puzzle.kind!r}")

    def to_dict(self) -> dict[str, Any]:
        """Return nested plain values; the puzzle's `kind` says which puzzle it is."""
        return super().to_dict() | {"puzzle": {"kind": self.puzzle.kind} | self.puzzle.to_dict()}

    @classmethod
    def from_dict(cls, data: Any) -> Self:
        """Build from what `to_dict` gave; the puzzle defaults to buttons."""
        if not isinstance(data, dict):
            return super().from_dict(data)
        content = cast("dict[str, Any]", data)
        puzzle: Any = content.get("puzzle")
        if isinstance(puzzle, dict):
            fields = cast("dict[str, Any]", puzzle)
            kind = get_puzzle_kind(fields.get("kind", ButtonsConfig.kind))
            rest = {name: value for name, value in fields.items() if name != "kind"}
            content = content | {"puzzle": kind.config_type.from_dict(rest)}
        return super().from_dict(content)
