"""Poses of everything that moves in a room, and interpolation between them.

`make_pose` reads a state; `blend` interpolates. Pure functions; nothing here draws.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from hrl_escape.env.kinematics import RoomState, Rules
from hrl_escape.planning.props import get_prop_poses

PropPose = tuple[float, ...]


class RoomPose(NamedTuple):
    """Placement of everything that moves."""

    x: float  # x of the body's axis, m
    y: float  # y of the body's axis, m
    z: float  # height of the base above the floor, m
    heading: float  # rad
    pitch: float  # rad
    roll: float  # rad
    angles: tuple[float, ...]  # angles of the arm's joints, rad
    door: float  # angle of the leaf about its hinge, rad
    props: tuple[PropPose, ...]  # position x y z and quaternion x y z w of each prop


def make_pose(rules: Rules, state: RoomState) -> RoomPose:
    """Pose of a state; without physics the door stands open as soon as the puzzle is solved."""
    instance = rules.instance
    if state.physics is not None:
        door = state.physics.door[0] if state.physics.door else 0.0
        props = tuple(tuple(prop[:7]) for prop in state.physics.props)
    else:
        solved = instance.door is not None and instance.puzzle.is_solved(state.puzzle)
        door = math.pi / 2 * instance.door_swing if solved else 0.0
        poses = get_prop_poses(state, instance)
        props = tuple((x, y, placed.prop.height / 2, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
                      for (x, y, yaw), placed in zip(poses, instance.props, strict=True))
    return RoomPose(state.x, state.y, state.z, rules.get_heading(state), state.pitch, state.roll,
                    tuple(rules.get_angles(state)), door, props)


def blend(a: RoomPose, b: RoomPose, share: float) -> RoomPose:
    """Interpolate from `a` (share 0) to `b` (share 1); headings turn the short way round."""

    def mix(one: tuple[float, ...], other: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(u + share * (v - u) for u, v in zip(one, other, strict=True))

    turn = (b.heading - a.heading + math.pi) % math.tau - math.pi
    x, y, z, pitch, roll, door = mix((a.x, a.y, a.z, a.pitch, a.roll, a.door), (b.x, b.y, b.z, b.pitch, b.roll, b.door))
    props = tuple(_mix_prop(one, mix(one, other), other) for one, other in zip(a.props, b.props, strict=True))
    return RoomPose(x, y, z, a.heading + share * turn, pitch, roll, mix(a.angles, b.angles), door, props)


def _mix_prop(one: PropPose, mixed: PropPose, other: PropPose) -> PropPose:
    """Normalise the quaternion of a mixed pose; a quaternion and its negative are the same rotation."""
    if sum(u * v for u, v in zip(one[3:], other[3:], strict=True)) < 0.0:
        return other
    length = math.hypot(*mixed[3:])
    return (*mixed[:3], *(v / length for v in mixed[3:]))
