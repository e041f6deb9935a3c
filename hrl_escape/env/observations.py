"""Observations: the registry of all kinds, and one class for each.

An entry holds a name, a line of documentation, the class that turns one state into numbers and, for the batched engine,
the function that does so for tensors of rooms. Environments, command line, grids, viewer and docs read the registry; to
add an observation, add an entry here, or call `register_observation` from your own package's entry point in the group
`hrl_escape.observations`.
"""

from __future__ import annotations

import math
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.engine import Renderer
from hrl_escape.env.kinematics import RoomState, Rules
from hrl_escape.env.sight import SIGHT_SLACK, Scanner, list_hiders
from hrl_escape.errors import ConfigError, UnknownNameError, UnsupportedError
from hrl_escape.plugins import load_entry_points

__all__ = ["LIDAR_RAYS", "OBJECT_WORDS", "PIXELS", "Observation", "Observer", "get_observation", "list_observations",
           "make_observer", "register_observation"]

LIDAR_RAYS = 16
PIXELS = (84, 84)


class Observer(ABC):
    """Turns states of one instance into observations of one kind.

    Args:
        rules: the room's rules.
        renderer: the engine's renderer, for pictures.

    Attributes:
        names: name of each number, in order; empty for pictures.
        low: smallest value of each number, in the observation's shape and type.
        high: largest value of each number.
        rows: name of the object of each row of `OBJECT_WORDS` that the vector begins with; none in most kinds.
    """

    names: tuple[str, ...]
    low: NDArray[Any]
    high: NDArray[Any]
    rows: tuple[str, ...] = ()

    def __init__(self, rules: Rules, renderer: Renderer | None = None) -> None:
        self._rules = rules
        self._instance = rules.instance
        self._puzzle = rules.instance.puzzle
        self._frame = rules.instance.frame
        self._puzzle_names = tuple(f"puzzle-{i + 1}" for i in range(len(self._frame.bounds)))
        self._joint_names = tuple(f"joint-{i + 1}" for i in range(rules.instance.robot.joints))

        self._seen: dict[Any, tuple[float, ...]] = {}

    @abstractmethod
    def observe(self, state: RoomState) -> NDArray[Any]:
        """Return a fresh array in the shape and type of `low`; for pictures, the renderer's room is in that state."""

    def _get_puzzle(self, state: RoomState) -> tuple[float, ...]:
        """The puzzle's numbers as this kind shows them; remembered, for a puzzle changes rarely."""
        numbers = self._seen.get(state.puzzle)
        if numbers is None:
            if len(self._seen) > 4096:  # a continuous puzzle never repeats itself
                self._seen.clear()
            numbers = self._scale_puzzle(self._puzzle.observe(state.puzzle))
            numbers += (0.0,) * (len(self._frame.bounds) - len(numbers))  # of absent targets
            self._seen[state.puzzle] = numbers
        return numbers

    def _scale_puzzle(self, numbers: tuple[float, ...]) -> tuple[float, ...]:
        return numbers


class StateObserver(Observer):
    """The paper's state vector (section 4.1) in natural units: m and rad.

    Position, heading, pitch and roll, the puzzle's numbers, joint angles.
    """

    def __init__(self, rules: Rules, renderer: Renderer | None = None) -> None:
        super().__init__(rules)
        instance = self._instance
        self.names = ("x", "y", "z", "heading", "pitch", "roll", *self._puzzle_names, *self._joint_names)
        frame, top = self._frame, self._frame.wall_height + instance.robot.body_height
        limits = [(-frame.reach_x, frame.reach_x), (-frame.reach_y, frame.reach_y), (-1.0, top),
                  *[(-math.pi, math.pi)] * 3, *frame.bounds, *rules.robot.limits]
        self.low, self.high = np.array(limits, dtype=np.float32).T.copy()

    def observe(self, state: RoomState) -> NDArray[np.float32]:
        """Return a fresh float32 array, one number a name."""
        rules = self._rules
        return np.array((state.x, state.y, state.z, rules.get_heading(state), state.pitch, state.roll,
                         *self._get_puzzle(state), *rules.get_angles(state)), dtype=np.float32)


def _clip(value: float) -> float:
    return -1.0 if value < -1.0 else 1.0 if value > 1.0 else value


