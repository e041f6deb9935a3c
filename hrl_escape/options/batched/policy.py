"""How batched options choose: greedily, one primitive ahead, by the cost to go from where it leads.

Moves are swept exactly, so that walls and press margins count as they will; what lies beyond
is looked up (`prices.py`). Where fields mislead, a room remembers what it found in the cells it
came through and does not circle (learning real-time A*, Korf 1990). Pure functions of tensors, rooms last.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from hrl_escape.env.config import CONTACT_SKIN
from hrl_escape.env.primitives import BASE_PRIMITIVES
from hrl_escape.env.tensor_geometry import Shapes, compute_distance, compute_first_contact
from hrl_escape.env.tensor_instances import Layout, Tables, pick
from hrl_escape.env.tensor_poses import TensorState, compute_rotation
from hrl_escape.env.tensor_puzzles import get_tensor_puzzle
from hrl_escape.options.batched.prices import (
    PENALTY,
    Prices,
    classify_headings,
    find_place,
    look_up,
)
from hrl_escape.options.batched.relaxing import FAR

__all__ = ["REMEMBERED", "Choice", "can_start", "choose", "is_in_exit", "is_solved"]

REMEMBERED = 8
"""Cells a room remembers the cost of."""
_MOVES = sum(not primitive.turn for primitive in BASE_PRIMITIVES)  # the first ones
_FINE_HEADINGS = 16  # robots that turn in coarser steps look two primitives ahead, for fields tell them less
_BLOCKED = 0.01  # moves shorter than this do not count, m


class Choice(NamedTuple):
    """What options do next; all fields (rooms,).

    Attributes:
        primitive: int64.
        cost: primitives to the goal, this one included, float32; `FAR` or more if there is no way.
        cell: cell and heading class it was chosen in, int64.
    """

    primitive: Tensor
    cost: Tensor
    cell: Tensor


def is_solved(layout: Layout, tables: Tables, state: TensorState) -> Tensor:
    """Whether the exit is open, bool (rooms,)."""
    return get_tensor_puzzle(layout.puzzle).is_solved(pick(layout, tables.puzzle, state.instance), state.puzzle)


def is_in_exit(layout: Layout, tables: Tables, instance: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Whether positions (..., rooms) are in each room's exit."""
    x_min, x_max, y_min, y_max = pick(layout, tables.exits, instance)
    return (x_min <= x) & (x <= x_max) & (y_min <= y) & (y <= y_max)


def can_start(layout: Layout, tables: Tables, state: TensorState) -> Tensor:
    """Which options may start, bool (rooms, targets + 1).

    Every press may; the exit where the robot is not in it yet and no shut door is before it.
    """
    inside = is_in_exit(layout, tables, state.instance, state.x, state.y)
    has_door = pick(layout, tables.doors, state.instance).x[0] < 1e5
    exit_ = ~inside & (~has_door | is_solved(layout, tables, state))
    return torch.cat([torch.ones_like(exit_).unsqueeze(1).expand(-1, layout.targets), exit_.unsqueeze(1)], dim=1)


def choose(layout: Layout, tables: Tables, prices: Prices, state: TensorState, goal: Tensor, cells: Tensor,
           costs: Tensor) -> Choice:
    """Choose every room's next primitive.

    Args:
        layout: what the rooms have in common.
        tables: their instances.
        prices: their fields.
        state: where they are.
        goal: the target to press, or the number of targets for the exit, int64 (rooms,).
        cells: cells remembered, int64 (remembered, rooms).
        costs: the costs found there, float32 (remembered, rooms).
    """
    depth = 1 if layout.headings >= _FINE_HEADINGS else 2
    worth = _judge(layout, tables, prices, state, goal, cells, costs, depth)
    best = worth.amin(0)
    numbers = torch.arange(len(BASE_PRIMITIVES), device=goal.device).unsqueeze(1)
    primitive = torch.where(worth == best, numbers, len(BASE_PRIMITIVES)).amin(0)
    here = find_place(layout, prices, state.instance, state.x, state.y)
    heading, _ = classify_headings(layout, prices, state)
    return Choice(primitive, best + 1.0, here.cell * prices.classes + heading)


