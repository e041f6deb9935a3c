"""Ends of moves in a batch of rooms, and the targets touched there: what options look ahead to. Rooms come last."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from hrl_escape.env.batched.poses import TensorState, compute_angles, compute_hand, compute_rotation, place_base
from hrl_escape.env.batched.rules import drive_base, find_shut
from hrl_escape.env.batched.tables import Layout, Tables, map_tensors, pick, pick_rules
from hrl_escape.env.config import CONTACT_SKIN
from hrl_escape.env.tensor_geometry import Shapes, SplitShapes, compute_distance, compute_first_contact, store, wrap
from hrl_escape.options.batched.value_iteration import BLOCKED


def is_solved(layout: Layout, tables: Tables, state: TensorState) -> Tensor:
    """Return whether the exit is open, bool (rooms,)."""
    form, columns = pick_rules(layout, tables, state.instance)
    return form.is_solved(columns, state.puzzle)


def is_in_doorway(layout: Layout, tables: Tables, state: TensorState) -> Tensor:
    """Return whether the body is in the doorway, where a shut door does not block it, bool (rooms,)."""
    doors: Shapes = pick(layout, tables.doors, state.instance)
    return place_base(layout, tables, state, CONTACT_SKIN).stands_in(doors)[0]


def presses_by_hand(layout: Layout) -> bool:
    """Return whether targets are pressed by the hand."""
    return layout.targets > 0 and layout.dynamics.press_with == "hand"


def compute_resting_hand(layout: Layout, state: TensorState) -> list[Tensor | float]:
    """Hand in the base frame in the present posture, m: x, y and z, each (rooms,) or one number."""
    return compute_hand(layout.arm, compute_angles(layout, state).to(torch.float32))


def rotate(layout: Layout, tables: Tables, state: TensorState, turn: Tensor) -> tuple[Tensor, Tensor]:
    """Cosine and sine of the headings after turns, int64 (cases, 1), in turn steps; (cases, rooms) each."""
    headings = wrap(state.heading_steps + turn, layout.headings)
    return compute_rotation(layout, tables, state._replace(heading_steps=headings))


def make_column(layout: Layout, state: TensorState, name: str, dtype: torch.dtype) -> Tensor:
    """Column of one attribute (`forward`, `left`, `length`, `turn`) of the base primitives, shape (primitives, 1)."""
    values = [getattr(primitive, name) for primitive in layout.actions.primitives[:len(layout.actions.base)]]
    return torch.tensor(values, dtype=dtype, device=state.x.device).unsqueeze(1)


class MoveEnds(NamedTuple):
    """Ends of every base primitive from the present state of every room; all fields (primitives, rooms)."""

    x: Tensor  # m, float64
    y: Tensor  # m, float64
    touched: Tensor  # bits of the targets touched there, int64
    is_blocked: Tensor  # true where the base stays as it is, bool


def find_ends(layout: Layout, tables: Tables, state: TensorState, is_open: Tensor) -> MoveEnds:
    """Find where base primitives lead: `is_open`, bool (rooms,), is true where the exit's door blocks nothing."""
    if not layout.robot.base.turns_anywhere:
        return _step_ends(layout, tables, state)
    free, x, y = compute_moves(layout, tables, state, is_open)
    turn = make_column(layout, state, "turn", torch.int64)
    touched = (find_touched_by_hand(layout, tables, state.instance, compute_resting_hand(layout, state), x, y,
                                    *rotate(layout, tables, state, turn))
               if presses_by_hand(layout) else find_touched_by_body(layout, tables, state, x, y))
    return MoveEnds(x, y, touched, (free * make_column(layout, state, "length", free.dtype) < BLOCKED) & (turn == 0))


def repeat_rooms(state: TensorState, count: int) -> TensorState:
    """Repeat the states of the rooms `count` times, one copy after the other."""
    return TensorState(*(field.repeat(*(1,) * (field.dim() - 1), count) for field in state))


def _step_ends(layout: Layout, tables: Tables, state: TensorState) -> MoveEnds:
    """The same by the engine, a copy of the rooms for each primitive, for bases that cannot turn just anywhere."""
    count, rooms = len(layout.actions.base), state.x.shape[0]
    before = repeat_rooms(state, count)
    actions = torch.arange(count, device=state.x.device).repeat_interleave(rooms)
    after = drive_base(layout, tables, before, actions)
    is_blocked = torch.hypot(after.x - before.x, after.y - before.y) < BLOCKED
    is_blocked = is_blocked & (after.heading_steps == before.heading_steps)
    return MoveEnds(*(field.view(count, rooms) for field in (after.x, after.y, after.touching, is_blocked)))


