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
_BLOCKED = 0.01  # moves shorter than this do not count, m
_MOVES = tuple(k for k, primitive in enumerate(BASE_PRIMITIVES) if not primitive.turn)
_TURNS = tuple(k for k, primitive in enumerate(BASE_PRIMITIVES) if primitive.turn)


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
    instance, robot = state.instance, layout.robot
    solved = is_solved(layout, tables, state)
    field = torch.where(goal < layout.targets, 2 * goal + solved, 2 * layout.targets)
    heading = classify_headings(layout, prices, instance, state.heading_steps, state.heading_offset)

    ends = [_move(layout, tables, state, solved, BASE_PRIMITIVES[k].forward, BASE_PRIMITIVES[k].left) for k in _MOVES]
    free = torch.stack([fraction for fraction, _, _ in ends])  # (moves, rooms)
    x, y = torch.stack([x for _, x, _ in ends]), torch.stack([y for _, _, y in ends])
    place = find_place(layout, prices, instance, torch.cat([x, state.x.unsqueeze(0)]),
                       torch.cat([y, state.y.unsqueeze(0)]))
    here = place.cell[-1] * prices.classes
    candidates = [(k, type(place)(*(part[k] for part in place)), heading) for k in range(len(_MOVES))]
    for k in _TURNS:
        turned = torch.remainder(heading + BASE_PRIMITIVES[k].turn, prices.classes)
        candidates.append((k, type(place)(*(part[-1] for part in place)), turned))

    was_touching = ((state.touching >> goal.clamp(max=max(layout.targets - 1, 0))) & 1 != 0) & (goal < layout.targets)
    best = torch.full_like(place.across[0], 4 * FAR)
    primitive = torch.zeros_like(goal)
    for k, at, facing in candidates:
        worth = look_up(layout, prices, instance, field, at, facing)
        key = at.cell * prices.classes + facing
        worth = torch.maximum(worth, torch.where(cells == key, costs, 0.0).amax(0))
        if k in _MOVES:
            hit, still, others = _touch(layout, tables, state, goal, x[k], y[k])
            arrived = is_in_exit(layout, tables, instance, x[k], y[k])
            hit = torch.where(goal < layout.targets, hit, arrived)
            worth = torch.where(hit, 0.0, worth.clamp(min=1.0) + still)
            worth = worth + PENALTY * others + FAR * (arrived & solved & (goal < layout.targets))
            worth = torch.where((free[k] * robot.move_step < _BLOCKED) & ~hit, 2 * FAR, worth)
        else:
            worth = worth.clamp(min=1.0) + was_touching
        better = worth < best
        best, primitive = torch.where(better, worth, best), torch.where(better, k, primitive)
    return Choice(primitive, best + 1.0, here + heading)


def _move(layout: Layout, tables: Tables, state: TensorState, solved: Tensor, forward: int, left: int
          ) -> tuple[Tensor, Tensor, Tensor]:
    """Share of a move that can be made, and where it ends, (rooms,) each."""
    cos, sin = compute_rotation(layout, tables, state)
    step = layout.robot.move_step
    dx, dy = step * (forward * cos - left * sin), step * (forward * sin + left * cos)
    reach = layout.robot.body_radius + CONTACT_SKIN
    solids: Shapes = pick(layout, tables.solids, state.instance)
    free = compute_first_contact(state.x, state.y, dx, dy, reach, solids.round()).amin(0)
    if layout.has_door:
        doors: Shapes = pick(layout, tables.doors, state.instance)
        door = compute_first_contact(state.x, state.y, dx, dy, reach, doors)[0].to(free.dtype)
        free = torch.where(solved, free, torch.minimum(free, door))
    return free, state.x + free * dx, state.y + free * dy


def _touch(layout: Layout, tables: Tables, state: TensorState, goal: Tensor, x: Tensor, y: Tensor
           ) -> tuple[Tensor, Tensor, Tensor]:
    """Whether the goal's touching begins at a place, whether it goes on there, and whether another's begins."""
    if not layout.targets:
        nothing = torch.zeros_like(goal, dtype=torch.bool)
        return nothing, nothing, nothing
    targets: Shapes = pick(layout, tables.targets, state.instance).round()
    places = torch.arange(layout.targets, device=x.device).unsqueeze(1)
    touched = compute_distance(x, y, targets) <= pick(layout, tables.target_reach, state.instance)
    before = (state.touching >> places) & 1 != 0
    own, begun = places == goal, touched & ~before
    return (begun & own).any(0), (touched & before & own).any(0), (begun & ~own).any(0)
