"""Limits of speed, acceleration and jerk, and the shortest time of a plan within them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.robot import Robot
from hrl_escape.errors import ConfigError


@dataclasses.dataclass(frozen=True)
class MotionLimits:
    """Limits of the base, in every direction of the plane, and of the joints: one number for all, or one per joint.

    Attributes:
        speed: of the base's axis, m/s.
        acceleration: of the base's axis, m/s^2.
        jerk: of the base's axis, m/s^3.
        turn_speed: of the base, rad/s.
        turn_acceleration: of the base, rad/s^2.
        turn_jerk: of the base, rad/s^3.
        joint_speed: of joints, rad/s; a joint never exceeds the speed in its URDF.
        joint_acceleration: of joints, rad/s^2.
        joint_jerk: of joints, rad/s^3.
    """

    speed: float = 1.0
    acceleration: float = 1.0
    jerk: float = 10.0
    turn_speed: float = 1.5
    turn_acceleration: float = 3.0
    turn_jerk: float = 30.0
    joint_speed: float | tuple[float, ...] = 1.0
    joint_acceleration: float | tuple[float, ...] = 2.0
    joint_jerk: float | tuple[float, ...] = 20.0

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            numbers = value if isinstance(value, tuple) and field.name.startswith("joint") else (value,)
            for number in numbers:
                if isinstance(number, bool) or not isinstance(number, (int, float)) or not 0.0 < number < math.inf:
                    raise ConfigError(f"limits.{field.name}", value, "a finite number above 0")

    def stack(self, names: Sequence[str], robot: Robot | None = None) -> NDArray[np.float64]:
        """Return the largest speed, acceleration and jerk of each coordinate, (coordinates, 3).

        Args:
            names: `x`, `y`, `heading`, and joints.
            robot: names the joints and limits their speeds by its URDF, or None for joints in the order of `names`.

        Raises:
            ConfigError: the limits are for another number of joints.
        """
        joints = robot.joint_names if robot else tuple(name for name in names if name not in ("x", "y", "heading"))
        own: dict[str, list[float]] = {name: [] for name in joints}
        for kind in ("joint_speed", "joint_acceleration", "joint_jerk"):
            value = getattr(self, kind)
            values = value if isinstance(value, tuple) else (value,) * len(joints)
            if len(values) != len(joints):
                raise ConfigError(f"limits.{kind}", value, f"one number, or one for each of {len(joints)} joints")
            for number, name in enumerate(joints):
                top = robot.speeds[number] if robot and kind == "joint_speed" else math.inf
                own[name].append(min(values[number], top))
        base = [self.speed, self.acceleration, self.jerk]
        every = {"x": base, "y": base, "heading": [self.turn_speed, self.turn_acceleration, self.turn_jerk], **own}
        return np.array([every[name] for name in names]).reshape(-1, 3)


def compute_ramp(acceleration: float, jerk: float) -> float:
    """Return the shortest time to change the speed by one, with zero acceleration at both ends."""
    return 1.0 / acceleration + acceleration / jerk if acceleration**2 <= jerk else 2.0 / math.sqrt(jerk)


def compute_rest_to_rest(distance: float, speed: float, acceleration: float, jerk: float) -> float:
    """Return the shortest time from rest to rest over a distance, s."""
    ramp = compute_ramp(acceleration / speed, jerk / speed)
    if distance >= speed * ramp:
        return distance / speed + ramp
    if distance <= 2.0 * acceleration**3 / jerk**2:  # the limit of acceleration is not reached
        return 4.0 * (distance / (2.0 * jerk)) ** (1 / 3)
    lost = acceleration / jerk
    return lost + math.sqrt(lost**2 + 4.0 * distance / acceleration)


def compute_duration(states: Sequence[RoomState], limits: MotionLimits, robot: Robot, turn_step: float) -> float:
    """Return the shortest time to go through states one after another, s. The base rests where its direction changes.

    Each state is one primitive after the one before; `turn_step` is the angle of a turn, rad.
    """
    rates = limits.stack(("x", "heading", *robot.joint_names), robot).tolist()
    total, now, length = 0.0, (0, 0.0, 0.0), 0.0
    for before, after in zip(states, states[1:], strict=False):
        dx, dy = after.x - before.x, after.y - before.y
        away = math.hypot(dx, dy)
        joints = [i for i, (a, b) in enumerate(zip(before.joint_steps, after.joint_steps, strict=True)) if a != b]
        if away > 0.0:
            motion, amount = (0, round(dx / away, 9), round(dy / away, 9)), away
        elif joints:
            change = after.joint_steps[joints[0]] - before.joint_steps[joints[0]]
            motion, amount = (2 + joints[0], float(change), 0.0), robot.step
        elif after.heading_steps != before.heading_steps:
            turned = (after.heading_steps - before.heading_steps) * turn_step
            turned = math.remainder(turned, math.tau)
            motion, amount = (1, math.copysign(1.0, turned), 0.0), abs(turned)
        else:
            continue  # a blocked primitive, without any motion
        if motion != now and length:
            total += compute_rest_to_rest(length, *rates[now[0]])
            length = 0.0
        now, length = motion, length + amount
    return total + (compute_rest_to_rest(length, *rates[now[0]]) if length else 0.0)