def compute_moves(layout: Layout, tables: Tables, state: TensorState, is_open: Tensor
                  ) -> tuple[Tensor, Tensor, Tensor]:
    """Free share of each base primitive's displacement, and x and y of its end, (primitives, rooms) each."""
    cos, sin = compute_rotation(layout, tables, state)
    forward, left = (make_column(layout, state, name, torch.float64)[layout.actions.translations]
                     for name in ("forward", "left"))
    dx, dy = forward * cos - left * sin, forward * sin + left * cos
    motion = (state.x, state.y, dx.unsqueeze(1), dy.unsqueeze(1), layout.robot.outer_radius + CONTACT_SKIN)
    solids: SplitShapes = pick(layout, tables.split_solids, state.instance)
    free = compute_first_contact(*motion, solids).amin(1).clamp(min=0.0)
    if layout.inner_doors:
        inner: Shapes = pick(layout, tables.inner_doors, state.instance)
        is_shut = find_shut(layout, tables, state) & ~place_base(layout, tables, state, CONTACT_SKIN).stands_in(inner)
        contact = compute_first_contact(*motion, inner.split()).clamp(min=0.0)
        free = torch.minimum(free, torch.where(is_shut, contact, 1.0).amin(1))
    if layout.has_door:
        doors: Shapes = pick(layout, tables.doors, state.instance)
        door = compute_first_contact(*motion, doors.split()).amin(1).clamp(min=0.0)
        free = torch.where(is_open, free, torch.minimum(free, door))
    if layout.dynamics.blocked == "stay":
        free = (free >= 1.0).to(free.dtype)
    x, y = state.x + free * dx, state.y + free * dy
    stays = len(layout.actions.turns)
    return (torch.cat([free, free.new_ones((stays, *free.shape[1:]))]), torch.cat([x, state.x.expand(stays, -1)]),
            torch.cat([y, state.y.expand(stays, -1)]))


def find_touched_by_body(layout: Layout, tables: Tables, state: TensorState, x: Tensor, y: Tensor) -> Tensor:
    """Bits of the targets that the body touches at positions (primitives, rooms), int64."""
    if not layout.targets:
        return torch.zeros_like(x, dtype=torch.int64)
    targets, reach = _add_cases((pick(layout, tables.round_targets, state.instance),
                                 pick(layout, tables.target_reach, state.instance)))
    return _pack(compute_distance(x, y, targets) <= reach)


def find_touched_by_hand(layout: Layout, tables: Tables, instance: Tensor, hand: Sequence[Tensor | float], x: Tensor,
                         y: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """Bits of the targets that the hand touches, int64 (cases, rooms).

    The hand's x, y and z in the base frame, m, the place of the base, m, and cosine and sine of its heading are each
    (cases, rooms) or (rooms,).
    """
    ahead, left, up = hand
    room_x, room_y = x + cos * ahead - sin * left, y + sin * ahead + cos * left
    targets, z, half_z = _add_cases((pick(layout, tables.round_targets, instance),
                                     pick(layout, tables.target_z, instance),
                                     pick(layout, tables.target_half_z, instance)))
    away, above = compute_distance(room_x, room_y, targets), ((up - z).abs() - half_z).clamp(min=0.0)
    return _pack(torch.sqrt(away * away + above * above) <= layout.robot.hand_radius + layout.dynamics.press_margin)


def _add_cases(table: Any) -> Any:
    """Tables (targets, rooms) as (targets, 1, rooms), so that sums over targets come before rooms."""
    return map_tensors(lambda column: column.unsqueeze(1), table)


def _pack(touched: Tensor) -> Tensor:
    """Bits of truth values (targets, cases, rooms), int64 (cases, rooms)."""
    word = torch.int32 if len(touched) < 32 else torch.int64
    places = torch.arange(len(touched), dtype=word, device=touched.device).view(-1, 1, 1)
    return store(touched.to(word) << places).sum(0, dtype=word).to(torch.int64)
