"""One sampled room: a `RoomInstance` holds every concrete pose and size, the puzzle and the robot.

Instances are immutable values. They serialise to JSON and back without loss. Their content hash, `id`, identifies the
room in results. `check_room` checks rooms from files; `sampling/generation.py` samples rooms from a configuration.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from pkgutil import resolve_name
from typing import Annotated, Any, Literal, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

from hrl_escape.env.config import CONTACT_SKIN, DynamicsConfig, RobotConfig
from hrl_escape.env.geometry import (
    LARGEST_LENGTH,
    Footprint,
    Solid,
    compute_distance_many,
    make_footprint,
    stack_footprints,
)
from hrl_escape.env.puzzles.base import Prop, Puzzle
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.env.puzzles.mixins import Doored, Mapped, Propped, Pushing, get_mixin
from hrl_escape.env.puzzles.symbolic import SymbolicModel
from hrl_escape.env.rewards import RewardConfig
from hrl_escape.env.schema import HashedSettings
from hrl_escape.errors import ConfigError, EscapeError, InstanceFileError, OldFormatError, show_value
from hrl_escape.figures import Pictured
from hrl_escape.files import read_json, write_json
from hrl_escape.settings import Range

SCHEMA_VERSION = 1
_DIFFICULTY = "hrl_escape.benchmark.difficulty:measure_difficulty"
"""Measures a room's difficulty with planners and agents, which are above rooms; imported when asked for."""
_OVERLAP = 1e-6
"""Overlap, m, between the floor of the alcove behind a door and the floor of the room."""


@dataclasses.dataclass(frozen=True)
class Target(HashedSettings):
    """A pressable box on a wall, or a pad on the floor. Neither blocks the way in kinematic rooms."""

    _section = "target"
    name: str = "button-1"
    """Unique name of the target within the room."""
    x: Annotated[float, Range(-LARGEST_LENGTH, LARGEST_LENGTH, "m")] = 0.0
    """x of the centre, room frame."""
    y: Annotated[float, Range(-LARGEST_LENGTH, LARGEST_LENGTH, "m")] = 0.0
    """y of the centre, room frame."""
    z: Annotated[float, Range(-LARGEST_LENGTH, LARGEST_LENGTH, "m")] = 0.5
    """Height of the centre above the floor."""
    half_x: Annotated[float, Range(0, LARGEST_LENGTH, "m")] = 0.5
    """Half the width, along the target's x."""
    half_y: Annotated[float, Range(0, LARGEST_LENGTH, "m")] = 0.05
    """Half the thickness, along the target's y."""
    half_z: Annotated[float, Range(0, LARGEST_LENGTH, "m")] = 0.5
    """Half the height, along z."""
    yaw: Annotated[float, Range(-10, 10, "rad")] = 0.0
    """Direction of the target's x, along its width."""
    kind: Literal["panel", "pad"] = "panel"
    """A panel is pressed by touch; a pad is pressed while the body's axis is over it."""

    @cached_property
    def footprint(self) -> Footprint:
        """Outline of the target on the floor."""
        return make_footprint(self.x, self.y, self.half_x, self.half_y, self.yaw)


