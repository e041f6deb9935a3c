"""Velocities as actions: their bounds, the motion that a step of time makes of them, and what the step is worth.

A robot with a gripper has one number more, and one that can use a second one.
They are levels, not velocities: whatever they ask for happens at the end of each step that asks for it.
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
"""Level beyond which the gripper grips; it releases below minus that, and what is ahead is used beyond it."""


@dataclasses.dataclass(frozen=True)
class Velocities:
    """Velocities of base and joints, held for a step of time.

    Raises:
        ConfigError: a number that is not finite and above 0.
    """

    time_step: float = 0.1  # s
    speed: float = 1.0  # largest speed of the base along each of its axes, m/s
    turn_speed: float = 1.5  # rad/s
    joint_speed: float = 1.0  # rad/s; a joint whose URDF allows less has that
    time_limit: float | None = None  # s; None for as many seconds as a room's horizon has primitives

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            is_number = isinstance(value, (int, float)) and not isinstance(value, bool) and 0.0 < value < math.inf
            if not is_number and (name != "time_limit" or value is not None):
                raise ConfigError(name, value, "a finite number above 0")

    def list_bounds(self, robot: RobotConfig) -> tuple[float, ...]:
        """Largest velocity forward, to the left where the base strafes, of the turn, and of each joint; then levels.

        The levels, each up to 1, are those of the gripper and of use, where the robot has them.
        """
        axes = 2 if robot.drive == "strafing" else 1
        joints = (min(self.joint_speed, top) for top in make_robot(robot).speeds)
        return (*[self.speed] * axes, self.turn_speed, *joints, *[1.0] * count_levels(robot))

    def count_steps(self, horizon: int) -> int:
        """Steps until the time is up, in a room of some horizon."""
        seconds = (self.time_limit or horizon) - 1e-9
        count = math.ceil(seconds / self.time_step)
        return count + (count * self.time_step < seconds)

    def make_glide(self, rules: Rules, state: RoomState, rates: tuple[float, ...]) -> Glide:
        """The motion of a step, along the heading in the middle of the turn, from velocities within their bounds."""
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
        """The outcome of a step, from that of its motion as a primitive: its share of -1, and the limit of time."""
        is_late = done.state.primitives >= self.count_steps(instance.horizon)
        return done._replace(reward=done.reward - self.compute_surplus(instance),
                             truncated=is_late and not done.terminated)

    def compute_surplus(self, instance: RoomInstance) -> float:
        """Reward of a primitive beyond that of a step, which is shorter."""
        return instance.reward.step * (1.0 - self.time_step)


def count_levels(robot: RobotConfig) -> int:
    """Numbers of an action that are levels: 0, 1 for a gripper, 2 for one that can use, too."""
    return max(0, len(robot.actions.gripper) - 1)


def find_grip(levels: Sequence[float]) -> int:
    """The primitive that levels ask for: 1 to grip, -1 to release, `USE` to use, 0 for none.

    A gripper that grips or releases does not use.
    """
    gripper, use = (*levels, 0.0, 0.0)[:2]
    if abs(gripper) > GRIPPER_LEVEL:
        return 1 if gripper > 0.0 else -1
    return USE if use > GRIPPER_LEVEL else 0


def list_levels(robot: RobotConfig, grip: int) -> tuple[float, ...]:
    """Levels that ask a robot for a primitive: 1 to grip, -1 to release, `USE` to use, 0 for none of them."""
    return (float(grip) if abs(grip) == 1 else 0.0, float(grip == USE))[: count_levels(robot)]
