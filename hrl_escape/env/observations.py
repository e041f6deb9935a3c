"""What an agent sees: one class a kind of observation, from state to numbers.

`state`: float32, `6 + N_p + N_j`: x, y, z (m), heading, pitch, roll (rad), the puzzle's
numbers, joint angles (rad). The paper's state vector (section 4.1).

`features`: float32 in [-1, 1], `4 + N_j + N_p`: x and y over the floor's half size, sine and
cosine of the heading, joint angles over their limits, the puzzle's numbers (rescaled to
[-1, 1] where they are not bits).

`egocentric`: float32 in [-1, 1], `4 * targets + 3 + rays`: per target range over the room's
diagonal, sine and cosine of the bearing, 1 if lit; range, sine and cosine for the exit; then
lidar ranges over the diagonal, from straight ahead counter-clockwise.

`pixels`: uint8, (84, 84, 3), from the robot's camera; rendered by the engine.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.geometry import cast_rays, stack_footprints
from hrl_escape.env.kinematics import RoomState, Rules
from hrl_escape.errors import UnknownNameError

__all__ = ["LIDAR_RAYS", "OBSERVATIONS", "PIXELS", "Observer", "make_observer"]

LIDAR_RAYS = 16
PIXELS = (84, 84)


class Observer(ABC):
    """Turns states of one instance into observations of one kind.

    Attributes:
        names: what each number is, in order.
        low: smallest value of each number, float32.
        high: largest value of each number, float32.
    """

    names: tuple[str, ...]
    low: NDArray[np.float32]
    high: NDArray[np.float32]

    def __init__(self, rules: Rules) -> None:
        self._rules = rules
        self._instance = rules.instance
        self._puzzle = rules.instance.puzzle
        self._puzzle_names = tuple(f"puzzle-{i + 1}" for i in range(len(self._puzzle.bounds)))
        self._joint_names = tuple(f"joint-{i + 1}" for i in range(rules.instance.robot.joints))

        self._seen: dict[Any, tuple[float, ...]] = {}

    @abstractmethod
    def observe(self, state: RoomState) -> NDArray[np.float32]:
        """Return a fresh float32 array, one number a name."""

    def _get_puzzle(self, state: RoomState) -> tuple[float, ...]:
        """The puzzle's numbers as this kind shows them; remembered, for a puzzle changes rarely."""
        numbers = self._seen.get(state.puzzle)
        if numbers is None:
            if len(self._seen) > 4096:  # a continuous puzzle never repeats itself
                self._seen.clear()
            numbers = self._seen[state.puzzle] = self._scale_puzzle(self._puzzle.observe(state.puzzle))
        return numbers

    def _scale_puzzle(self, numbers: tuple[float, ...]) -> tuple[float, ...]:
        return numbers


class StateObserver(Observer):
    """The paper's state vector in natural units."""

    def __init__(self, rules: Rules) -> None:
        super().__init__(rules)
        instance = self._instance
        self.names = ("x", "y", "z", "heading", "pitch", "roll", *self._puzzle_names, *self._joint_names)
        top = instance.wall_height + instance.robot.body_height
        limits = [(-instance.reach_x, instance.reach_x), (-instance.reach_y, instance.reach_y), (-1.0, top),
                  *[(-math.pi, math.pi)] * 3, *self._puzzle.bounds, *rules.robot.limits]
        self.low, self.high = np.array(limits, dtype=np.float32).T.copy()

    def observe(self, state: RoomState) -> NDArray[np.float32]:
        """See the module's first lines for the layout."""
        rules = self._rules
        return np.array((state.x, state.y, state.z, rules.get_heading(state), state.pitch, state.roll,
                         *self._get_puzzle(state), *rules.get_angles(state)), dtype=np.float32)


def _clip(value: float) -> float:
    return -1.0 if value < -1.0 else 1.0 if value > 1.0 else value


