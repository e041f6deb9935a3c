"""Greedy policy of batched options: the primitive that leads to the least cost-to-go.

Moves are swept exactly, with walls and press margins; the cost-to-go of their ends is interpolated
(`cost_to_go.py`). Where fields mislead, a room remembers the costs found in its last cells, so that
it does not circle (learning real-time A*, Korf 1990). Pure functions of tensors, rooms last.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from hrl_escape.env.batched.poses import TensorState
from hrl_escape.env.batched.rules import is_in_exit
from hrl_escape.env.batched.tables import Layout, Tables, pick
from hrl_escape.options.batched.cost_to_go import CostFields, classify_headings, interpolate_cost, locate
from hrl_escape.options.batched.field_grid import OTHER_PRESS_COST
from hrl_escape.options.batched.hand_policy import Reach, estimate_arm_costs, estimate_hand_costs, find_reach
from hrl_escape.options.batched.successors import (
    compute_moves,
    compute_resting_hand,
    find_touched_by_body,
    find_touched_by_hand,
    is_in_doorway,
    is_solved,
    make_column,
    presses_by_hand,
    rotate,
)
from hrl_escape.options.batched.value_iteration import UNREACHABLE

__all__ = ["MEMORY", "Choice", "can_start", "choose_primitive"]

MEMORY = 8
"""Number of cells whose cost a room remembers."""
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
                     postures: Tensor, cells: Tensor, costs: Tensor) -> Choice:
    """Choose every room's next primitive.

    Args:
        layout: properties that all rooms share.
        tables: their instances.
        fields: their fields.
        state: their states.
        goal: the target to press, or the number of targets for the exit, int64 (rooms,).
        postures: postures that a hand may press in, int64 (chosen, rooms).
        cells: last cells of each room, int64 (memory, rooms).
        costs: costs found there, float32 (memory, rooms).
    """
    depth = 1 if layout.headings >= _FINE_HEADINGS else 2
    reach = find_reach(layout, tables, fields, state, goal, postures) if presses_by_hand(layout) else None
    after = _estimate_costs(layout, tables, fields, state, goal, postures, reach, cells, costs, depth)
    if reach is not None:
        after = torch.cat([after, estimate_arm_costs(layout, tables, state, reach, goal < layout.targets)])
    best = after.amin(0)
    numbers = torch.arange(len(after), device=goal.device).unsqueeze(1)
    primitive = torch.where(after == best, numbers, len(after)).amin(0)
    here = locate(layout, fields, state.instance, state.x, state.y)
    heading, _ = classify_headings(layout, fields, state)
    return Choice(primitive, best + 1.0, here.cell * fields.classes + heading)


def _estimate_costs(layout: Layout, tables: Tables, fields: CostFields, state: TensorState, goal: Tensor,
                    postures: Tensor, reach: Reach | None, cells: Tensor, costs: Tensor, depth: int) -> Tensor:
    """Cost-to-go after each base primitive, by a look-ahead of `depth` primitives; (primitives, rooms)."""
    instance = state.instance
    solved = is_solved(layout, tables, state)
    is_press = goal < layout.targets
    is_open = solved | is_in_doorway(layout, tables, state)
    free, x, y = compute_moves(layout, tables, state, is_open)
    turn = make_column(layout, state, "turn", torch.int64)
    touched = (find_touched_by_hand(layout, tables, instance, compute_resting_hand(layout, state), x, y,
                                    *rotate(layout, tables, state, turn))
               if reach is not None else find_touched_by_body(layout, tables, state, x, y))
    own = torch.where(is_press, 1 << goal.clamp(max=max(layout.targets - 1, 0)), 0)
    begun = touched & ~state.touching
    arrived = is_in_exit(layout, tables, instance, x, y)
    hit = torch.where(is_press, begun & own != 0, arrived)
    if depth == 1:
        place = locate(layout, fields, instance, x, y)
        heading, between = classify_headings(layout, fields, state)
        facing = torch.remainder(heading + turn, fields.classes)
        way_out = len(fields.begins) - 1
        field = torch.where(is_press if reach is None else torch.zeros_like(is_press), 2 * goal + is_open, way_out)
        after = interpolate_cost(layout, fields, instance, field, place, facing, between)
        if reach is not None:
            press = estimate_hand_costs(layout, tables, fields, state, reach, x, y, turn, heading, between,
                                        touched & own != 0)
            after = torch.where(is_press, press, after)
        keys = place.cell * fields.classes + facing
        found = torch.where(cells.unsqueeze(1) == keys, costs.unsqueeze(1), 0.0).amax(0)
        after = torch.maximum(after, found).clamp(min=1.0) + (touched & own != 0)
    else:
        after = _estimate_from_successors(layout, tables, fields, state, goal, postures, cells, costs, depth, x, y,
                                          touched, turn)
    after = torch.where(hit, 0.0, after) + OTHER_PRESS_COST * (begun & ~own != 0)
    after = after + UNREACHABLE * (arrived & solved & is_press)
    is_blocked = (free * make_column(layout, state, "length", free.dtype) < _BLOCKED) & (turn == 0) & ~hit
    return torch.where(is_blocked, 2 * UNREACHABLE, after)


def _estimate_from_successors(layout: Layout, tables: Tables, fields: CostFields, state: TensorState, goal: Tensor,
                              postures: Tensor, cells: Tensor, costs: Tensor, depth: int, x: Tensor, y: Tensor,
                              touched: Tensor, turn: Tensor) -> Tensor:
    """Cost-to-go after each base primitive: one more than that of the best primitive to follow it."""
    count = len(x)
    later = TensorState(*(field.repeat(*(1,) * (field.dim() - 1), count) for field in state))
    headings = torch.remainder(state.heading_steps + turn, layout.headings).to(torch.int32)
    later = later._replace(x=x.flatten(), y=y.flatten(), heading_steps=headings.flatten(), touching=touched.flatten())
    goals, later_postures = goal.repeat(count), postures.repeat(1, count)
    reach = find_reach(layout, tables, fields, later, goals, later_postures) if presses_by_hand(layout) else None
    after = _estimate_costs(layout, tables, fields, later, goals, later_postures, reach, cells.repeat(1, count),
                            costs.repeat(1, count), depth - 1)
    return after.amin(0).view_as(x) + 1.0
