"""Cost-to-go of presses by hand in a batch: remaining primitives of base and arm, over a small library of postures.

From a place where the hand can touch the target in some posture, exactly the joint steps to it are left. From elsewhere
they are added to the way of the base, by the field of the best of a few candidates. `PostureChooser` (`env.py`) weighs
the dozens that a target has only where a press begins or did not get nearer. Tensors have rooms last.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from hrl_escape.env.batched.poses import TensorState, compute_angles, compute_hand, compute_rotation
from hrl_escape.env.batched.tables import Layout, Tables, map_tensors, pick_column
from hrl_escape.env.tensor_geometry import Shapes, store, wrap
from hrl_escape.options.batched.cost_to_go import (
    FAR,
    OTHER_PRESS_COST,
    CostFields,
    classify_headings,
    interpolate_cost,
    locate,
)
from hrl_escape.options.batched.successors import find_touched_by_hand, rotate
from hrl_escape.options.batched.value_iteration import UNREACHABLE

CHOSEN = 4
"""Number of candidate postures that a hand keeps on its way to a target."""
_FEW = 8  # targets
_SKIN = 1e-4  # margin of a predicted touch, m


class Reach(NamedTuple):
    """Postures of the arms of a batch that touch the rooms' present targets; (postures, rooms) unless stated."""

    target: Tensor  # the targets, int64 (rooms,)
    column: Tensor  # instances of the rooms in tables, int64 (rooms,)
    steps: Tensor  # joint steps from home, int32 (joints, postures, rooms)
    away: Tensor  # joint steps from the present posture, float32
    ahead: Tensor  # the hand in the base frame, m, float32
    left: Tensor  # likewise
    square: Tensor  # square of the largest distance over the floor where it touches, m^2, float32; negative if never
    chosen: Tensor  # joint steps to the postures that were chosen, float32 (chosen, rooms)
    shifts: Tensor  # place of the base relative to the one that the field of each is for, m, float32 (2, chosen, rooms)
    fields: Tensor  # number of this field, int64 (chosen, rooms)


def find_reach(layout: Layout, tables: Tables, fields: CostFields, state: TensorState, goal: Tensor,
               postures: Tensor) -> Reach:
    """Look up the postures that touch every room's target, int64 (rooms,), and those chosen, int64 (chosen, rooms)."""
    target = goal.clamp(max=layout.targets - 1)
    column = pick_column(layout, state.instance)
    steps, hands = (_read(table, target, column) for table in (fields.postures.steps, fields.postures.hands))
    away = (steps - state.joint_steps.unsqueeze(1)).abs().sum(0).to(torch.float32)
    shifts, numbers = (table[..., postures, target, column] for table in fields.postures[2:])
    if layout.dynamics.noise:
        drift = _measure_drift(layout, state)
        hands, shifts = hands + drift.unsqueeze(1), shifts + drift[:2].unsqueeze(1)
    beyond = (hands[2] - tables.target_z[target, column]).abs() - tables.target_half_z[target, column]
    limit = layout.robot.hand_radius + layout.dynamics.press_margin - _SKIN
    square = torch.where(away < FAR / 2, limit**2 - beyond.clamp(min=0.0) ** 2, -1.0)
    reach = Reach(target, column, steps, away, hands[0], hands[1], square.to(torch.float32), away.gather(0, postures),
                  shifts, numbers)
    return map_tensors(store, reach)


def _read(table: Tensor, target: Tensor, column: Tensor) -> Tensor:
    """Columns of the rooms' targets in a table (..., targets, instances); (..., rooms).

    Chosen one target after the other where all rooms share a table of few: vectors choose faster than they look up.
    """
    if table.shape[-1] > 1 or table.shape[-2] > _FEW:
        return table[..., target, column]
    found = table[..., 0, :]
    for number in range(1, table.shape[-2]):
        found = torch.where(target == number, table[..., number, :], found)
    return found.expand(*found.shape[:-1], len(target))


def _measure_drift(layout: Layout, state: TensorState) -> Tensor:
    """Displacement of the hand by joints that are off their whole steps, in the base frame, m; (3, rooms)."""
    whole = state._replace(joint_offsets=torch.zeros_like(state.joint_offsets))
    now, then = (compute_hand(layout.arm, compute_angles(layout, one).to(torch.float32)) for one in (state, whole))
    return torch.stack([torch.as_tensor(a - b, device=state.x.device).expand(len(state.x))
                        for a, b in zip(now, then, strict=True)])


def estimate_hand_costs(layout: Layout, tables: Tables, fields: CostFields, state: TensorState, reach: Reach,
                        x: Tensor, y: Tensor, turn: Tensor, heading: Tensor, between: Tensor | None,
                        is_held: Tensor) -> Tensor:
    """Cost-to-go of presses by hand from places near the present one; float32 (places, rooms).

    Places of the base, x and y, are (places, rooms), m. `turn` are turn steps from the present heading, int64 (places,
    1); `heading` is its class, int64 (rooms,), and `between` the share of the way to the next class, float32 (rooms,),
    or None if all headings are classes. `is_held`, bool (places, rooms), is true where the hand touches the target in
    its present posture, so that another press needs a moment without touch.
    """
    cos, sin = compute_rotation(layout, tables, state)
    place = locate(layout, fields, state.instance, *_displace(state.x, state.y, cos, sin, *reach.shifts))
    every = interpolate_cost(layout, fields, state.instance, reach.fields, place, heading.expand_as(reach.fields),
                             between)
    best = (every.clamp(min=1.0) + reach.chosen).argmin(0).unsqueeze(0)
    shifts = reach.shifts.gather(1, best.expand(2, 1, -1))
    cos, sin = rotate(layout, tables, state, turn)
    place = locate(layout, fields, state.instance, *_displace(x, y, cos, sin, *shifts))
    facing = wrap(heading + turn, fields.classes).expand_as(x)
    way = interpolate_cost(layout, fields, state.instance, reach.fields.gather(0, best), place, facing, between)
    touch, _ = _find_least_steps(tables, reach, x, y, cos, sin)
    return torch.minimum(torch.where(is_held, UNREACHABLE, touch), way.clamp(min=1.0) + reach.chosen.gather(0, best))