class FeatureObserver(Observer):
    """Everything scaled into [-1, 1]; the default of the training scripts.

    Position over the floor's half size, sine and cosine of the heading, joint angles over their limits, the puzzle's
    numbers (rescaled unless they are bits).
    """

    def __init__(self, rules: Rules, renderer: Renderer | None = None) -> None:
        super().__init__(rules)
        self.names = ("x", "y", "sin-heading", "cos-heading", *self._joint_names, *self._puzzle_names)
        self._limits = [max(abs(low), abs(high)) for low, high in rules.robot.limits]
        self._reach = self._frame.reach_x, self._frame.reach_y
        self.high = np.ones(len(self.names), dtype=np.float32)
        self.low = -self.high

    def observe(self, state: RoomState) -> NDArray[np.float32]:
        """Return a fresh float32 array, one number a name."""
        rules = self._rules
        cos, sin = rules.get_rotation(state.heading_steps, state.heading_offset)
        joints = [_clip(a / m) for a, m in zip(rules.get_angles(state), self._limits, strict=True)]
        x, y = _clip(state.x / self._reach[0]), _clip(state.y / self._reach[1])
        return np.array((x, y, sin, cos, *joints, *self._get_puzzle(state)), dtype=np.float32)

    def _scale_puzzle(self, numbers: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(value if (low, high) == (0.0, 1.0) else _clip(2 * (value - low) / (high - low) - 1)
                     for value, (low, high) in zip(numbers, self._puzzle.bounds, strict=True))


class EgocentricObserver(Observer):
    """Sights from the robot's own place, its joints, and a ring of lidar, all in [-1, 1].

    Of each target its range over the room's diagonal, sine and cosine of its bearing, and 1 if it is lit; of each
    block, each plate and the exit range, sine and cosine. What is out of sight, or not in this instance, is all 0. Then
    joint angles over their limits, and lidar ranges over the diagonal, from straight ahead counter-clockwise.

    Walls, obstacles and shut doors hide things and stop rays.
    """

    def __init__(self, rules: Rules, renderer: Renderer | None = None) -> None:
        super().__init__(rules)
        instance, frame = self._instance, self._frame
        per_target = tuple(f"{name}-{word}" for name in frame.target_names for word in ("range", "sin", "cos", "lit"))
        things = (*(placed.prop.name for placed in instance.props), "exit")
        per_thing = tuple(f"{name}-{word}" for name in things for word in ("range", "sin", "cos"))
        self.names = (*per_target, *per_thing, *self._joint_names, *(f"lidar-{i}" for i in range(LIDAR_RAYS)))
        self._limits = [max(abs(low), abs(high)) for low, high in rules.robot.limits]
        self._diagonal = 2 * math.hypot(frame.reach_x, frame.reach_y)
        self._fixed = [(t.x, t.y) for t in instance.targets]
        self._standing = [(placed.x, placed.y) for placed in instance.props]
        half = [math.hypot(t.half_x, t.half_y) if instance.puzzle.target_cells else t.half_y for t in instance.targets]
        self._slack = SIGHT_SLACK + np.array([
            *half, *(placed.prop.half_size for placed in instance.props), 0.0])
        self._absent = [0.0] * (4 * (len(frame.target_names) - len(instance.targets)))
        self._bearings = np.arange(LIDAR_RAYS, dtype=np.float64) * (math.tau / LIDAR_RAYS)
        self._hiders, self._solids = list_hiders(instance), [solid.footprint for solid in instance.solids]
        leaves = (number for number, door in enumerate(instance.inner_doors) if door.role == "door")
        self._leaves = sum(1 << number for number in leaves)
        self._scanners: dict[tuple[bool, int], tuple[Scanner, Scanner | None]] = {}
        self.high = np.ones(len(self.names), dtype=np.float32)
        self.low = -self.high

    def _find_scanners(self, state: RoomState) -> tuple[Scanner, Scanner | None]:
        """Lidar, and lines of sight, among what stands: fixed solids and the doors that are shut."""
        doors = self._rules.inner_doors
        inner = doors.get_shut(state.puzzle) & self._leaves if doors else 0
        key = (self._instance.door is not None and not self._puzzle.is_solved(state.puzzle), inner)
        found = self._scanners.get(key)
        if found is None:
            leaves = [door.footprint for number, door in enumerate(self._instance.inner_doors) if inner >> number & 1]
            if key[0] and self._instance.door is not None:
                leaves.append(self._instance.door.footprint)
            hiders = self._hiders + leaves
            found = Scanner(self._solids + leaves, self._bearings), Scanner(hiders, self._bearings) if hiders else None
            if len(self._scanners) > 64:
                self._scanners.clear()
            self._scanners[key] = found
        return found

    def observe(self, state: RoomState) -> NDArray[np.float32]:
        """Return a fresh float32 array, one number a name."""
        x, y, diagonal = state.x, state.y, self._diagonal
        cos, sin = self._rules.get_rotation(state.heading_steps, state.heading_offset)
        scanner, hiders = self._find_scanners(state)
        standing = self._standing
        if standing and state.physics is not None:
            standing = [(numbers[0], numbers[1]) for numbers in state.physics.props]
        points = [*self._fixed, *standing, self._instance.exit.centre]
        sights = hiders.see(x, y, np.array(points), self._slack).tolist() if hiders else [True] * len(points)
        lit = self._puzzle.get_lit(state.puzzle)
        numbers: list[float] = []
        for number, ((at_x, at_y), is_seen) in enumerate(zip(points, sights, strict=True)):
            is_target = number < len(lit)
            if is_seen:
                ahead, aside = at_x - x, at_y - y
                away = math.hypot(ahead, aside)
                if away:
                    ahead, aside = ahead / away, aside / away
                else:
                    ahead, aside = 1.0, 0.0  # along +x, on the point itself
                numbers += away / diagonal, aside * cos - ahead * sin, ahead * cos + aside * sin
                if is_target:
                    numbers.append(float(lit[number]))
            else:
                numbers += (0.0,) * (4 if is_target else 3)
            if number == len(lit) - 1:
                numbers += self._absent
        numbers += map(_clip, map(operator.truediv, self._rules.get_angles(state), self._limits))
        seen = np.empty(len(self.names), dtype=np.float32)
        seen[:-LIDAR_RAYS] = numbers
        key = state.heading_steps if state.heading_offset == 0.0 else None
        ranges = scanner.measure(x, y, cos, sin, key)
        seen[-LIDAR_RAYS:] = np.minimum(ranges / diagonal, 1.0)
        return seen


OBJECT_WORDS = ("present", "target", "block", "plate", "exit", "ahead", "left", "sin", "cos", "half-x", "half-y",
                "lit")
"""Numbers in one row of `objects`."""


class ObjectObserver(Observer):
    """One row of numbers an object, whatever its number, and the joints; all in [-1, 1].

    Rows are those of the targets, blocks, plates and the exit. A row holds 1 where the object is present (rows of
    targets that this instance lacks are all 0: the mask), its type, its place ahead and to the left of the robot, sine
    and cosine of its direction as seen from the robot, half its sizes, and 1 if it is lit, or the exit open. Lengths
    are shares of the floor's diagonal. The order of rows says nothing. Joint angles over their limits follow.
    """

    def __init__(self, rules: Rules, renderer: Renderer | None = None) -> None:
        super().__init__(rules)
        instance, frame = self._instance, self._frame
        props, exit_ = instance.props, instance.exit
        self.rows = rows = (*frame.target_names, *(placed.prop.name for placed in props), "exit")
        self.names = (*(f"{row}-{word}" for row in rows for word in OBJECT_WORDS), *self._joint_names)
        self._diagonal = 2 * math.hypot(frame.reach_x, frame.reach_y)
        self._limits = [max(abs(low), abs(high)) for low, high in rules.robot.limits]
        things = [(t.x, t.y, t.yaw, t.half_x, t.half_y, "target") for t in instance.targets]
        things += [(p.x, p.y, p.yaw, p.prop.half_size, p.prop.half_size, p.prop.kind) for p in props]
        things += [(*exit_.centre, 0.0, (exit_.x_max - exit_.x_min) / 2, (exit_.y_max - exit_.y_min) / 2, "exit")]
        self._poses = np.array([thing[:3] for thing in things], dtype=np.float64)
        self._targets, absent = len(instance.targets), len(frame.target_names) - len(instance.targets)
        self._props = slice(self._targets, self._targets + len(props))
        self._places = [*range(self._targets), *range(self._targets + absent, len(rows))]
        self._rows = np.zeros((len(rows), len(OBJECT_WORDS)))
        for place, (_, _, _, half_x, half_y, kind) in zip(self._places, things, strict=True):
            self._rows[place, [0, OBJECT_WORDS.index(kind)]] = 1.0
            self._rows[place, 9:11] = half_x / self._diagonal, half_y / self._diagonal
        self.high = np.ones(len(self.names), dtype=np.float32)
        self.low = -self.high

    def observe(self, state: RoomState) -> NDArray[np.float32]:
        """Return a fresh float32 array, one number a name."""
        cos, sin = self._rules.get_rotation(state.heading_steps, state.heading_offset)
        poses, rows = self._poses.copy(), self._rows.copy()
        if state.physics is not None and self._props.stop > self._props.start:
            poses[self._props] = [_get_planar_pose(numbers) for numbers in state.physics.props]
        away_x, away_y = (poses[:, 0] - state.x) / self._diagonal, (poses[:, 1] - state.y) / self._diagonal
        thing_cos, thing_sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        rows[self._places, 5:9] = np.stack([
            cos * away_x + sin * away_y, cos * away_y - sin * away_x,
            thing_sin * cos - thing_cos * sin, thing_cos * cos + thing_sin * sin], axis=1)
        rows[: self._targets, 11] = self._puzzle.get_lit(state.puzzle)
        rows[-1, 11] = self._puzzle.is_solved(state.puzzle)
        joints = np.array(self._rules.get_angles(state)) / self._limits if self._limits else ()
        return np.clip(np.concatenate([rows.ravel(), joints]), -1.0, 1.0).astype(np.float32)


def _get_planar_pose(numbers: tuple[float, ...]) -> tuple[float, float, float]:
    """x, y and yaw of a rigid body, whose quaternion (x, y, z, w) follows its position."""
    x, y, _, qx, qy, qz, qw = numbers[:7]
    return x, y, math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))