class FeatureObserver(Observer):
    """Everything scaled into [-1, 1]; the default of the training scripts."""

    def __init__(self, rules: Rules) -> None:
        super().__init__(rules)
        self.names = ("x", "y", "sin-heading", "cos-heading", *self._joint_names, *self._puzzle_names)
        self._limits = [max(abs(low), abs(high)) for low, high in rules.robot.limits]
        self._reach = rules.instance.reach_x, rules.instance.reach_y
        self.high = np.ones(len(self.names), dtype=np.float32)
        self.low = -self.high

    def observe(self, state: RoomState) -> NDArray[np.float32]:
        """See the module's first lines for the layout."""
        rules = self._rules
        cos, sin = rules.get_rotation(state.heading_steps, state.heading_offset)
        joints = [_clip(a / m) for a, m in zip(rules.get_angles(state), self._limits, strict=True)]
        x, y = _clip(state.x / self._reach[0]), _clip(state.y / self._reach[1])
        return np.array((x, y, sin, cos, *joints, *self._get_puzzle(state)), dtype=np.float32)

    def _scale_puzzle(self, numbers: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(value if (low, high) == (0.0, 1.0) else _clip(2 * (value - low) / (high - low) - 1)
                     for value, (low, high) in zip(numbers, self._puzzle.bounds, strict=True))


class EgocentricObserver(Observer):
    """Ranges and bearings from the robot's own place, and a ring of lidar."""

    def __init__(self, rules: Rules) -> None:
        super().__init__(rules)
        instance = self._instance
        per_target = tuple(f"{t.name}-{word}" for t in instance.targets for word in ("range", "sin", "cos", "lit"))
        rays = tuple(f"lidar-{i}" for i in range(LIDAR_RAYS))
        self.names = (*per_target, "exit-range", "exit-sin", "exit-cos", *rays)
        self._points = np.array([(t.x, t.y) for t in instance.targets] + [instance.exit.centre], dtype=np.float64)
        self._diagonal = 2 * math.hypot(instance.reach_x, instance.reach_y)
        self._rays = np.arange(LIDAR_RAYS) * (math.tau / LIDAR_RAYS)
        shapes = [solid.footprint for solid in instance.solids]
        shut = [instance.door.footprint] if instance.door else []
        self._open_shapes, self._shut_shapes = stack_footprints(shapes), stack_footprints(shapes + shut)
        self.high = np.ones(len(self.names), dtype=np.float32)
        self.low = -self.high

    def observe(self, state: RoomState) -> NDArray[np.float32]:
        """See the module's first lines for the layout."""
        heading = self._rules.get_heading(state)
        away = self._points - (state.x, state.y)
        bearing = np.arctan2(away[:, 1], away[:, 0]) - heading
        ranges = np.hypot(away[:, 0], away[:, 1]) / self._diagonal
        lit = np.array([*self._puzzle.get_lit(state.puzzle), 0.0])
        seen = np.stack([ranges, np.sin(bearing), np.cos(bearing), lit], axis=1).ravel()[:-1]
        shapes = self._open_shapes if self._puzzle.is_solved(state.puzzle) else self._shut_shapes
        angles = np.asarray(heading + self._rays, dtype=np.float64)
        lidar = cast_rays(state.x, state.y, angles, shapes, self._diagonal) / self._diagonal
        return np.clip(np.concatenate([seen, lidar]), -1.0, 1.0).astype(np.float32)


OBSERVATIONS: dict[str, str] = {
    "state": "the paper's state vector: pose, puzzle, joints, in natural units",
    "features": "position, heading, joints and puzzle scaled into [-1, 1]",
    "egocentric": "range and bearing of buttons and exit, and a ring of lidar",
    "pixels": "84 x 84 RGB from the robot's camera",
}
_OBSERVERS = {"state": StateObserver, "features": FeatureObserver, "egocentric": EgocentricObserver}


def make_observer(kind: str, rules: Rules) -> Observer | None:
    """Make an observer by name; None for `pixels`, which the engine renders.

    Raises:
        UnknownNameError: no observation of that name.
    """
    if kind not in OBSERVATIONS:
        raise UnknownNameError("observation", kind, OBSERVATIONS)
    return None if kind == "pixels" else _OBSERVERS[kind](rules)


