"""Hand position in tensors: the robot's chain of joints unrolled with its constants folded in.

Forward kinematics as in `robot.Robot.compute_hand`; zeros and ones in the chain cost
nothing, so that a planar arm compiles to a few products a joint.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import torch
from torch import Tensor

from hrl_escape.env.robot import Robot

Number: TypeAlias = Tensor | float
Vector: TypeAlias = list[Number]
Matrix: TypeAlias = list[list[Number]]

_AXES = range(3)


class Link(NamedTuple):
    """One joint of the chain from the base to the hand, in plain numbers."""

    offset: tuple[float, ...]  # origin in the parent link, m
    rotation: tuple[tuple[float, ...], ...]  # orientation in the parent link, rows of a matrix
    axis: tuple[float, ...]  # unit axis; empty for a fixed joint
    slides: bool  # True for a prismatic joint
    number: int  # index among the joints that primitives move, or -1
    rest: float  # value that it keeps if no primitive moves it, rad or m


class Arm(NamedTuple):
    """Constants of a robot's arm that kernels are compiled with."""

    home: tuple[float, ...]  # joint angles at the start of an episode, rad
    step: float  # angle of one joint primitive, rad
    step_low: tuple[int, ...]  # fewest joint steps from home
    step_high: tuple[int, ...]  # most joint steps from home
    limits: tuple[tuple[float, float], ...]  # (low, high) of each joint, rad
    links: tuple[Link, ...]  # the chain to the hand


def make_arm(robot: Robot) -> Arm:
    """Extract from a robot the chain of joints that moves its hand."""
    links = []
    for joint in robot.chain:
        origin = joint.origin.round(15).tolist()  # entries that are 0 or 1 up to rounding cost nothing
        used = joint.name in robot.joint_names
        links.append(Link(
            offset=tuple(row[3] for row in origin[:3]),
            rotation=tuple(tuple(row[:3]) for row in origin[:3]),
            axis=() if joint.kind == "fixed" else tuple(joint.axis.tolist()),
            slides=joint.kind == "prismatic",
            number=robot.joint_names.index(joint.name) if used else -1,
            rest=robot.rest.get(joint.name, 0.0),
        ))
    return Arm(robot.home, robot.step, robot.step_low, robot.step_high, robot.limits, tuple(links))


def compute_hand(arm: Arm, angles: Tensor) -> Vector:
    """Hand position in the base frame.

    Args:
        arm: the arm.
        angles: joint angles in rad, shape (joints, rooms).

    Returns:
        x, y and z in metres, each (rooms,), or one number if no joint changes it.
    """
    cosines, sines = torch.cos(angles), torch.sin(angles)
    position: Vector = [0.0, 0.0, 0.0]
    rotation: Matrix = [[float(i == j) for j in _AXES] for i in _AXES]
    for link in arm.links:
        position = _move(position, rotation, list(link.offset))
        rotation = _turn(rotation, [list(row) for row in link.rotation])
        if not link.axis:
            continue
        value: Number = link.rest
        cos: Number = math.cos(link.rest)
        sin: Number = math.sin(link.rest)
        if link.number >= 0:
            value, cos, sin = angles[link.number], cosines[link.number], sines[link.number]
        if link.slides:
            position = _move(position, rotation, [_times(a, value) for a in link.axis])
        else:
            rotation = _turn(rotation, _rotate_about(link.axis, cos, sin))
    return position


def _rotate_about(axis: tuple[float, ...], cos: Number, sin: Number) -> Matrix:
    """Rotation about a unit axis (Rodrigues)."""
    x, y, z = axis
    cross = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    return [[_plus(_plus(axis[i] * axis[j], _times((i == j) - axis[i] * axis[j], cos)), _times(cross[i][j], sin))
             for j in _AXES] for i in _AXES]


def _move(position: Vector, rotation: Matrix, by: Vector) -> Vector:
    return [_plus(position[i], _dot(rotation[i], by)) for i in _AXES]


def _turn(rotation: Matrix, by: Matrix) -> Matrix:
    return [[_dot(rotation[i], [by[k][j] for k in _AXES]) for j in _AXES] for i in _AXES]


def _dot(left: Vector, right: Vector) -> Number:
    total: Number = 0.0
    for a, b in zip(left, right, strict=True):
        total = _plus(total, _times(a, b))
    return total


def _times(a: Number, b: Number) -> Number:
    for one, other in ((a, b), (b, a)):
        if isinstance(one, (int, float)):
            if one == 0.0:
                return 0.0
            if one == 1.0:
                return other
    return a * b


def _plus(a: Number, b: Number) -> Number:
    for one, other in ((a, b), (b, a)):
        if isinstance(one, (int, float)) and one == 0.0:
            return other
    return a + b
