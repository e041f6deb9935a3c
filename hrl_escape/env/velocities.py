"""Velocities as actions: their bounds, the motion of a time step, and its reward.

Robots with a gripper have one more number, robots that can use things a second one. These are levels, not velocities:
the requested act happens at the end of each step.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from hrl_escape.env.kinematics import Glide, RoomState, Rules, Transition
from hrl_escape.env.puzzles.contacts import USE
from hrl_escape.env.robot import make_robot
from hrl_escape.errors import ConfigError

if TYPE_CHECKING:
    from hrl_escape.env.config import RobotConfig
    from hrl_escape.env.instance import RoomInstance

__all__ = ["GRIPPER_LEVEL", "Velocities", "count_levels", "find_grip", "list_levels"]

GRIPPER_LEVEL = 0.5
"""Threshold of levels: above it the gripper grips or the robot uses, below its negative the gripper releases."""


@dataclasses.dataclass(frozen=True)
class Velocities:
    """Bounds of the velocities of base and joints, constant over a time step.

    Raises:
        ConfigError: a number is not finite and positive.
    """

    time_step: float = 0.1  # s
    speed: float = 1.0  # largest speed of the base along each of its axes, m/s
    turn_speed: float = 1.5  # largest turn speed, rad/s
    joint_speed: float = 1.0  # largest joint speed, rad/s; the URDF's limit applies if lower
    time_limit: float | None = None  # s, or None for as many seconds as the horizon of the room has primitives

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            is_number = isinstance(value, (int, float)) and not isinstance(value, bool) and 0.0 < value < math.inf
            if not is_number and (name != "time_limit" or value is not None):
                raise ConfigError(name, value, "a finite number above 0")

    def list_bounds(self, robot: RobotConfig) -> tuple[float, ...]:
        """Return the bounds of an action: velocity forward, to the left (if the base strafes), turn, joints, levels.

        The levels of the gripper and of use, if the robot has them, have the bound 1.
        """
        axes = 2 if robot.drive == "strafing" else 1
        joints = (min(self.joint_speed, top) for top in make_robot(robot).speeds)
        return (*[self.speed] * axes, self.turn_speed, *joints, *[1.0] * count_levels(robot))

    def count_steps(self, horizon: int) -> int:
        """Return the number of steps in the time limit, for a room with a given horizon."""
        seconds = (self.time_limit or horizon) - 1e-9
        count = math.ceil(seconds / self.time_step)
        return count + (count * self.time_step < seconds)

    def make_glide(self, rules: Rules, state: RoomState, rates: tuple[float, ...]) -> Glide:
        """Return the motion of a step from velocities within their bounds, along the mean heading of the turn."""
        robot = rules.instance.robot
        count = len(rates) - count_levels(robot)
        forward, *others = (rate * self.time_step for rate in rates[:count])
        left = others.pop(0) if robot.drive == "strafing" else 0.0
        turn, *joints = others
        cos, sin = rules.get_rotation(state.heading_steps, state.heading_offset)
        if turn:
            middle = rules.get_heading(state) + turn / 2.0
            cos, sin = math.cos(middle), math.sin(middle)
        return Glide(forward * cos - left * sin, forward * sin + left * cos, turn, tuple(joints), self.time_step,
                     find_grip(rates[count:]))

    def judge(self, done: Transition, instance: RoomInstance) -> Transition:
        """Return the outcome of a step from its motion judged as a primitive: scale the cost, apply the time limit."""
        is_late = done.state.primitives >= self.count_steps(instance.horizon)
        return done._replace(reward=done.reward - self.compute_surplus(instance),
                             truncated=is_late and not done.terminated)

    def compute_surplus(self, instance: RoomInstance) -> float:
        """Return the difference between the reward of a primitive and of a step, which is shorter."""
        return instance.reward.step * (1.0 - self.time_step)


def count_levels(robot: RobotConfig) -> int:
    """Return how many numbers of an action are levels: 0, 1 with a gripper, 2 if the robot can also use things."""
    return max(0, len(robot.actions.gripper) - 1)


def find_grip(levels: Sequence[float]) -> int:
    """Return the act that levels request: 1 to grip, -1 to release, `USE` to use, 0 for none.

    Gripping and releasing take precedence over using.
    """
    gripper, use = (*levels, 0.0, 0.0)[:2]
    if abs(gripper) > GRIPPER_LEVEL:
        return 1 if gripper > 0.0 else -1
    return USE if use > GRIPPER_LEVEL else 0


def list_levels(robot: RobotConfig, grip: int) -> tuple[float, ...]:
    """Return the levels that request an act: 1 to grip, -1 to release, `USE` to use, 0 for none."""
    return (float(grip) if abs(grip) == 1 else 0.0, float(grip == USE))[: count_levels(robot)]
