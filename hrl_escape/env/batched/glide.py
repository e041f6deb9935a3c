"""A step of velocities in many rooms, as one pure function of tensors: `Kinematics.glide` with one more axis."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from hrl_escape.env.batched.noise import compute_noise
from hrl_escape.env.batched.poses import (
    TensorState,
    compute_angles,
    compute_heading,
    compute_rotation,
    make_joint_column,
)
from hrl_escape.env.batched.rules import TensorTransition, complete_motion, find_free_fraction, take_turn
from hrl_escape.env.batched.tables import Layout, Tables
from hrl_escape.env.kinematics import ROUNDING
from hrl_escape.env.tensor_geometry import store

__all__ = ["glide"]


def glide(layout: Layout, tables: Tables, state: TensorState, rates: Tensor) -> TensorTransition:
    """Move every room for one step of time. Pure.

    Args:
        layout: of the batch; its `velocities` say what the rates mean.
        tables: of the batch.
        state: of the rooms.
        rates: velocities, float64 (rooms, numbers), clipped to their bounds; what is no number is 0.
    """
    kind = layout.velocities
    assert kind is not None
    bounds = torch.tensor(kind.list_bounds(layout.robot), dtype=rates.dtype, device=rates.device)
    rates = torch.nan_to_num(rates, 0.0)
    change = (torch.minimum(torch.maximum(rates, -bounds), bounds) * kind.time_step).unbind(1)
    forward, turn, joints = change[0], change[-1 - layout.robot.joints], change[len(change) - layout.robot.joints :]
    cos, sin = compute_rotation(layout, tables, state)
    middle = compute_heading(layout, tables, state) + turn / 2.0
    cos, sin = torch.where(turn == 0.0, cos, torch.cos(middle)), torch.where(turn == 0.0, sin, torch.sin(middle))
    left = change[1] if layout.robot.drive == "strafing" else torch.zeros_like(forward)
    dx, dy = forward * cos - left * sin, forward * sin + left * cos
    scale = None
    if layout.is_random:
        normal, uniform = compute_noise(state.noise_key, state.primitives)
        scale = torch.where(uniform < layout.dynamics.slip, 0.0, 1.0 + layout.dynamics.noise * normal)
        dx, dy, turn = scale * dx, scale * dy, scale * turn
    dx, dy = store(dx), store(dy)
    free = find_free_fraction(layout, tables, state, dx, dy)
    if layout.dynamics.blocked == "stay":
        free = (free >= 1.0).to(torch.float64)
    moved = state._replace(x=state.x + free * dx, y=state.y + free * dy)
    moved = take_turn(layout, tables, moved, _turn(layout, moved, turn), turn)
    moved = _bend(layout, moved, joints, scale) if joints else moved
    return complete_motion(layout, tables, state, moved, torch.zeros_like(state.touching))


def _turn(layout: Layout, state: TensorState, turn: Tensor) -> TensorState:
    """States turned by an angle in rad, float64 (rooms,)."""
    unit = math.tau / layout.headings
    heading = state.heading_steps.to(torch.float64) * unit + state.heading_offset + turn
    turns = torch.round(heading / unit)
    offset = heading - turns * unit
    offset = torch.where(offset.abs() > ROUNDING, offset, 0.0)
    steps = torch.remainder(turns.to(torch.int32), layout.headings)
    is_still = turn == 0.0
    return state._replace(heading_steps=torch.where(is_still, state.heading_steps, steps),
                          heading_offset=torch.where(is_still, state.heading_offset, offset))


def _bend(layout: Layout, state: TensorState, change: tuple[Tensor, ...], scale: Tensor | None) -> TensorState:
    """States whose joints have moved by angles in rad, float64 (rooms,) each, as far as their limits."""
    arm, by = layout.arm, torch.stack(change)
    is_still = (by == 0.0).all(0)
    low, high = (make_joint_column(ends, by) for ends in zip(*arm.limits, strict=True))
    angles = compute_angles(layout, state) + (by if scale is None else scale * by)
    angles = torch.minimum(torch.maximum(angles, low), high)
    home, lowest, highest = (make_joint_column(each, by) for each in (arm.home, arm.step_low, arm.step_high))
    steps = torch.round((angles - home) / arm.step)
    steps = torch.minimum(torch.maximum(steps, lowest), highest)
    offsets = angles - (home + steps * arm.step)
    offsets = torch.where((offsets.abs() > ROUNDING).any(0), offsets, 0.0)
    return state._replace(joint_steps=torch.where(is_still, state.joint_steps, steps.to(torch.int32)),
                          joint_offsets=torch.where(is_still, state.joint_offsets, offsets))
