"""Limits of speed and acceleration, and the shortest time in which a plan's motions keep them.

A motion from rest to rest over a distance d takes d / v + v / a, or 2 sqrt(d / a) if the top speed v is
not reached: a trapezoid or a triangle of speed over time.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import ConfigError


@dataclasses.dataclass(frozen=True)
class MotionLimits:
    """Limits of the base and of every joint.

    Attributes:
        speed: of the base's axis, m/s.
        acceleration: of the base's axis, m/s^2.
        turn_speed: of the base, rad/s.
        turn_acceleration: of the base, rad/s^2.
        joint_speed: of each joint, rad/s.
        joint_acceleration: of each joint, rad/s^2.
    """

    speed: float = 1.0
    acceleration: float = 1.0
    turn_speed: float = 1.5
    turn_acceleration: float = 3.0
    joint_speed: float = 1.0
    joint_acceleration: float = 2.0

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < value < math.inf:
                raise ConfigError(f"limits.{field.name}", value, "a finite number above 0")


def compute_rest_to_rest(distance: float, speed: float, acceleration: float) -> float:
    """Shortest time from rest to rest over a distance, s."""
    if distance * acceleration >= speed**2:
        return distance / speed + speed / acceleration
    return 2.0 * math.sqrt(distance / acceleration)


def compute_duration(states: Sequence[RoomState], limits: MotionLimits, turn_step: float, joint_step: float) -> float:
    """Shortest time to go through states one after another, s; the base rests wherever its direction changes.

    Args:
        states: states of a plan, each one primitive after the one before.
        limits: of speed and acceleration.
        turn_step: angle of a turn, rad.
        joint_step: angle of a joint step, rad.
    """
    pairs = {"move": (limits.speed, limits.acceleration), "turn": (limits.turn_speed, limits.turn_acceleration),
             "joint": (limits.joint_speed, limits.joint_acceleration)}
    total, now, length = 0.0, ("", 0, 0.0, 0.0), 0.0
    for before, after in zip(states, states[1:], strict=False):
        dx, dy = after.x - before.x, after.y - before.y
        away = math.hypot(dx, dy)
        joints = [i for i, (a, b) in enumerate(zip(before.joint_steps, after.joint_steps, strict=True)) if a != b]
        if away > 0.0:
            motion, amount = ("move", 0, round(dx / away, 9), round(dy / away, 9)), away
        elif joints:
            change = after.joint_steps[joints[0]] - before.joint_steps[joints[0]]
            motion, amount = ("joint", joints[0], float(change), 0.0), joint_step
        elif after.heading_steps != before.heading_steps:
            turned = (after.heading_steps - before.heading_steps) * turn_step
            turned = math.remainder(turned, math.tau)
            motion, amount = ("turn", 0, math.copysign(1.0, turned), 0.0), abs(turned)
        else:
            continue  # a blocked primitive, without any motion
        if motion != now and length:
            total += compute_rest_to_rest(length, *pairs[now[0]])
            length = 0.0
        now, length = motion, length + amount
    return total + (compute_rest_to_rest(length, *pairs[now[0]]) if length else 0.0)