@dataclasses.dataclass(frozen=True)
class Rectangle(HashedSettings):
    """An axis-aligned closed rectangle on the floor."""

    _section = "rectangle"
    x_min: Annotated[float, Range(-LARGEST_LENGTH, LARGEST_LENGTH, "m")] = 0.0
    """Smallest x, the west edge."""
    x_max: Annotated[float, Range(-LARGEST_LENGTH, LARGEST_LENGTH, "m")] = 1.0
    """Largest x, the east edge."""
    y_min: Annotated[float, Range(-LARGEST_LENGTH, LARGEST_LENGTH, "m")] = 0.0
    """Smallest y, the south edge."""
    y_max: Annotated[float, Range(-LARGEST_LENGTH, LARGEST_LENGTH, "m")] = 1.0
    """Largest y, the north edge."""

    def check(self) -> None:
        """Check that x_min <= x_max and y_min <= y_max."""
        if self.x_min > self.x_max or self.y_min > self.y_max:
            raise ConfigError("rectangle", (self.x_min, self.x_max, self.y_min, self.y_max),
                              "x_min of at most x_max, and y_min of at most y_max")

    def contains(self, x: float, y: float) -> bool:
        """Return whether a point is inside the rectangle, edges included."""
        return self.x_min <= x <= self.x_max and self.y_min <= y <= self.y_max

    @property
    def is_flat(self) -> bool:
        """True if the rectangle has no area, such as the exit of a world without a puzzle."""
        return self.x_min == self.x_max or self.y_min == self.y_max

    @property
    def centre(self) -> tuple[float, float]:
        """Centre (x, y) of the rectangle, m."""
        return (self.x_min + self.x_max) / 2, (self.y_min + self.y_max) / 2


@dataclasses.dataclass(frozen=True)
class Start(HashedSettings):
    """A pose of the base: heading is `heading_steps` turn steps plus `heading_offset` rad."""

    _section = "start"
    x: Annotated[float, Range(-LARGEST_LENGTH, LARGEST_LENGTH, "m")] = 0.0
    """Position of the base's axis along x."""
    y: Annotated[float, Range(-LARGEST_LENGTH, LARGEST_LENGTH, "m")] = 0.0
    """Position of the base's axis along y."""
    heading_steps: Annotated[int, Range(0, 359)] = 0
    """Heading in turn steps."""
    heading_offset: Annotated[float, Range(-math.pi, math.pi, "rad")] = 0.0
    """Heading beyond whole steps."""


@dataclasses.dataclass(frozen=True)
class PlacedProp(HashedSettings):
    """A prop of the puzzle with its pose at the start of an episode."""

    _section = "prop"
    prop: Prop = Prop()
    """Kind, size and mass of the prop."""
    x: Annotated[float, Range(-LARGEST_LENGTH, LARGEST_LENGTH, "m")] = 0.0
    """x of its centre."""
    y: Annotated[float, Range(-LARGEST_LENGTH, LARGEST_LENGTH, "m")] = 0.0
    """y of its centre."""
    yaw: Annotated[float, Range(-10, 10, "rad")] = 0.0
    """Direction of the prop's x, counter-clockwise from the room's x."""


@dataclasses.dataclass(frozen=True)
class SpaceLayout(HashedSettings):
    """Layout and scale of observations and options, the same for all instances of a room configuration.

    If an instance has fewer targets than its layout, the missing ones have zeros in observations and masked options.
    """

    _section = "frame"
    reach_x: Annotated[float, Range(0, LARGEST_LENGTH, "m")] = 10.0
    """Largest |x| of the floor over all instances."""
    reach_y: Annotated[float, Range(0, LARGEST_LENGTH, "m")] = 10.0
    """Largest |y| of the floor over all instances."""
    wall_height: Annotated[float, Range(0, LARGEST_LENGTH, "m")] = 3.0
    """Largest wall height over all instances."""
    target_names: tuple[str, ...] = ()
    """Target names of the instance with the most targets."""
    bounds: tuple[tuple[float, float], ...] = ()
    """Lowest and highest value of each number of the puzzle."""


