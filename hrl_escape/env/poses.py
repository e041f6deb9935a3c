"""The state of one room, and values derived from its pose: heading, joint angles, hand.

`batched/poses.py` is the version for many rooms. Headings and joints are counted in whole steps: equal steps give equal
floats, independent of the path to them. Lengths in metres, angles in radians.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Sequence
from functools import partial
from typing import Any, NamedTuple

from hrl_escape.env.config import RobotConfig
from hrl_escape.env.memo import Memo
from hrl_escape.env.robot import Robot, make_robot


class RoomState(NamedTuple):
    """Everything that determines the future of an episode; hashable and comparable.

    Attributes:
        x: x of the body's axis, m.
        y: y of the body's axis, m.
        heading_steps: whole turn steps, from 0 to 360 / turn_step_deg - 1.
        heading_offset: heading beyond whole steps, rad (noise, physics, start).
        joint_steps: whole joint steps from home.
        joint_offsets: joint angles beyond whole steps, rad; empty if all are zero.
        puzzle: state of the puzzle.
        touching: bit i is set while target i is touched.
        primitives: number of primitives since the episode began.
        noise_key: 64-bit key of the episode's noise.
        z: height of the base above the floor, m (physics).
        pitch: rad (physics).
        roll: rad (physics).
        physics: saved state of the engine (physics), otherwise None.
    """

    x: float
    y: float
    heading_steps: int
    heading_offset: float
    joint_steps: tuple[int, ...]
    joint_offsets: tuple[float, ...]
    puzzle: Hashable
    touching: int
    primitives: int
    noise_key: int
    z: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    physics: Any = None

    @property
    def pose(self) -> tuple[float, float, int, float, tuple[int, ...], tuple[float, ...]]:
        """Pose of base and arm: x, y, heading and joints, each with its offset."""
        return self.x, self.y, self.heading_steps, self.heading_offset, self.joint_steps, self.joint_offsets


def list_touched(bits: int) -> tuple[int, ...]:
    """Return the ascending indices of the set bits, as in `RoomState.touching`."""
    return tuple(i for i in range(bits.bit_length()) if bits >> i & 1)


def get_planar_pose(numbers: Sequence[float]) -> tuple[float, float, float]:
    """Return x, y and yaw (m, rad) of a rigid body from its position and quaternion (x, y, z, w)."""
    x, y, _, qx, qy, qz, qw = numbers[:7]
    return x, y, math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))


def _compute_hand(robot: Robot, joint_steps: tuple[int, ...], joint_offsets: tuple[float, ...] = ()
                  ) -> tuple[float, float, float]:
    return tuple(robot.compute_hand(robot.compute_angles(joint_steps, joint_offsets)).tolist())


class RobotPoses:
    """Headings, joint angles and hand positions of one robot, cached for whole steps.

    Attributes:
        robot: the robot.
        headings: number of turn steps in a full turn.
        turn_step: angle of one turn step, rad.
        symmetry: number of evenly spaced headings with the same outline and the same moves of the base.
        rotations: cosine and sine of each heading of whole turn steps.
    """

    def __init__(self, robot: RobotConfig) -> None:
        self.robot = make_robot(robot)
        self.headings = round(360 / robot.turn_step_deg)
        self.turn_step = math.tau / self.headings
        self.symmetry = robot.symmetry
        self._angles = tuple(self.compute_heading(n, 0.0, self.turn_step) for n in range(self.headings))
        self.rotations = tuple((round(math.cos(a), 15), round(math.sin(a), 15)) for a in self._angles)
        self._hands = Memo(partial(_compute_hand, self.robot), 200_000)
        self._arms = Memo(self.robot.compute_angles, 200_000)

    @staticmethod
    def compute_heading(steps: int, offset: float, turn_step: float) -> float:
        """Return the heading in [-pi, pi), rad. Equal steps give equal floats."""
        return (steps * turn_step + offset + math.pi) % math.tau - math.pi

    def split_heading(self, heading: float) -> tuple[int, float]:
        """Split a heading, rad, into whole turn steps and the remaining angle, rad."""
        turns = round(heading / self.turn_step)
        return turns % self.headings, heading - turns * self.turn_step

    def split_angles(self, angles: Iterable[float]) -> tuple[tuple[int, ...], tuple[float, ...]]:
        """Split joint angles, rad, into whole joint steps from home and the remaining angles, rad."""
        robot, steps, offsets = self.robot, [], []
        for angle, home, low, high in zip(angles, robot.home, robot.step_low, robot.step_high, strict=True):
            step = min(max(round((angle - home) / robot.step), low), high)
            steps.append(step)
            offsets.append(angle - (home + step * robot.step))
        return tuple(steps), tuple(offsets)

    def get_heading(self, state: RoomState) -> float:
        """Return the heading of the base in [-pi, pi), rad."""
        if state.heading_offset == 0.0:
            return self._angles[state.heading_steps]
        return self.compute_heading(state.heading_steps, state.heading_offset, self.turn_step)

    def get_rotation(self, steps: int, offset: float) -> tuple[float, float]:
        """Return cosine and sine of a heading; exact at quarter turns."""
        if offset == 0.0:
            return self.rotations[steps]
        angle = self.compute_heading(steps, offset, self.turn_step)
        return math.cos(angle), math.sin(angle)

    def get_angles(self, state: RoomState) -> tuple[float, ...]:
        """Return the joint angles, rad; whole-step configurations are cached."""
        if state.joint_offsets:
            return self.robot.compute_angles(state.joint_steps, state.joint_offsets)
        return self._arms[state.joint_steps]

    def get_hand_in_base(self, joint_steps: tuple[int, ...],
                         joint_offsets: tuple[float, ...] = ()) -> tuple[float, float, float]:
        """Return the hand position in the base frame, m; whole-step configurations are cached."""
        if joint_offsets:
            return _compute_hand(self.robot, joint_steps, joint_offsets)
        return self._hands[joint_steps]

    def get_hand(self, state: RoomState) -> tuple[float, float, float]:
        """Return the hand position in the room frame, m."""
        hand_x, hand_y, hand_z = self.get_hand_in_base(state.joint_steps, state.joint_offsets)
        cos, sin = self.get_rotation(state.heading_steps, state.heading_offset)
        return state.x + cos * hand_x - sin * hand_y, state.y + sin * hand_x + cos * hand_y, state.z + hand_z