class PixelObserver(Observer):
    """The picture of the robot's own camera, uint8."""

    names = ()
    low = np.zeros((*PIXELS, 3), dtype=np.uint8)
    high = np.full((*PIXELS, 3), 255, dtype=np.uint8)

    def __init__(self, rules: Rules, renderer: Renderer | None = None) -> None:
        super().__init__(rules)
        if renderer is None:
            raise UnsupportedError("pixels need an engine's renderer: use EscapeRoomEnv, or a vector observation")
        self._renderer = renderer

    def observe(self, state: RoomState) -> NDArray[np.uint8]:
        """Take the picture."""
        return self._renderer.render("robot", *PIXELS)


# --- the registry --------------------------------------------------------------------------


class Observation(NamedTuple):
    """One entry of the registry.

    Attributes:
        name: the value of `observation=`.
        doc: one line for lists and docs.
        observer: makes the observer of a room from its rules and its engine's renderer.
        tensor: import path `module:function` of its twin for the batched engine, which takes a batch's layout, tables
            and states and returns parts of the observation, float32 (numbers, rooms) each; None where there is none.
        is_vector: True for a vector of named numbers, which every agent can learn from.
    """

    name: str
    doc: str
    observer: Callable[[Rules, Renderer | None], Observer]
    tensor: str | None = None
    is_vector: bool = True


