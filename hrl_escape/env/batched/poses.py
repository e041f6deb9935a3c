"""The state of many rooms as tensors, and values derived from it: headings, arm, touched targets.

`TensorState` is `RoomState` with an additional axis, rooms, last in every field. Poses
are double precision, headings and joints whole steps, as in the scalar rules. Of the robot's chain of joints, zeros and
ones cost nothing, so that the hand of a planar arm compiles to a few products a joint.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import torch
from torch import Tensor

from hrl_escape.env.bases import TensorBase
from hrl_escape.env.batched.tables import Layout, Tables, pick
from hrl_escape.env.robot import Robot
from hrl_escape.env.tensor_geometry import Shapes, compute_distance, store


class TensorState(NamedTuple):
    """Everything that decides the future of each room; all fields are (rooms,) unless said."""

    x: Tensor  # position of the body's axis, m, float64
    y: Tensor  # position of the body's axis, m, float64
    heading_steps: Tensor  # whole turn steps, int32
    heading_offset: Tensor  # heading beyond whole steps, rad, float64
    joint_steps: Tensor  # whole joint steps from home, int32 (joints, rooms)
    joint_offsets: Tensor  # joint angles beyond whole steps, rad, float64 (joints, rooms)
    puzzle: Tensor  # the puzzle's bits, int64
    touching: Tensor  # bit i is set while target i is touched, int64
    primitives: Tensor  # primitives since the episode began, int32
    noise_key: Tensor  # key of the episode's noise, int64
    instance: Tensor  # index of the room's instance, int64
    seed: Tensor  # key of the room's own random numbers, int64
    episode: Tensor  # number of the episode since seeding, int32
    has_ended: Tensor  # 1 if the episode is over, else 0, int32


def compute_heading(layout: Layout, tables: Tables, state: TensorState) -> Tensor:
    """Heading of the base in rad, within [-pi, pi), float64 (rooms,)."""
    heading = tables.headings[0][state.heading_steps]
    if not layout.has_offsets:
        return heading
    free = torch.remainder(heading + state.heading_offset + math.pi, math.tau) - math.pi
    return torch.where(state.heading_offset == 0.0, heading, free)


def compute_rotation(layout: Layout, tables: Tables, state: TensorState) -> tuple[Tensor, Tensor]:
    """Cosine and sine of the heading, float64 (rooms,) each; exact at quarter turns."""
    cos, sin = tables.headings[1][state.heading_steps], tables.headings[2][state.heading_steps]
    if not layout.has_offsets:
        return cos, sin
    more_cos, more_sin = torch.cos(state.heading_offset), torch.sin(state.heading_offset)
    return cos * more_cos - sin * more_sin, sin * more_cos + cos * more_sin


def make_joint_column(values: Sequence[float], like: Tensor) -> Tensor:
    """Numbers, one a joint, for all rooms: (joints, 1), of the dtype and on the device of another tensor."""
    return torch.tensor(values, dtype=like.dtype, device=like.device).unsqueeze(1)


def compute_angles(layout: Layout, state: TensorState) -> Tensor:
    """Joint angles in rad, float64 (joints, rooms)."""
    arm = layout.arm
    angles = make_joint_column(arm.home, state.x) + state.joint_steps.to(torch.float64) * arm.step
    return angles + state.joint_offsets if layout.has_joint_offsets else angles


def place_base(layout: Layout, tables: Tables, state: TensorState, margin: float) -> TensorBase:
    """Place the bases at their poses, grown on all sides by a margin, m."""
    return layout.robot.base.grow(margin).place(state.x, state.y, lambda: compute_rotation(layout, tables, state))


def compute_touching(layout: Layout, tables: Tables, state: TensorState) -> Tensor:
    """Bits of the targets that the presser touches, int64 (rooms,)."""
    if not layout.targets:
        return torch.zeros_like(state.touching)
    targets: Shapes = pick(layout, tables.round_targets, state.instance)
    robot, dynamics = layout.robot, layout.dynamics
    if dynamics.press_with == "hand":
        hand_x, hand_y, hand_z = compute_hand(layout.arm, compute_angles(layout, state).to(torch.float32))
        cos, sin = compute_rotation(layout, tables, state)
        x, y = store(state.x + cos * hand_x - sin * hand_y), store(state.y + sin * hand_x + cos * hand_y)
        away = compute_distance(x, y, targets)
        height = pick(layout, tables.target_z, state.instance)
        half_height = pick(layout, tables.target_half_z, state.instance)
        hand_z = store(hand_z) if isinstance(hand_z, Tensor) else hand_z
        above = ((hand_z - height).abs() - half_height).clamp(min=0.0)
        touched = torch.sqrt(away * away + above * above) <= robot.hand_radius + dynamics.press_margin
    else:
        reach = pick(layout, tables.target_reach, state.instance)
        touched = compute_distance(state.x, state.y, targets) <= reach
        if not robot.base.turns_anywhere:
            away = place_base(layout, tables, state, 0.0).compute_distance(pick(layout, tables.targets, state.instance))
            is_near = away <= pick(layout, tables.target_margin, state.instance)
            touched = touched & (is_near | ~pick(layout, tables.is_panel, state.instance))
    word = torch.int32 if layout.targets < 32 else torch.int64
    places = torch.arange(layout.targets, dtype=word, device=state.x.device).unsqueeze(1)
    return store(touched.to(word) << places).sum(0, dtype=word).to(torch.int64)


# --- hand positions ------------------------------------------------------------------------


Number: TypeAlias = Tensor | float


@dataclasses.dataclass
class _Folded:
    """A number whose sums with 0 and products with 0 and 1 cost nothing, as an entry of a matrix."""

    value: Number

    def __add__(self, other: _Folded) -> _Folded:
        if self._is(0.0):
            return other
        return self if other._is(0.0) else _Folded(self.value + other.value)

    def __mul__(self, other: _Folded) -> _Folded:
        if self._is(0.0) or other._is(1.0):
            return self
        return other if self._is(1.0) or other._is(0.0) else _Folded(self.value * other.value)

    def _is(self, number: float) -> bool:
        return isinstance(self.value, float) and self.value == number


_fold: Any = np.frompyfunc(_Folded, 1, 1)


def compute_hand(robot: Robot, angles: Tensor) -> list[Number]:
    """Hand position in the base frame at joint angles (joints, rooms), rad.

    Returns x, y and z in metres, each (rooms,), or one number if no joint changes it.
    """
    cosines, sines = torch.cos(angles), torch.sin(angles)
    position, rotation = _fold(np.zeros(3)), _fold(np.eye(3))
    for joint in robot.chain:
        origin = _fold(joint.origin[:3].round(15))  # entries that are 0 or 1 up to rounding cost nothing
        position, rotation = position + rotation @ origin[:, 3], rotation @ origin[:, :3]
        if joint.kind == "fixed":
            continue
        if joint.name in robot.joint_names:
            number = robot.joint_names.index(joint.name)
            value, cos, sin = angles[number], cosines[number], sines[number]
        elif joint.name in robot.mimics:
            number, factor, offset = robot.mimics[joint.name]
            value = factor * angles[number] + offset
            cos, sin = torch.cos(value), torch.sin(value)
        else:
            value = robot.rest[joint.name]
            cos, sin = math.cos(value), math.sin(value)
        if joint.kind == "prismatic":
            position = position + rotation @ (_fold(joint.axis) * _Folded(value))
        else:  # Rodrigues
            (x, y, z), outer = joint.direction, np.outer(joint.axis, joint.axis)
            cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            rotation = rotation @ (_fold(outer) + _fold(np.eye(3) - outer) * _Folded(cos) + _fold(cross) * _Folded(sin))
    return [entry.value for entry in position]