def _judge(layout: Layout, tables: Tables, prices: Prices, state: TensorState, goal: Tensor, cells: Tensor,
           costs: Tensor, depth: int) -> Tensor:
    """Primitives still to go after each base primitive, looking so many primitives ahead; (primitives, rooms)."""
    instance = state.instance
    solved = is_solved(layout, tables, state)
    is_press = goal < layout.targets
    is_open = solved | _is_in_doorway(layout, tables, state)
    free, x, y = _move(layout, tables, state, is_open)
    touched = _touch(layout, tables, state, x, y)
    own = torch.where(is_press, 1 << goal.clamp(max=max(layout.targets - 1, 0)), 0)
    begun = touched & ~state.touching
    arrived = is_in_exit(layout, tables, instance, x, y)
    hit = torch.where(is_press, begun & own != 0, arrived)
    turn = _column(state, "turn", torch.int64)
    if depth == 1:
        place = find_place(layout, prices, instance, x, y)
        heading, between = classify_headings(layout, prices, state)
        facing = torch.remainder(heading + turn, prices.classes)
        field = torch.where(is_press, 2 * goal + is_open, 2 * layout.targets)
        worth = look_up(layout, prices, instance, field, place, facing, between)
        keys = place.cell * prices.classes + facing
        found = torch.where(cells.unsqueeze(1) == keys, costs.unsqueeze(1), 0.0).amax(0)
        worth = torch.maximum(worth, found).clamp(min=1.0) + (touched & own != 0)
    else:
        worth = _look_on(layout, tables, prices, state, goal, cells, costs, depth, x, y, touched, turn)
    worth = torch.where(hit, 0.0, worth) + PENALTY * (begun & ~own != 0) + FAR * (arrived & solved & is_press)
    is_blocked = (free * layout.robot.move_step < _BLOCKED) & (turn == 0) & ~hit
    return torch.where(is_blocked, 2 * FAR, worth)


def _look_on(layout: Layout, tables: Tables, prices: Prices, state: TensorState, goal: Tensor, cells: Tensor,
             costs: Tensor, depth: int, x: Tensor, y: Tensor, touched: Tensor, turn: Tensor) -> Tensor:
    """Primitives to go from where each base primitive leads: its best successor's and one more."""
    count = len(x)
    later = TensorState(*(field.repeat(*(1,) * (field.dim() - 1), count) for field in state))
    headings = torch.remainder(state.heading_steps + turn, layout.headings).to(torch.int32)
    later = later._replace(x=x.flatten(), y=y.flatten(), heading_steps=headings.flatten(), touching=touched.flatten())
    worth = _judge(layout, tables, prices, later, goal.repeat(count), cells.repeat(1, count), costs.repeat(1, count),
                   depth - 1)
    return worth.amin(0).view_as(x) + 1.0


def _is_in_doorway(layout: Layout, tables: Tables, state: TensorState) -> Tensor:
    """Whether the body stands where the shut door would be, which then holds nobody, bool (rooms,)."""
    doors: Shapes = pick(layout, tables.doors, state.instance)
    return compute_distance(state.x, state.y, doors)[0] < layout.robot.body_radius + CONTACT_SKIN - 1e-6


def _column(state: TensorState, name: str, dtype: torch.dtype) -> Tensor:
    """What base primitives say under a name (`forward`, `left`, `turn`), shape (primitives, 1)."""
    values = [getattr(primitive, name) for primitive in BASE_PRIMITIVES]
    return torch.tensor(values, dtype=dtype, device=state.x.device).unsqueeze(1)


def _move(layout: Layout, tables: Tables, state: TensorState, is_open: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Share of each base primitive's displacement that can be made, and where it ends, (primitives, rooms) each."""
    cos, sin = compute_rotation(layout, tables, state)
    forward, left = (layout.robot.move_step * _column(state, name, torch.float64)[:_MOVES]
                     for name in ("forward", "left"))
    dx, dy = forward * cos - left * sin, forward * sin + left * cos
    motion = (state.x, state.y, dx.unsqueeze(1), dy.unsqueeze(1), layout.robot.body_radius + CONTACT_SKIN)
    solids: Shapes = pick(layout, tables.solids, state.instance)
    free = compute_first_contact(*motion, solids.round()).amin(1).clamp(min=0.0)
    if layout.has_door:
        doors: Shapes = pick(layout, tables.doors, state.instance)
        door = compute_first_contact(*motion, doors.round()).amin(1).clamp(min=0.0)
        free = torch.where(is_open, free, torch.minimum(free, door))
    x, y = state.x + free * dx, state.y + free * dy
    stays = len(BASE_PRIMITIVES) - _MOVES
    return (torch.cat([free, torch.ones_like(free[:stays])]), torch.cat([x, state.x.expand(stays, -1)]),
            torch.cat([y, state.y.expand(stays, -1)]))


def _touch(layout: Layout, tables: Tables, state: TensorState, x: Tensor, y: Tensor) -> Tensor:
    """Bits of the targets that the body touches at places (primitives, rooms), int64."""
    if not layout.targets:
        return torch.zeros_like(x, dtype=torch.int64)
    targets: Shapes = pick(layout, tables.targets, state.instance).round()
    reach = pick(layout, tables.target_reach, state.instance)
    touched = compute_distance(x.unsqueeze(1), y.unsqueeze(1), targets) <= reach  # (primitives, targets, rooms)
    places = torch.arange(layout.targets, device=x.device).unsqueeze(1)
    return (touched.to(torch.int64) << places).sum(1)