_REGISTRY: dict[str, Observation] = {}


def register_observation(observation: Observation) -> None:
    """Make an observation known by its name.

    Raises:
        ConfigError: another observation has that name.
    """
    if _REGISTRY.setdefault(observation.name, observation) != observation:
        raise ConfigError("observation.name", observation.name, "a name that no other observation has")


_TWINS = "hrl_escape.env.batched.observations"
for _entry in (
    Observation("state", "the paper's state vector: pose, puzzle, joints, in natural units", StateObserver,
                f"{_TWINS}:observe_state"),
    Observation("features", "position, heading, joints and puzzle scaled into [-1, 1]", FeatureObserver,
                f"{_TWINS}:observe_features"),
    Observation("egocentric", "range and bearing of what is in sight, joints, and a ring of lidar", EgocentricObserver,
                f"{_TWINS}:observe_egocentric"),
    Observation("objects", "one row a target, block, plate and exit: type, pose seen from the robot, size, lit",
                ObjectObserver, f"{_TWINS}:observe_objects"),
    Observation("pixels", "84 x 84 RGB from the robot's camera", PixelObserver, is_vector=False),
):
    register_observation(_entry)


@cache
def _load_entry_points() -> None:
    for observation in load_entry_points("hrl_escape.observations", "observation", "an Observation",
                                         lambda loaded: Observation(*loaded)):
        register_observation(observation)


def get_observation(name: str) -> Observation:
    """Look an observation up by name, entry points of other packages included.

    Raises:
        UnknownNameError: no observation of that name; the message lists those there are.
    """
    if isinstance(name, str) and name not in _REGISTRY:
        _load_entry_points()
    if not isinstance(name, str) or name not in _REGISTRY:
        raise UnknownNameError("observation", name, _REGISTRY)
    return _REGISTRY[name]


def list_observations() -> tuple[Observation, ...]:
    """Return all observations, entry points of other packages included."""
    _load_entry_points()
    return tuple(_REGISTRY.values())


def make_observer(name: str, rules: Rules, renderer: Renderer | None = None) -> Observer:
    """Make the observer of a room by name.

    Raises:
        UnknownNameError: no observation of that name.
        UnsupportedError: a picture without a renderer.
    """
    return get_observation(name).observer(rules, renderer)
