"""Greedy policy of batched options: the primitive that leads to the least cost-to-go.

Moves are swept exactly, with walls and press margins; the cost-to-go of their ends is interpolated
(`cost_to_go.py`). Where fields mislead, a room remembers the costs found in its last cells, so that
it does not circle (learning real-time A*, Korf 1990). Pure functions of tensors, rooms last.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from hrl_escape.env.batched.geometry import Shapes, compute_distance, compute_first_contact
from hrl_escape.env.batched.poses import TensorState, compute_rotation
from hrl_escape.env.batched.puzzles.base import get_tensor_puzzle
from hrl_escape.env.batched.rules import is_in_exit
from hrl_escape.env.batched.tables import Layout, Tables, pick
from hrl_escape.env.config import CONTACT_SKIN
from hrl_escape.options.batched.cost_to_go import (
    OTHER_PRESS_COST,
    CostFields,
    classify_headings,
    interpolate_cost,
    locate,
)
from hrl_escape.options.batched.value_iteration import UNREACHABLE

__all__ = ["MEMORY", "Choice", "can_start", "choose_primitive", "is_solved"]

MEMORY = 8
"""Cells whose cost a room remembers."""
_FINE_HEADINGS = 16  # robots with coarser turns look two primitives ahead: fields are less precise for them
_BLOCKED = 0.01  # moves shorter than this do not count, m


class Choice(NamedTuple):
    """Next primitive of the options; all fields (rooms,).

    Attributes:
        primitive: int64.
        cost: cost-to-go, this primitive included, float32; `UNREACHABLE` or more if there is no way.
        cell: cell and heading class of the room, int64.
    """

    primitive: Tensor
    cost: Tensor
    cell: Tensor


def is_solved(layout: Layout, tables: Tables, state: TensorState) -> Tensor:
    """Return whether the exit is open, bool (rooms,)."""
    return get_tensor_puzzle(layout.puzzle).is_solved(pick(layout, tables.puzzle, state.instance), state.puzzle)


def can_start(layout: Layout, tables: Tables, state: TensorState) -> Tensor:
    """Return the options that may start, bool (rooms, targets + 1).

    The press of every target that the room has may; the exit may unless the robot is in it already or a shut door
    blocks it.
    """
    inside = is_in_exit(layout, tables, state.instance, state.x, state.y)
    has_door = pick(layout, tables.doors, state.instance).x[0] < 1e5
    exit_ = ~inside & (~has_door | is_solved(layout, tables, state))
    counts = pick(layout, tables.target_counts, state.instance).squeeze(0).expand(len(exit_))
    is_present = torch.arange(layout.targets, device=exit_.device) < counts.unsqueeze(1)
    return torch.cat([is_present, exit_.unsqueeze(1)], dim=1)


def choose_primitive(layout: Layout, tables: Tables, fields: CostFields, state: TensorState, goal: Tensor,
                     cells: Tensor, costs: Tensor) -> Choice:
    """Choose every room's next primitive.

    Args:
        layout: properties that all rooms share.
        tables: their instances.
        fields: their fields.
        state: their states.
        goal: the target to press, or the number of targets for the exit, int64 (rooms,).
        cells: cells remembered, int64 (memory, rooms).
        costs: costs found there, float32 (memory, rooms).
    """
    depth = 1 if layout.headings >= _FINE_HEADINGS else 2
    after = _estimate_costs(layout, tables, fields, state, goal, cells, costs, depth)
    best = after.amin(0)
    numbers = torch.arange(len(layout.actions.base), device=goal.device).unsqueeze(1)
    primitive = torch.where(after == best, numbers, len(layout.actions.base)).amin(0)
    here = locate(layout, fields, state.instance, state.x, state.y)
    heading, _ = classify_headings(layout, fields, state)
    return Choice(primitive, best + 1.0, here.cell * fields.classes + heading)


def _estimate_costs(layout: Layout, tables: Tables, fields: CostFields, state: TensorState, goal: Tensor,
                    cells: Tensor, costs: Tensor, depth: int) -> Tensor:
    """Cost-to-go after each base primitive, by a look-ahead of `depth` primitives; (primitives, rooms)."""
    instance = state.instance
    solved = is_solved(layout, tables, state)
    is_press = goal < layout.targets
    is_open = solved | _is_in_doorway(layout, tables, state)
    free, x, y = _compute_moves(layout, tables, state, is_open)
    touched = _find_touched(layout, tables, state, x, y)
    own = torch.where(is_press, 1 << goal.clamp(max=max(layout.targets - 1, 0)), 0)
    begun = touched & ~state.touching
    arrived = is_in_exit(layout, tables, instance, x, y)
    hit = torch.where(is_press, begun & own != 0, arrived)
    turn = _column(layout, state, "turn", torch.int64)
    if depth == 1:
        place = locate(layout, fields, instance, x, y)
        heading, between = classify_headings(layout, fields, state)
        facing = torch.remainder(heading + turn, fields.classes)
        field = torch.where(is_press, 2 * goal + is_open, 2 * layout.targets)
        after = interpolate_cost(layout, fields, instance, field, place, facing, between)
        keys = place.cell * fields.classes + facing
        found = torch.where(cells.unsqueeze(1) == keys, costs.unsqueeze(1), 0.0).amax(0)
        after = torch.maximum(after, found).clamp(min=1.0) + (touched & own != 0)
    else:
        after = _estimate_from_successors(layout, tables, fields, state, goal, cells, costs, depth, x, y, touched, turn)
    after = torch.where(hit, 0.0, after) + OTHER_PRESS_COST * (begun & ~own != 0)
    after = after + UNREACHABLE * (arrived & solved & is_press)
    is_blocked = (free * layout.robot.move_step < _BLOCKED) & (turn == 0) & ~hit
    return torch.where(is_blocked, 2 * UNREACHABLE, after)


def _estimate_from_successors(layout: Layout, tables: Tables, fields: CostFields, state: TensorState, goal: Tensor,
                              cells: Tensor, costs: Tensor, depth: int, x: Tensor, y: Tensor, touched: Tensor,
                              turn: Tensor) -> Tensor:
    """Cost-to-go after each base primitive: that of the best primitive to follow it, and one."""
    count = len(x)
    later = TensorState(*(field.repeat(*(1,) * (field.dim() - 1), count) for field in state))
    headings = torch.remainder(state.heading_steps + turn, layout.headings).to(torch.int32)
    later = later._replace(x=x.flatten(), y=y.flatten(), heading_steps=headings.flatten(), touching=touched.flatten())
    after = _estimate_costs(layout, tables, fields, later, goal.repeat(count), cells.repeat(1, count),
                            costs.repeat(1, count), depth - 1)
    return after.amin(0).view_as(x) + 1.0


def _is_in_doorway(layout: Layout, tables: Tables, state: TensorState) -> Tensor:
    """Return whether the body stands in the doorway, where a shut door does not block it, bool (rooms,)."""
    doors: Shapes = pick(layout, tables.doors, state.instance)
    return compute_distance(state.x, state.y, doors)[0] < layout.robot.body_radius + CONTACT_SKIN - 1e-6


def _column(layout: Layout, state: TensorState, name: str, dtype: torch.dtype) -> Tensor:
    """Column of one attribute (`forward`, `left`, `turn`) of the base primitives, shape (primitives, 1)."""
    values = [getattr(primitive, name) for primitive in layout.actions.primitives[:len(layout.actions.base)]]
    return torch.tensor(values, dtype=dtype, device=state.x.device).unsqueeze(1)


def _compute_moves(layout: Layout, tables: Tables, state: TensorState, is_open: Tensor
                   ) -> tuple[Tensor, Tensor, Tensor]:
    """Free share of each base primitive's displacement, and x and y of its end, (primitives, rooms) each."""
    cos, sin = compute_rotation(layout, tables, state)
    forward, left = (layout.robot.move_step * _column(layout, state, name, torch.float64)[layout.actions.translations]
                     for name in ("forward", "left"))
    dx, dy = forward * cos - left * sin, forward * sin + left * cos
    motion = (state.x, state.y, dx.unsqueeze(1), dy.unsqueeze(1), layout.robot.body_radius + CONTACT_SKIN)
    solids: Shapes = pick(layout, tables.solids, state.instance)
    free = compute_first_contact(*motion, solids.round()).amin(1).clamp(min=0.0)
    if layout.has_door:
        doors: Shapes = pick(layout, tables.doors, state.instance)
        door = compute_first_contact(*motion, doors.round()).amin(1).clamp(min=0.0)
        free = torch.where(is_open, free, torch.minimum(free, door))
    if layout.dynamics.blocked == "stay":
        free = (free >= 1.0).to(free.dtype)
    x, y = state.x + free * dx, state.y + free * dy
    stays = len(layout.actions.turns)
    return (torch.cat([free, torch.ones_like(free[:stays])]), torch.cat([x, state.x.expand(stays, -1)]),
            torch.cat([y, state.y.expand(stays, -1)]))


def _find_touched(layout: Layout, tables: Tables, state: TensorState, x: Tensor, y: Tensor) -> Tensor:
    """Bits of the targets that the body touches at positions (primitives, rooms), int64."""
    if not layout.targets:
        return torch.zeros_like(x, dtype=torch.int64)
    targets: Shapes = pick(layout, tables.targets, state.instance).round()
    reach = pick(layout, tables.target_reach, state.instance)
    touched = compute_distance(x.unsqueeze(1), y.unsqueeze(1), targets) <= reach  # (primitives, targets, rooms)
    places = torch.arange(layout.targets, device=x.device).unsqueeze(1)
    return (touched.to(torch.int64) << places).sum(1)