@dataclasses.dataclass(frozen=True)
class RoomInstance(Pictured, HashedSettings):
    """One room, ready to be simulated, planned in and drawn.

    The floor is the rectangle |x| <= half_width, |y| <= half_depth, plus the alcove behind the exit door if there is
    one. `name` and `seed` record the origin of the instance. They do not change `id`.
    """

    _section = "instance"
    _picture = "hrl_escape.env.pictures.maps:make_map"
    name: str = "custom"
    """Name of the room configuration."""
    seed: Annotated[int, Range(0, 2**63 - 1)] | None = None
    """Seed that generated the instance."""
    half_width: Annotated[float, Range(0, LARGEST_LENGTH, "m")] = 10.0
    """Half the inner size along x."""
    half_depth: Annotated[float, Range(0, LARGEST_LENGTH, "m")] = 10.0
    """Half the inner size along y."""
    wall_height: Annotated[float, Range(0, LARGEST_LENGTH, "m")] = 3.0
    """Height of all walls above the floor."""
    solids: tuple[Solid, ...] = ()
    """Fixed solids: walls and obstacles, without doors."""
    door: Solid | None = None
    """Door in the exit's doorway, until the puzzle is solved, or None for an exit without a door."""
    inner_doors: tuple[Solid, ...] = ()
    """Solids that are present while the puzzle marks them as shut: doors, and things that block a cell."""
    ways: tuple[tuple[Annotated[int, Range(0, 63)], ...], ...] = ()
    """Indices of the inner doors on the way from the starts to each target and, last, to the exit. Empty for puzzles
    with a map."""
    targets: tuple[Target, ...] = ()
    """Things to press, in the order of the puzzle."""
    props: tuple[PlacedProp, ...] = ()
    """Movable things on the floor, in the order of the puzzle."""
    exit: Rectangle = Rectangle()
    """Region where the episode ends once the puzzle is solved."""
    starts: tuple[Start, ...] = (Start(),)
    """Possible start poses of episodes."""
    robot: RobotConfig = RobotConfig()
    """Robot: base, arm, and sizes of its primitives."""
    puzzle: Puzzle = ButtonsPuzzle()
    """Concrete puzzle that opens the exit."""
    reward: RewardConfig = RewardConfig()
    """Reward of each primitive and of the exit."""
    dynamics: DynamicsConfig = DynamicsConfig()
    """Dynamics of the primitives: kinematic or physical, noise and slips."""
    horizon: Annotated[int, Range(1, 100_000_000)] = 1000
    """Largest number of primitives in an episode, which is then truncated."""
    shared: SpaceLayout | None = None
    """Layout shared by all instances of the configuration, or None for the room's own."""

    def check(self) -> None:
        """Check the limits that relate several fields."""
        if self.shared is not None:
            self._check_frame(self.shared)
        names = tuple(target.name for target in self.targets)
        if names != self.puzzle.target_names:
            raise ConfigError("instance.targets", names, f"the puzzle's targets {self.puzzle.target_names}")
        if tuple(placed.prop for placed in self.props) != get_mixin(self.puzzle, Propped).props:
            raise ConfigError("instance.props", len(self.props), "the puzzle's props, in its order")
        door_facts = get_mixin(self.puzzle, Doored).door_facts
        doors = len(get_mixin(self.puzzle, Mapped).blockable_cells) or len(door_facts)
        if len(self.inner_doors) != doors:
            raise ConfigError("instance.inner_doors", len(self.inner_doors), f"{doors}, as many as the puzzle has")
        if door_facts:
            self._check_ways()
        if self.inner_doors and self.dynamics.kind != "kinematic":
            raise ConfigError("dynamics.kind", self.dynamics.kind, "'kinematic' where the puzzle opens inner doors")
        if isinstance(self.puzzle, Pushing) and (self.dynamics.blocked != "stay" or self.dynamics.noise):
            raise ConfigError("dynamics", (self.dynamics.blocked, self.dynamics.noise),
                              "blocked 'stay' and no noise where things are pushed from cell to cell")
        if isinstance(self.puzzle, Pushing) and self.robot.moves:
            raise ConfigError("robot.moves", tuple(move.name for move in self.robot.moves),
                              "none where things are pushed from cell to cell")
        if not self.robot.base.turns_anywhere and (self.inner_doors or self.props):
            raise ConfigError("robot.footprint", self.robot.footprint, "'disc' for a puzzle with inner doors or props")
        if not self.starts:
            raise ConfigError("instance.starts", self.starts, "at least one start")
        headings = round(360 / self.robot.turn_step_deg)
        for start in self.starts:
            if start.heading_steps >= headings:
                raise ConfigError("start.heading_steps", start.heading_steps,
                                  f"from 0 to {headings - 1} at turns of {self.robot.turn_step_deg:g} degrees")
        if self.dynamics.press_with == "hand" and self.robot.joints == 0:
            raise ConfigError("dynamics.press_with", "hand", "'body', or a robot with robot.joints >= 1")
        for target in self.targets:
            if (target.kind == "pad") != (target.name in self.puzzle.pad_names):
                raise ConfigError("target.kind", target.kind, "'pad' exactly for the puzzle's pads")

    def _check_ways(self) -> None:
        if len(self.ways) != len(self.targets) + 1 or any(door >= len(self.inner_doors)
                                                          for way in self.ways for door in way):
            raise ConfigError("instance.ways", self.ways, "numbers of inner doors, for each target and the exit")
        if self.dynamics.press_with == "hand":
            raise ConfigError("dynamics.press_with", "hand", "'body' in a room with inner doors: arms reach past them")

    def _check_frame(self, frame: SpaceLayout) -> None:
        names = self.puzzle.target_names
        own, most = (self.reach_x, self.reach_y, self.wall_height), (frame.reach_x, frame.reach_y, frame.wall_height)
        if frame.target_names[: len(names)] != names or len(frame.bounds) < len(self.puzzle.bounds):
            raise ConfigError("frame.target_names", frame.target_names, f"names that begin with {names}")
        if any(high < value for high, value in zip(most, own, strict=True)):
            raise ConfigError("frame", most, f"at least this room's {own}")

    def __repr__(self) -> str:
        seed = "" if self.seed is None else f", seed {self.seed}"
        count = len(self.targets)
        return (f"<RoomInstance {self.name}{seed}: {2 * self.half_width:g} x {2 * self.half_depth:g} m, {count} "
                f"target{'s' * (count != 1)}, id {self.id}>")

    def difficulty(self) -> Any:
        """Measure the difficulty of the room, once; later pictures of the room show it.

        Returns:
            `hrl_escape.benchmark.difficulty.Difficulty`: oracle, random options, search baseline and random walk.
        """
        return self._difficulty

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines of the room's difficulty for pictures; none before it has been measured."""
        return self._difficulty.lines if "_difficulty" in vars(self) else ()

    @cached_property
    def _difficulty(self) -> Any:
        return resolve_name(_DIFFICULTY)(self)

    @cached_property
    def frame(self) -> SpaceLayout:
        """Layout and scale of observations in this room: the shared layout, or the room's own."""
        return self.shared or SpaceLayout(self.reach_x, self.reach_y, self.wall_height, self.puzzle.target_names,
                                          self.puzzle.bounds)

    @property
    def has_extra_reward(self) -> bool:
        """True if the puzzle or the reward pays more than `step` and `exit`. The return then depends on the path."""
        return self.puzzle.has_reward or not self.reward.is_sparse

    @cached_property
    def symbolic_model(self) -> SymbolicModel:
        """Symbolic model of the puzzle, with open doors as preconditions of the targets and exits behind them."""
        model, facts = self.puzzle.symbolic.make_symbolic_model(), get_mixin(self.puzzle, Doored).door_facts
        if not facts:
            return model
        *ways, last = (frozenset(facts[door] for door in way) for way in self.ways)
        way_to = dict(zip(self.puzzle.target_names, ways, strict=True))
        operators = tuple(dataclasses.replace(op, preconditions=op.preconditions | way_to.get(op.target, frozenset()))
                          for op in model.operators)
        return dataclasses.replace(model, operators=operators, goal=model.goal | last)

    def find_model(self, state: Any) -> SymbolicModel:
        """Return the symbolic model from a puzzle state; it differs from `symbolic_model` if things of a map moved."""
        return self.puzzle.symbolic.find_model(state) or self.symbolic_model

    @cached_property
    def digest(self) -> str:
        """Content hash: 64 hexadecimal digits of SHA-256 over the canonical JSON."""
        content = {k: v for k, v in self.to_dict().items() if k not in ("name", "seed")}
        text = json.dumps(content, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()

    @cached_property
    def id(self) -> str:
        """First 16 digits of the content hash."""
        return self.digest[:16]

    def compute_press_reach(self, target: Target, hand_height: float = 0.0) -> float:
        """Return the largest floor distance, m, of the body's axis from a target's footprint that touches it.

        Returns -1 if the target cannot be touched. If the hand presses, this is the distance of the hand at
        `hand_height` m above the floor.
        """
        margin = self.compute_press_margin(target, hand_height)
        is_body = self.dynamics.press_with == "body" and target.kind == "panel" and margin >= 0.0
        return self.robot.outer_radius + margin if is_body else margin

    def compute_press_margin(self, target: Target, hand_height: float = 0.0) -> float:
        """Return the largest floor distance, m, at which the outline, hand or (for pads) axis touches; -1 for never."""
        if target.kind == "pad":
            return 0.0
        if self.dynamics.press_with == "hand":
            gap = max(abs(hand_height - target.z) - target.half_z, 0.0)
            limit = self.robot.hand_radius + self.dynamics.press_margin
        else:
            gap = max(0.0, target.z - target.half_z - self.robot.body_height, -(target.z + target.half_z))
            limit = self.dynamics.press_margin
        return math.sqrt(limit**2 - gap**2) if gap <= limit else -1.0

    @property
    def all_solids(self) -> tuple[Solid, ...]:
        """Walls and obstacles, then the exit door if there is one."""
        return self.solids if self.door is None else (*self.solids, self.door)

    @property
    def door_swing(self) -> float:
        """Sign of the hinge angle that opens the exit door outwards; 1 without a door."""
        if self.door is None:
            return 1.0
        (x, y), yaw = self.exit.centre, self.door.yaw
        return math.copysign(1.0, math.cos(yaw) * (y - self.door.y) - math.sin(yaw) * (x - self.door.x))

    @property
    def reach_x(self) -> float:
        """Largest |x| of the floor, m, with the alcove behind a door."""
        return max(self.half_width, abs(self.exit.x_min), abs(self.exit.x_max))

    @property
    def reach_y(self) -> float:
        """Largest |y| of the floor, m, with the alcove behind a door."""
        return max(self.half_depth, abs(self.exit.y_min), abs(self.exit.y_max))

    def to_dict(self) -> dict[str, Any]:
        """Return nested plain values with the schema version; a layout equal to the room's own is omitted."""
        return {"schema": SCHEMA_VERSION} | super().to_dict()

    @classmethod
    def from_dict(cls, data: Any) -> Self:
        """Build an instance from the output of `to_dict`. Check that walls enclose the floor and that starts are free.

        Raises:
            InstanceFileError: a newer schema, a missing field, or invalid content.
        """
        try:
            if not isinstance(data, dict) or "schema" not in data:
                raise InstanceFileError("not a room instance: the 'schema' field is missing")
            content = cast("dict[str, Any]", data)
            version = content["schema"]
            if type(version) is not int or version != SCHEMA_VERSION:
                raise InstanceFileError(
                    f"the instance has schema {show_value(version)}, this version of hrl_escape reads "
                    f"{SCHEMA_VERSION}: install a newer hrl-escape"
                )
            instance = super().from_dict({name: value for name, value in content.items() if name != "schema"})
            missing = _find_missing(content, instance.to_dict(), "instance")
            if missing is not None:
                raise InstanceFileError(f"not a room instance: the field {missing} is missing")
            check_room(instance)
            return instance
        except InstanceFileError:
            raise
        except (EscapeError, TypeError, ValueError, RecursionError) as error:
            raise InstanceFileError(f"not a room instance: {error}") from None

    def save(self, path: str | Path) -> None:
        """Write the instance as JSON, atomically."""
        write_json(path, self.to_dict() | {"id": self.id})

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read an instance from JSON and check its content hash.

        Raises:
            FileReadError: the file is missing, unreadable, or not JSON.
            InstanceFileError: the file was edited or corrupted, or has a newer schema.
            OldFormatError: its puzzle has a field of version 0.3; `hrl-escape convert` renames it.
        """
        data: Any = read_json(path, "room instance")
        stated: Any = cast("dict[str, Any]", data).pop("id", None) if isinstance(data, dict) else None
        try:
            instance = cls.from_dict(data)
        except InstanceFileError as error:
            puzzle: Any = cast("dict[str, Any]", data).get("puzzle") if isinstance(data, dict) else None
            if isinstance(puzzle, dict) and "marks" in puzzle:
                raise OldFormatError(path, "room") from None  # cues were marks
            raise InstanceFileError(f"{path}: {error}") from None
        if stated != instance.id:
            raise InstanceFileError(f"{path}: edited or corrupted: the content has id {instance.id!r}, the file states "
                                    f"{show_value(stated)}. Make rooms with generate() and save()")
        return instance


InstanceForm: TypeAlias = RoomInstance | dict[str, Any] | str | Path
"""A room, its dict form, or the path of a saved one (JSON)."""


def read_instance(form: InstanceForm) -> RoomInstance:
    """Return a room from any of its forms, with the checks for untrusted rooms.

    Raises:
        ConfigError: walls have gaps, or starts are not free.
        FileReadError: no such file.
        InstanceFileError: the file or table is not a valid room.
    """
    if isinstance(form, RoomInstance):
        check_room(form)
        return form
    if isinstance(form, (str, Path)):
        return RoomInstance.load(form)
    if isinstance(form, Mapping):  # pyright: ignore[reportUnnecessaryIsInstance]  # callers may pass anything
        return RoomInstance.from_dict(form)
    raise ConfigError("instance", form, "a RoomInstance, its dict form, or the path of a saved room (JSON)")


def _find_missing(given: Any, whole: Any, path: str) -> str | None:
    """Dotted path of the first field, at any depth, that a table lacks, or None if it is complete."""
    if isinstance(whole, dict):
        for name, part in cast("dict[str, Any]", whole).items():
            if name not in given:
                return f"{path}.{name}"
            missing = _find_missing(given[name], part, f"{path}.{name}")
            if missing is not None:
                return missing
    elif isinstance(whole, (list, tuple)):
        for number, part in enumerate(cast("list[Any]", whole)):
            missing = _find_missing(given[number], part, f"{path}[{number}]")
            if missing is not None:
                return missing
    return None


# --- checks of untrusted rooms ---------------------------------------------------------------


def check_room(instance: RoomInstance) -> None:
    """Check that the walls enclose the floor, that the starts are free and that all things are on the floor.

    It does not check whether the room can be solved; the certificate does.

    Raises:
        ConfigError: names the gap, the start or the thing.
    """
    solids = [solid.footprint for solid in instance.all_solids]
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
    _check_centres(instance)


def _check_centres(instance: RoomInstance) -> None:
    """Check that the centres of targets, props, inner doors and exit are on the floor."""
    for name in ("targets", "props", "inner_doors"):
        for number, thing in enumerate(getattr(instance, name)):
            if not is_on_floor(instance, thing.x, thing.y, _OVERLAP):
                raise ConfigError(f"instance.{name}[{number}]", (thing.x, thing.y), _describe_floor(instance))
    if not is_on_floor(instance, *instance.exit.centre, _OVERLAP):
        raise ConfigError("instance.exit", instance.exit.centre, _describe_floor(instance))


def _describe_floor(instance: RoomInstance) -> str:
    alcove = "" if instance.door is None else ", or in the alcove behind the exit door"
    return f"a centre on the floor, |x| <= {instance.half_width:g} m and |y| <= {instance.half_depth:g} m{alcove}"


def does_base_fit(robot: RobotConfig, pose: Start, solids: Sequence[Footprint]) -> bool:
    """Return whether a base is clear of solids at a pose. The heading has no effect for a round base."""
    heading = pose.heading_steps * math.radians(robot.turn_step_deg) + pose.heading_offset
    rotation = round(math.cos(heading), 15), round(math.sin(heading), 15)
    return robot.base.turns_anywhere or robot.base.grow(CONTACT_SKIN).measure_gap(
        pose.x, pose.y, rotation, solids) >= -1e-6


def _trace_rim(instance: RoomInstance, spacing: float) -> NDArray[np.float64]:
    """Points (n, 2) along the edge of the floor and the alcove, at most `spacing` m apart."""
    areas, points = _list_areas(instance), list[NDArray[np.float64]]()
    for number, area in enumerate(areas):
        rim = _trace_rectangle(*area, spacing)
        for other in areas[:number] + areas[number + 1 :]:
            x_min, x_max, y_min, y_max = other
            inside = (rim[:, 0] > x_min) & (rim[:, 0] < x_max) & (rim[:, 1] > y_min) & (rim[:, 1] < y_max)
            rim = rim[~inside]
        points.append(rim)
    return np.concatenate(points)


def is_on_floor(instance: RoomInstance, x: float, y: float, slack: float = 0.0) -> bool:
    """Return whether a point is on the floor or in the alcove, or at most `slack` m outside."""
    return any(x_min - slack <= x <= x_max + slack and y_min - slack <= y <= y_max + slack
               for x_min, x_max, y_min, y_max in _list_areas(instance))


def compute_floors(instance: RoomInstance) -> tuple[Rectangle, ...]:
    """Return the floor rectangles: the room's, then the alcove's if there is an exit door."""
    return tuple(Rectangle(*area) for area in _list_areas(instance, 0.0, 0.0))


def _list_areas(instance: RoomInstance, skin: float = CONTACT_SKIN, overlap: float = _OVERLAP
                ) -> list[tuple[float, float, float, float]]:
    """Rectangles (x_min, x_max, y_min, y_max) of the floor and of the alcove.

    The alcove is deeper than the exit by the radius of the body and `skin`, and overlaps the floor of the room through
    the doorway by `overlap` m.
    """
    half_x, half_y, area = instance.half_width, instance.half_depth, instance.exit
    areas = [(-half_x, half_x, -half_y, half_y)]
    if instance.door is not None:
        beyond = instance.robot.outer_radius + skin
        areas.append((*_stretch(area.x_min, area.x_max, half_x, beyond, overlap),
                      *_stretch(area.y_min, area.y_max, half_y, beyond, overlap)))
    return areas


def _stretch(low: float, high: float, half: float, beyond: float, overlap: float) -> tuple[float, float]:
    """Extent of an alcove along one axis, from the floor to the wall behind the exit."""
    low, high = min(low, half - overlap), max(high, overlap - half)
    return low - beyond * (low < -half), high + beyond * (high > half)


def _trace_rectangle(x_min: float, x_max: float, y_min: float, y_max: float, spacing: float) -> NDArray[np.float64]:
    xs = np.linspace(x_min, x_max, 1 + math.ceil((x_max - x_min) / spacing))
    ys = np.linspace(y_min, y_max, 1 + math.ceil((y_max - y_min) / spacing))
    sides = [np.stack([xs, np.full_like(xs, y)], axis=1) for y in (y_min, y_max)]
    sides += [np.stack([np.full_like(ys, x), ys], axis=1) for x in (x_min, x_max)]
    return np.concatenate(sides)
