"""Hand position in tensors: the robot's chain of joints unrolled with its constants folded in.

Forward kinematics as in `robot.Robot.compute_hand`; zeros and ones in the chain cost
nothing, so that a planar arm compiles to a few products a joint.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import torch
from torch import Tensor

from hrl_escape.env.robot import Robot

Number: TypeAlias = Tensor | float
Vector: TypeAlias = list[Number]
Matrix: TypeAlias = list[list[Number]]

_AXES = range(3)


def compute_hand(robot: Robot, angles: Tensor) -> Vector:
    """Hand position in the base frame at joint angles (joints, rooms), rad.

    Returns x, y and z in metres, each (rooms,), or one number if no joint changes it.
    """
    cosines, sines = torch.cos(angles), torch.sin(angles)
    position: Vector = [0.0, 0.0, 0.0]
    rotation: Matrix = [[float(i == j) for j in _AXES] for i in _AXES]
    for joint in robot.chain:
        origin = joint.origin.round(15).tolist()[:3]  # entries that are 0 or 1 up to rounding cost nothing
        position = _move(position, rotation, [row[3] for row in origin])
        rotation = _turn(rotation, [row[:3] for row in origin])
        if joint.kind == "fixed":
            continue
        if joint.name in robot.joint_names:
            number = robot.joint_names.index(joint.name)
            value, cos, sin = angles[number], cosines[number], sines[number]
        else:
            value = robot.rest[joint.name]
            cos, sin = math.cos(value), math.sin(value)
        if joint.kind == "prismatic":
            position = _move(position, rotation, [_times(a, value) for a in joint.direction])
        else:
            rotation = _turn(rotation, _rotate_about(joint.direction, cos, sin))
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
