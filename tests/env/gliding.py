"""Plans of primitives played as velocities."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.kinematics import Rules
from hrl_escape.env.velocities import count_levels, list_levels


def list_velocities(rules: Rules, action: int, steps: int, time_step: float) -> Iterator[NDArray[np.float64]]:
    """Velocities, step by step, of a primitive that takes some steps; the hand acts in the first of them."""
    primitive, robot = rules.actions.primitives[action], rules.instance.robot
    sides = [primitive.left] if robot.drive == "strafing" else []
    joints = np.zeros(robot.joints)
    if primitive.joint >= 0:
        joints[primitive.joint] = primitive.joint_change * rules.robot.step
    rates = np.array([primitive.forward, *sides, primitive.turn * rules.turn_step, *joints]) / (steps * time_step)
    for step in range(steps):
        levels = list_levels(robot, 0 if step else primitive.grip)
        assert len(levels) == count_levels(robot)
        yield np.array([*rates, *levels])