def estimate_arm_costs(layout: Layout, tables: Tables, state: TensorState, reach: Reach, is_press: Tensor) -> Tensor:
    """Cost-to-go after each joint primitive, float32 (2 * joints, rooms); `UNREACHABLE` or more if useless."""
    cos, sin = compute_rotation(layout, tables, state)
    least, best = _find_least_steps(tables, reach, state.x.unsqueeze(0), state.y.unsqueeze(0), cos.unsqueeze(0),
                                    sin.unsqueeze(0))
    wanted = reach.steps.gather(1, best.expand(len(reach.steps), -1, -1)).squeeze(1) - state.joint_steps
    nearer = torch.stack([wanted > 0, wanted < 0], dim=1).flatten(0, 1)  # in the order of the primitives
    own = torch.where(is_press, 1 << reach.target, 0)
    is_held = state.touching & own != 0  # another press needs a moment without touch, which a move of the base gives
    after = torch.where(is_held, UNREACHABLE, least) + 1.0 - 2.0 * nearer
    joints = layout.robot.joints
    signs = torch.tensor([1.0, -1.0], device=after.device)
    change = (torch.eye(joints, device=after.device).unsqueeze(2) * signs).flatten(1).unsqueeze(2) * layout.arm.step
    angles = compute_angles(layout, state).unsqueeze(1) + change  # (joints, 2 * joints, rooms)
    low, high = (torch.tensor(ends, dtype=angles.dtype, device=after.device).view(-1, 1, 1)
                 for ends in zip(*layout.arm.limits, strict=True))
    is_allowed = ((angles > low - 1e-6) & (angles < high + 1e-6)).all(0)
    touched = find_touched_by_hand(layout, tables, state.instance, compute_hand(layout.arm, angles.to(torch.float32)),
                                   state.x, state.y, cos, sin)
    begun = touched & ~state.touching
    after = torch.where(begun & own != 0, 0.0, after) + OTHER_PRESS_COST * (begun & ~own != 0)
    return torch.where(is_allowed & is_press, after, 2 * UNREACHABLE)


def _find_least_steps(tables: Tables, reach: Reach, x: Tensor, y: Tensor, cos: Tensor, sin: Tensor
                      ) -> tuple[Tensor, Tensor]:
    """Fewest joint steps, at least one, to a posture that touches from places (places, rooms), and its index."""
    target = Shapes(*(field[reach.target, reach.column] for field in tables.targets))
    dx, dy = target.x - x, target.y - y
    seen = (cos * dx + sin * dy, cos * dy - sin * dx, cos * target.cos + sin * target.sin,
            cos * target.sin - sin * target.cos)
    ahead, left, along, across = (store(part.to(torch.float32)).unsqueeze(1) for part in seen)
    u, v = reach.ahead - ahead, reach.left - left  # (places, postures, rooms)
    half_x, half_y = (store(half.to(torch.float32)) for half in (target.half_x, target.half_y))
    beyond_x = ((along * u + across * v).abs() - half_x).clamp(min=0.0)
    beyond_y = ((along * v - across * u).abs() - half_y).clamp(min=0.0)
    touches = (beyond_x * beyond_x + beyond_y * beyond_y <= reach.square) & (reach.away >= 1.0)
    return torch.where(touches, reach.away, UNREACHABLE).min(1)


def _displace(x: Tensor, y: Tensor, cos: Tensor, sin: Tensor, ahead: Tensor, left: Tensor) -> tuple[Tensor, Tensor]:
    """Places ahead and to the left of others, m, at headings; float64 (..., rooms) each."""
    return x + cos * ahead - sin * left, y + sin * ahead + cos * left


def weigh_postures(layout: Layout, tables: Tables, fields: CostFields, state: TensorState, goal: Tensor, rooms: Tensor
                   ) -> Tensor:
    """Find the postures with the least remaining joint steps plus way of the base; int64 (`CHOSEN`, some).

    `goal` are the targets to press, int64 (rooms,), and `rooms` numbers of the rooms to choose in, int64 (some,).
    """
    state = map_tensors(lambda field: field[..., rooms], state)
    column = pick_column(layout, state.instance)
    steps, _, shifts, numbers = (_read(table, goal[rooms], column) for table in fields.postures)
    away = (steps - state.joint_steps.unsqueeze(1)).abs().sum(0).to(torch.float32)
    if layout.dynamics.noise:
        shifts = shifts + _measure_drift(layout, state)[:2].unsqueeze(1)
    cos, sin = compute_rotation(layout, tables, state)
    place = locate(layout, fields, state.instance, *_displace(state.x, state.y, cos, sin, *shifts))
    heading, between = classify_headings(layout, fields, state)
    way = interpolate_cost(layout, fields, state.instance, numbers, place, heading.expand_as(numbers), between)
    left, found = way.clamp(min=1.0) + away, []
    for _ in range(CHOSEN):
        found.append(left.argmin(0))
        left = left.scatter(0, found[-1].unsqueeze(0), math.inf)
    return torch.stack(found)
