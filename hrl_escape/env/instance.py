"""One sampled room: a `RoomInstance` holds every concrete pose and size, the graph and the robot.

Instances are immutable values: they serialise to JSON and back without loss and carry a
content hash, `id`, by which results name the room they were measured in. Sampling them from
a schematic is `generation.py`.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from functools import cached_property
from pathlib import Path
from typing import Any, cast

from typing_extensions import Self

from hrl_escape.env.config import DynamicsConfig, RewardConfig, RobotConfig
from hrl_escape.env.geometry import Footprint, Solid, make_footprint
from hrl_escape.env.puzzles.base import Prop, Puzzle, get_puzzle_kind
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.env.settings import Settings, knob
from hrl_escape.errors import ConfigError, EscapeError, InstanceFileError
from hrl_escape.files import read_json, write_json

__all__ = ["SCHEMA_VERSION", "PlacedProp", "Rectangle", "RoomInstance", "Start", "Target"]

SCHEMA_VERSION = 1
_FAR = 1e6


@dataclasses.dataclass(frozen=True)
class Target(Settings):
    """A box on a wall that can be pressed; in kinematic mode it blocks nothing."""

    _section = "target"
    name: str = knob("button-1", "Unique name.")
    x: float = knob(0.0, "Centre.", "m", -_FAR, _FAR)
    y: float = knob(0.0, "Centre.", "m", -_FAR, _FAR)
    z: float = knob(0.5, "Centre.", "m", -_FAR, _FAR)
    half_x: float = knob(0.5, "Half its width (own x).", "m", 0, _FAR)
    half_y: float = knob(0.05, "Half its thickness (own y).", "m", 0, _FAR)
    half_z: float = knob(0.5, "Half its height.", "m", 0, _FAR)
    yaw: float = knob(0.0, "Direction of its width.", "rad", -10, 10)

    @cached_property
    def footprint(self) -> Footprint:
        """Its outline on the floor."""
        return make_footprint(self.x, self.y, self.half_x, self.half_y, self.yaw)


@dataclasses.dataclass(frozen=True)
class Rectangle(Settings):
    """An axis-aligned closed rectangle on the floor."""

    _section = "rectangle"
    x_min: float = knob(0.0, "West edge.", "m", -_FAR, _FAR)
    x_max: float = knob(1.0, "East edge.", "m", -_FAR, _FAR)
    y_min: float = knob(0.0, "South edge.", "m", -_FAR, _FAR)
    y_max: float = knob(1.0, "North edge.", "m", -_FAR, _FAR)

    def contains(self, x: float, y: float) -> bool:
        """Say whether a point is inside; edges count."""
        return self.x_min <= x <= self.x_max and self.y_min <= y <= self.y_max

    @property
    def centre(self) -> tuple[float, float]:
        """The middle."""
        return (self.x_min + self.x_max) / 2, (self.y_min + self.y_max) / 2


@dataclasses.dataclass(frozen=True)
class Start(Settings):
    """A pose of the base: heading is `heading_steps` turn steps plus `heading_offset` rad."""

    _section = "start"
    x: float = knob(0.0, "Position.", "m", -_FAR, _FAR)
    y: float = knob(0.0, "Position.", "m", -_FAR, _FAR)
    heading_steps: int = knob(0, "Heading in turn steps.", "", 0, 359)
    heading_offset: float = knob(0.0, "Heading beyond whole steps.", "rad", -math.pi, math.pi)


@dataclasses.dataclass(frozen=True)
class PlacedProp(Settings):
    """A prop of the puzzle and where it stands when an episode begins."""

    _section = "prop"
    prop: Prop = knob(factory=Prop, doc="What it is.")
    x: float = knob(0.0, "Position.", "m", -_FAR, _FAR)
    y: float = knob(0.0, "Position.", "m", -_FAR, _FAR)
    yaw: float = knob(0.0, "Orientation.", "rad", -10, 10)


@dataclasses.dataclass(frozen=True)
class RoomInstance(Settings):
    """One room, ready to be simulated, planned in and drawn.

    The floor is the rectangle |x| <= half_width, |y| <= half_depth (plus the alcove behind
    the door, if there is one). `name` and `seed` say where the instance came from; they
    are not part of its content and do not change `id`.
    """

    _section = "instance"
    name: str = knob("custom", "Name of the schematic.")
    seed: int | None = knob(None, "Instance seed it was generated with.", "", 0, 2**63 - 1)
    half_width: float = knob(10.0, "Half the inner size along x.", "m", 0, _FAR)
    half_depth: float = knob(10.0, "Half the inner size along y.", "m", 0, _FAR)
    wall_height: float = knob(3.0, "Height of walls.", "m", 0, _FAR)
    solids: tuple[Solid, ...] = knob((), "Walls and obstacles.")
    door: Solid | None = knob(None, "Stands in the exit's doorway until the puzzle is solved.")
    targets: tuple[Target, ...] = knob((), "What can be pressed, in the puzzle's order.")
    props: tuple[PlacedProp, ...] = knob((), "What stands on the floor, in the puzzle's order.")
    exit: Rectangle = knob(factory=Rectangle, doc="Where the episode ends once the puzzle is solved.")
    starts: tuple[Start, ...] = knob((Start(),), "Where episodes may begin.")
    robot: RobotConfig = knob(factory=RobotConfig, doc="Base and arm.")
    puzzle: Puzzle = knob(factory=ButtonsPuzzle, doc="The rules.")
    reward: RewardConfig = knob(factory=RewardConfig, doc="Reward.")
    dynamics: DynamicsConfig = knob(factory=DynamicsConfig, doc="How primitives act.")
    horizon: int = knob(1000, "Primitives until truncation.", "", 1, 100_000_000)

    def check(self) -> None:
        """Check what spans several parts."""
        names = tuple(target.name for target in self.targets)
        if names != self.puzzle.target_names:
            raise ConfigError("instance.targets", names, f"the puzzle's targets {self.puzzle.target_names}")
        if tuple(placed.prop for placed in self.props) != self.puzzle.props:
            raise ConfigError("instance.props", len(self.props), "the puzzle's props, in its order")
        if not self.starts:
            raise ConfigError("instance.starts", self.starts, "at least one start")

    @cached_property
    def id(self) -> str:
        """Content hash: 16 hexadecimal digits of SHA-256 over the canonical JSON."""
        content = {k: v for k, v in self.to_dict().items() if k not in ("name", "seed")}
        text = json.dumps(content, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def compute_press_reach(self, target: Target, hand_height: float = 0.0) -> float:
        """Largest floor distance from which the presser touches a target; -1 where it never does.

        Args:
            target: what is to be touched.
            hand_height: height of the hand above the floor, m, where the hand presses.

        Returns:
            Metres from the body's axis (or from the hand) to the target's footprint.
        """
        if self.dynamics.press_with == "hand":
            gap = max(abs(hand_height - target.z) - target.half_z, 0.0)
            limit, extra = self.robot.hand_radius + self.dynamics.press_margin, 0.0
        else:
            gap = max(0.0, target.z - target.half_z - self.robot.body_height, -(target.z + target.half_z))
            limit, extra = self.dynamics.press_margin, self.robot.body_radius
        return extra + math.sqrt(limit**2 - gap**2) if gap <= limit else -1.0

    @property
    def reach_x(self) -> float:
        """Largest |x| the floor has, the alcove behind a door included."""
        return max(self.half_width, abs(self.exit.x_min), abs(self.exit.x_max))

    @property
    def reach_y(self) -> float:
        """Largest |y| the floor has, the alcove behind a door included."""
        return max(self.half_depth, abs(self.exit.y_min), abs(self.exit.y_max))

    def to_dict(self) -> dict[str, Any]:
        """Return nested plain values, with the schema version."""
        puzzle = {"kind": self.puzzle.kind} | self.puzzle.to_dict()
        return {"schema": SCHEMA_VERSION} | super().to_dict() | {"puzzle": puzzle}

    @classmethod
    def from_dict(cls, data: Any) -> Self:
        """Build from what `to_dict` gave.

        Raises:
            InstanceFileError: a newer schema, or content that is no instance.
        """
        try:
            if not isinstance(data, dict) or "schema" not in data:
                raise InstanceFileError("no room instance: the 'schema' field is missing")
            content = cast("dict[str, Any]", data)
            version = content["schema"]
            if version != SCHEMA_VERSION:
                raise InstanceFileError(
                    f"the instance has schema {version!r}, this version of hrl_escape reads {SCHEMA_VERSION}: "
                    "install a newer hrl-escape"
                )
            fields = {k: v for k, v in content.items() if k != "schema"}
            puzzle: dict[str, Any] = dict(fields.get("puzzle") or {})
            kind = get_puzzle_kind(puzzle.pop("kind", None))
            return super().from_dict(fields | {"puzzle": kind.puzzle_type.from_dict(puzzle)})
        except InstanceFileError:
            raise
        except (EscapeError, TypeError, ValueError) as error:
            raise InstanceFileError(f"no room instance: {error}") from None

    def save(self, path: str | Path) -> None:
        """Write the instance as JSON, atomically."""
        write_json(path, self.to_dict() | {"id": self.id})

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read an instance and check its content hash.

        Raises:
            InstanceFileError: truncated, corrupted, or of a newer schema.
        """
        data: Any = read_json(path)
        stated: Any = data.pop("id", None) if isinstance(data, dict) else None  # pyright: ignore
        try:
            instance = cls.from_dict(data)
        except InstanceFileError as error:
            raise InstanceFileError(f"{path}: {error}") from None
        if stated is not None and stated != instance.id:
            raise InstanceFileError(f"{path}: corrupted, its content has id {instance.id} and not {stated}")
        return instance
