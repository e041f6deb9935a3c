"""The kinematic Escape Room MDP as pure functions of torch tensors: one call moves every room of a batch.

No operation branches on data, which allows `torch.compile` to fuse the rules on any device. They equal the rules in
`kinematics.py`; `tests/env/test_engines_agree.py` compares the two.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from hrl_escape.env.bases import TensorBase
from hrl_escape.env.batched.poses import (
    TensorState,
    compute_angles,
    compute_heading,
    compute_rotation,
    compute_touching,
    make_joint_column,
    place_base,
)
from hrl_escape.env.batched.puzzles.base import TensorContacts, pack_bits, unpack_bits
from hrl_escape.env.batched.tables import Layout, Tables, pick, pick_column, pick_rules
from hrl_escape.env.config import CONTACT_SKIN
from hrl_escape.env.kinematics import ROUNDING
from hrl_escape.env.noise import CHANCE_PURPOSE, NOISE_PURPOSE, draw_puzzle_start, draw_words, scale_word
from hrl_escape.env.primitives import list_slips
from hrl_escape.env.puzzles.base import PUSH, USE
from hrl_escape.env.rewards import Events, RewardState
from hrl_escape.env.tensor_geometry import RoomSolids, Shapes, as_flags, compute_distance, store
from hrl_escape.env.velocities import GRIPPER_LEVEL, count_levels


class TensorTransition(NamedTuple):
    """Outcome of one primitive in each room."""

    state: TensorState  # the next states
    reward: Tensor  # float32 (rooms,)
    terminated: Tensor  # bool (rooms,)
    truncated: Tensor  # bool (rooms,)
    pressed: Tensor  # bits of the targets that the primitive pressed, int64 (rooms,)
    escaped: Tensor  # bool (rooms,)


def compute_noise(key: Tensor, primitive: Tensor) -> tuple[Tensor, Tensor]:
    """Return (standard normal, uniform in (0, 1)) for a primitive of each room's episode.

    Both are float64 (rooms,), because single precision would cut off the tail of the normal.
    """
    a, b, c, _ = draw_words(key, primitive.to(torch.int64), NOISE_PURPOSE)
    scale = 1.0 / 2**32
    first, second, third = ((word.to(torch.float64) + 0.5) * scale for word in (a, b, c))
    return torch.sqrt(-2.0 * torch.log(first)) * torch.cos(2.0 * math.pi * second), third


# --- one primitive -------------------------------------------------------------------------


def step(layout: Layout, tables: Tables, state: TensorState, action: Tensor) -> TensorTransition:
    """Apply one primitive, an integer (rooms,), in every room. Pure; an action outside the table has no effect."""
    scale = None
    if layout.dynamics.is_random:
        normal, uniform = compute_noise(state.noise_key, state.primitives)
        scale = 1.0 + layout.dynamics.noise * normal
        action = _slide(layout, tables, state, action, scale, uniform) if layout.dynamics.slip else action
    moved = _translate(layout, tables, state, action, scale)
    moved = _move_joints(layout, _turn(layout, tables, moved, action, scale), action, scale)
    return _complete_motion(layout, tables, state, moved, _find_grip(layout, action))


def drive_base(layout: Layout, tables: Tables, state: TensorState, action: Tensor) -> TensorState:
    """Return the states after base primitives (rooms,) without noise or slips, with contacts at the new pose. Pure."""
    moved = _turn(layout, tables, _translate(layout, tables, state, action, None), action, None)
    return moved._replace(touching=compute_touching(layout, tables, moved))


def _slide(layout: Layout, tables: Tables, state: TensorState, action: Tensor, scale: Tensor, uniform: Tensor
           ) -> Tensor:
    """Actions after slips, integers (rooms,); -1 if a slip has no effect."""
    dynamics, moves = layout.dynamics, layout.actions.translations
    slips = uniform < dynamics.slip
    if dynamics.slip_kind == "stay":
        return torch.where(slips, -1, action)
    slips = slips & (action >= 0) & (action < len(moves))
    share = uniform / dynamics.slip
    if dynamics.slip_kind == "neighbour":
        free = torch.stack([_is_free(layout, tables, state, torch.full_like(action, move), scale) for move in moves])
        count = free.sum(0)
        number = torch.minimum((share * count).to(torch.int64), count - 1)
        chosen = free & (free.to(torch.int64).cumsum(0) == number + 1)
        taken = (chosen.to(torch.int64) * torch.arange(len(moves), device=action.device).unsqueeze(1)).sum(0)
        return torch.where(slips & (count > 0), taken, action)
    slipped = [list_slips(dynamics.slip_kind, layout.actions, move) or (move,) for move in moves]
    most, chosen = max(map(len, slipped)), action.clamp(0, len(moves) - 1)
    others = torch.tensor([(*to, *to[:1] * (most - len(to))) for to in slipped], device=action.device)
    count = torch.tensor([len(to) for to in slipped], device=action.device)[chosen]
    taken = others[chosen, torch.minimum((share * count).to(torch.int64), count - 1)]
    if dynamics.slip_kind == "lateral-if-free":
        slips = slips & _is_free(layout, tables, state, action, scale)
    return torch.where(slips, taken, action)


def _find_grip(layout: Layout, action: Tensor) -> Tensor:
    """1 if an action grips, -1 if it releases, 2 if it uses, otherwise 0, int64 (rooms,)."""
    grip = torch.zeros_like(action)
    for number in layout.actions.gripper:
        grip = grip + layout.actions.primitives[number].grip * (action == number).to(grip.dtype)
    return grip


def _find_effects(layout: Layout, action: Tensor, name: str, unit: Tensor) -> Tensor:
    """One field of the chosen base primitives (`forward`, `left` or `turn`) in units (rooms,); 0 for joint steps."""
    found = torch.zeros_like(unit)
    for number in layout.actions.base:
        effect = getattr(layout.actions.primitives[number], name)
        if effect:
            found = torch.where(action == number, effect * unit, found)
    return found.expand(action.shape)


def _translate(layout: Layout, tables: Tables, state: TensorState, action: Tensor,
               scale: Tensor | None) -> TensorState:
    dx, dy = _compute_displacement(layout, tables, state, action, scale)
    pushed = _push(layout, tables, state, dx, dy) if layout.can_push else state
    free = _find_free_fraction(layout, tables, pushed, dx, dy)
    puzzle = torch.where(free > 0.0, pushed.puzzle, state.puzzle) if layout.can_push else state.puzzle
    return state._replace(x=state.x + free * dx, y=state.y + free * dy, puzzle=puzzle)


def _push(layout: Layout, tables: Tables, state: TensorState, dx: Tensor, dy: Tensor) -> TensorState:
    """States after moves have pushed the things in their way, if these can be pushed."""
    ahead, beyond = (_find_at(layout, tables, state, state.x + n * dx, state.y + n * dy) for n in (1.0, 2.0))
    is_shut = find_shut(layout, tables, state).gather(0, ahead.clamp(min=0).unsqueeze(0)).squeeze(0)
    pushes = ((dx != 0.0) | (dy != 0.0)) & (ahead >= 0) & is_shut
    none = torch.zeros_like(state.touching)
    contacts = TensorContacts(none, torch.zeros_like(state.x), none, PUSH * pushes.to(none.dtype), pushes, state.x,
                              state.y, ahead, beyond)
    form, columns = pick_rules(layout, tables, state.instance)
    return state._replace(puzzle=form.update(columns, state.puzzle, contacts, layout.targets))


def _compute_displacement(layout: Layout, tables: Tables, state: TensorState, action: Tensor, scale: Tensor | None
                          ) -> tuple[Tensor, Tensor]:
    """Displacements before any contact, m, float64 (rooms,) each."""
    unit = state.x.new_ones(()) if scale is None else scale
    forward, left = (_find_effects(layout, action, name, unit) for name in ("forward", "left"))
    cos, sin = compute_rotation(layout, tables, state)
    return store(forward * cos - left * sin), store(forward * sin + left * cos)


def _is_free(layout: Layout, tables: Tables, state: TensorState, action: Tensor, scale: Tensor) -> Tensor:
    """Return whether a translation is free, bool (rooms,)."""
    dx, dy = _compute_displacement(layout, tables, state, action, scale)
    return _find_free_fraction(layout, tables, state, dx, dy) >= 1.0


def _find_free_fraction(layout: Layout, tables: Tables, state: TensorState, dx: Tensor, dy: Tensor) -> Tensor:
    """Fraction in [0, 1] of displacements, float64 (rooms,): up to the first contact, or all or nothing."""
    free = _find_contact(layout, tables, state, dx, dy)
    return (free >= 1.0).to(torch.float64) if layout.dynamics.blocked == "stay" else free


def _find_contact(layout: Layout, tables: Tables, state: TensorState, dx: Tensor, dy: Tensor) -> Tensor:
    """Fraction in [0, 1] of displacements before the first contact, float64 (rooms,).

    Velocities have arbitrary directions, and a body may graze a solid: all contacts are then found in double precision.
    """
    base = place_base(layout, tables, state, CONTACT_SKIN)
    solids = RoomSolids(tables.solids, tables.split_solids, None if layout.is_shared else state.instance)
    if layout.velocities is None:
        free = base.find_free_fraction(dx, dy, solids)
    else:
        free = base.compute_first_contact(dx, dy, solids.list_all()).amin(0)
    if layout.inner_doors:
        inner: Shapes = pick(layout, tables.inner_doors, state.instance)
        is_shut = find_shut(layout, tables, state) & ~base.stands_in(inner)
        free = torch.minimum(free, torch.where(is_shut, base.compute_first_contact(dx, dy, inner), 1.0).amin(0))
    if layout.has_door:
        doors, is_shut = _find_door(layout, tables, state, base)
        free = torch.where(is_shut, torch.minimum(free, base.compute_first_contact(dx, dy, doors)[0]), free)
    return free


def _find_door(layout: Layout, tables: Tables, state: TensorState, base: TensorBase) -> tuple[Shapes, Tensor]:
    """Exit doors, (1, rooms), and whether they are shut, bool (rooms,). They do not block a robot in the doorway."""
    doors: Shapes = pick(layout, tables.doors, state.instance)
    form, columns = pick_rules(layout, tables, state.instance)
    is_open = form.is_solved(columns, state.puzzle)
    return doors, ~(is_open | base.stands_in(doors)[0])


def _turn(layout: Layout, tables: Tables, state: TensorState, action: Tensor, scale: Tensor | None) -> TensorState:
    """Turn the base if the turn is free."""
    angle = math.tau / layout.headings * (state.x.new_ones(()) if scale is None else scale)
    return _take_turn(layout, tables, state, _turn_freely(layout, state, action, scale),
                      _find_effects(layout, action, "turn", angle))


def _take_turn(layout: Layout, tables: Tables, state: TensorState, turned: TensorState, angle: Tensor) -> TensorState:
    """States with the base turned by an angle in rad, float64 (rooms,), if the turn is free."""
    if layout.robot.base.turns_anywhere:
        return turned
    base, to = place_base(layout, tables, state, CONTACT_SKIN), compute_rotation(layout, tables, turned)
    is_blocked = base.is_turn_blocked(*to, angle, pick(layout, tables.solids, state.instance)).any(0)
    if layout.has_door:
        doors, is_shut = _find_door(layout, tables, state, base)
        is_blocked = is_blocked | (is_shut & base.is_turn_blocked(*to, angle, doors)[0])
    return turned._replace(heading_steps=torch.where(is_blocked, state.heading_steps, turned.heading_steps),
                           heading_offset=torch.where(is_blocked, state.heading_offset, turned.heading_offset))


def _turn_freely(layout: Layout, state: TensorState, action: Tensor, scale: Tensor | None) -> TensorState:
    turn = _find_effects(layout, action, "turn", state.heading_steps.new_ones(()))
    steps = state.heading_steps + turn
    steps = torch.where(steps < 0, steps + layout.headings, steps)
    steps = torch.where(steps >= layout.headings, steps - layout.headings, steps)
    if scale is None:
        return state._replace(heading_steps=steps)
    offset = state.heading_offset + (scale - 1.0) * turn * (math.tau / layout.headings)
    offset = torch.where(turn == 0, state.heading_offset, torch.remainder(offset + math.pi, math.tau) - math.pi)
    return state._replace(heading_steps=steps, heading_offset=offset)


def _move_joints(layout: Layout, state: TensorState, action: Tensor, scale: Tensor | None) -> TensorState:
    joints = layout.robot.joints
    if not joints:
        return state
    arm = layout.arm
    up, down = (make_joint_column(numbers, action) for numbers in zip(*layout.actions.joints, strict=True))
    change = (action == up).to(torch.int32) - (action == down).to(torch.int32)  # (joints, rooms)
    steps = state.joint_steps + change
    if scale is None or not layout.has_joint_offsets:
        low, high = (make_joint_column(ends, steps) for ends in (arm.step_low, arm.step_high))
        return state._replace(joint_steps=store(torch.minimum(torch.maximum(steps, low), high)))
    offsets = state.joint_offsets + (scale - 1.0) * change * arm.step
    angles = compute_angles(layout, state._replace(joint_steps=steps, joint_offsets=offsets))
    low = make_joint_column([low - 1e-9 for low, _ in arm.limits], angles)
    high = make_joint_column([high + 1e-9 for _, high in arm.limits], angles)
    is_allowed = (angles >= low) & (angles <= high)
    return state._replace(joint_steps=torch.where(is_allowed, steps, state.joint_steps),
                          joint_offsets=torch.where(is_allowed, offsets, state.joint_offsets))


def _complete_motion(layout: Layout, tables: Tables, before: TensorState, moved: TensorState, grip: Tensor
                    ) -> TensorTransition:
    """Complete a motion: presses, puzzle, reward, exit and horizon."""
    form, columns = pick_rules(layout, tables, before.instance)
    touching = compute_touching(layout, tables, moved)
    pressed = touching & ~before.touching
    chance = torch.zeros_like(before.x)
    if layout.is_puzzle_random:
        word, *_ = draw_words(before.noise_key, before.primitives.to(torch.int64), CHANCE_PURPOSE)
        chance = (word.to(torch.float64) + 0.5) / 2**32
    has_moved = (moved.x != before.x) | (moved.y != before.y)
    contacts = TensorContacts(pressed, chance, touching, grip, has_moved, moved.x, moved.y,
                              _find_ahead(layout, tables, moved), torch.full_like(touching, -1))
    puzzle = form.update(columns, moved.puzzle, contacts, layout.targets)
    primitives = before.primitives + 1
    escaped = is_in_exit(layout, tables, moved.instance, moved.x, moved.y) & form.is_solved(columns, puzzle)
    failed = form.is_failed(columns, puzzle)
    more = form.compute_reward(columns, before.puzzle, puzzle, contacts, layout.targets)
    is_told = torch.ones_like(escaped) if layout.is_watching else (pressed != 0) | (grip != 0)
    is_told = is_told | (moved.puzzle != before.puzzle) if layout.can_push else is_told
    terminated = escaped if failed is None else escaped | (failed & is_told)
    truncated = ~terminated & (primitives >= pick(layout, tables.horizons, before.instance)[0])
    each, final = pick(layout, tables.rewards, before.instance)
    state = moved._replace(puzzle=puzzle, touching=touching, primitives=primitives,
                           has_ended=(terminated | truncated).to(torch.int32))
    reward = torch.where(escaped, final, each)
    reward = reward if more is None else (reward + torch.where(is_told, more, 0.0)).to(torch.float32)
    if layout.reward is not None:
        reward = (reward + _compute_extra(layout, tables, before, state, pressed, escaped,
                                          terminated & ~escaped)).to(torch.float32)
    return TensorTransition(state, reward, terminated, truncated, pressed, escaped)


def _compute_extra(layout: Layout, tables: Tables, before: TensorState, after: TensorState, pressed: Tensor,
                   escaped: Tensor, failed: Tensor) -> Tensor:
    """Rewards of the layout's kind in addition to steps and exits, (rooms,)."""
    assert layout.reward is not None
    form, columns = pick_rules(layout, tables, after.instance)
    was_lit, is_lit = (form.get_lit(columns, state.puzzle) for state in (before, after))
    none = torch.zeros_like(pressed)
    was_shut, is_shut = ((pack_bits(find_shut(layout, tables, state)) for state in (before, after))
                         if layout.inner_doors else (none, none))
    events = Events(pressed, is_lit & ~was_lit, was_lit & ~is_lit, was_shut & ~is_shut, is_shut & ~was_shut, escaped,
                    failed)
    count = pick(layout, tables.target_counts, after.instance)[0].clamp(min=1)

    def show(state: TensorState, lit: Tensor) -> RewardState:
        return RewardState(state.x, state.y, state.heading_steps,
                           unpack_bits(lit, layout.targets, torch.float64).sum(0) / count,
                           form.is_solved(columns, state.puzzle))

    return layout.reward.compute_extra(show(before, was_lit), show(after, is_lit), events)


def find_shut(layout: Layout, tables: Tables, state: TensorState) -> Tensor:
    """Return whether each inner door is shut, bool (inner doors, rooms)."""
    form, columns = pick_rules(layout, tables, state.instance)
    return form.find_shut(columns, state.puzzle, layout.inner_doors)


def _find_ahead(layout: Layout, tables: Tables, state: TensorState) -> Tensor:
    """Index of the inner door one move ahead, -1 for none, int64 (rooms,)."""
    if not layout.inner_doors:
        return torch.full_like(state.touching, -1)
    cos, sin = compute_rotation(layout, tables, state)
    step = layout.actions.stride
    return _find_at(layout, tables, state, state.x + step * cos, state.y + step * sin)


def _find_at(layout: Layout, tables: Tables, state: TensorState, x: Tensor, y: Tensor) -> Tensor:
    """Index of the inner door at each place, -1 for none, int64 (rooms,)."""
    inner: Shapes = pick(layout, tables.inner_doors, state.instance)
    is_there = compute_distance(x, y, inner) == 0.0
    return torch.where(is_there.any(0), is_there.to(torch.int8).argmax(0), -1)


def is_in_exit(layout: Layout, tables: Tables, instance: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Return whether a place is inside the exit, bool (rooms,)."""
    x_min, x_max, y_min, y_max = pick(layout, tables.exits, instance)
    margin = torch.minimum(torch.minimum(x - x_min, x_max - x), torch.minimum(y - y_min, y_max - y))
    return as_flags(margin >= 0.0)


# --- velocities ----------------------------------------------------------------------------


def glide(layout: Layout, tables: Tables, state: TensorState, rates: Tensor) -> TensorTransition:
    """Move every room for one time step. Pure.

    Args:
        layout: layout of the batch, with the `velocities`.
        tables: tables of the batch.
        state: states of the rooms.
        rates: velocities and levels, float64 (rooms, numbers), clipped to their bounds; NaN counts as 0.
    """
    kind = layout.velocities
    assert kind is not None
    bounds = torch.tensor(kind.list_bounds(layout.robot), dtype=rates.dtype, device=rates.device)
    rates = torch.nan_to_num(rates, 0.0)
    rates = torch.minimum(torch.maximum(rates, -bounds), bounds)
    count = len(bounds) - count_levels(layout.robot)
    change, grip = (rates[:, :count] * kind.time_step).unbind(1), _find_asked(state, rates[:, count:].unbind(1))
    forward, turn, joints = change[0], change[-1 - layout.robot.joints], change[count - layout.robot.joints :]
    cos, sin = compute_rotation(layout, tables, state)
    middle = compute_heading(layout, tables, state) + turn / 2.0
    cos, sin = torch.where(turn == 0.0, cos, torch.cos(middle)), torch.where(turn == 0.0, sin, torch.sin(middle))
    left = change[1] if layout.robot.drive == "strafing" else torch.zeros_like(forward)
    dx, dy = forward * cos - left * sin, forward * sin + left * cos
    scale = None
    if layout.dynamics.is_random:
        normal, uniform = compute_noise(state.noise_key, state.primitives)
        slips = uniform < layout.dynamics.slip
        scale = torch.where(slips, 0.0, 1.0 + layout.dynamics.noise * normal)
        dx, dy, turn, grip = scale * dx, scale * dy, scale * turn, torch.where(slips, 0, grip)
    moved = _advance(layout, tables, state, store(dx), store(dy))
    moved = _take_turn(layout, tables, moved, _turn_smoothly(layout, moved, turn), turn)
    moved = _bend(layout, moved, joints, scale) if joints else moved
    return _complete_motion(layout, tables, state, moved, grip)


def _find_asked(state: TensorState, levels: Sequence[Tensor]) -> Tensor:
    """The act that levels of gripper and use, (rooms,) each, request, as in `find_grip`, int64 (rooms,)."""
    asked = torch.zeros_like(state.touching)
    if len(levels) > 1:
        asked = torch.where(levels[1] > GRIPPER_LEVEL, USE, asked)
    if levels:
        asked = torch.where(levels[0].abs() > GRIPPER_LEVEL, torch.sign(levels[0]).to(asked.dtype), asked)
    return asked


def _advance(layout: Layout, tables: Tables, state: TensorState, dx: Tensor, dy: Tensor) -> TensorState:
    """States after the free part of displacements. Things in the way are pushed if that frees the whole way."""
    if not layout.can_push:
        free = _find_free_fraction(layout, tables, state, dx, dy)
        return state._replace(x=state.x + free * dx, y=state.y + free * dy)
    reached, stride = _find_contact(layout, tables, state, dx, dy), torch.full_like(dx, layout.actions.stride)
    there, is_along = state._replace(x=state.x + reached * dx, y=state.y + reached * dy), dx.abs() >= dy.abs()
    pushed = _push(layout, tables, there, torch.where(is_along, torch.copysign(stride, dx), 0.0),
                   torch.where(is_along, 0.0, torch.copysign(stride, dy)))
    is_free = reached >= 1.0
    freed = state._replace(puzzle=torch.where(is_free, state.puzzle, pushed.puzzle))
    moves = is_free | (_find_contact(layout, tables, freed, dx, dy) >= 1.0)
    return state._replace(x=torch.where(moves, state.x + dx, state.x), y=torch.where(moves, state.y + dy, state.y),
                          puzzle=torch.where(moves, freed.puzzle, state.puzzle))


def _turn_smoothly(layout: Layout, state: TensorState, turn: Tensor) -> TensorState:
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
    """States whose joints have moved by angles in rad, float64 (rooms,) each, up to their limits."""
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


# --- episodes ------------------------------------------------------------------------------


def restart(layout: Layout, tables: Tables, state: TensorState, where: Tensor) -> TensorState:
    """Begin a new episode in the rooms of a mask, bool (rooms,), from the rooms' random streams."""
    episode = state.episode + 1
    instance, noise_key = state.instance, state.noise_key
    chosen = torch.zeros_like(instance)
    if layout.draws:
        first, second, third, fourth = draw_words(state.seed, episode.to(torch.int64))
        if layout.resample:
            instance = scale_word(fourth, tables.total)
        chosen = scale_word(first, pick(layout, tables.start_counts, instance)[0])
        noise_key = ((second << 32) | third) & (2**63 - 1)
    column = pick_column(layout, instance)
    begun = torch.zeros_like(instance)
    if len(tables.puzzle_starts) > 1:
        begun = draw_puzzle_start(noise_key, pick(layout, tables.puzzle_start_counts, instance)[0])
    x, y, offset = tables.starts[:, chosen, column]
    offset = offset if layout.has_offsets else state.heading_offset  # zero, like the offsets of the joints
    joint_offsets = torch.zeros_like(state.joint_offsets) if layout.has_joint_offsets else state.joint_offsets
    joint_steps = torch.zeros_like(state.joint_steps) if layout.robot.joints else state.joint_steps
    fresh = state._replace(
        x=x, y=y, heading_steps=tables.start_headings[chosen, column], heading_offset=offset,
        joint_steps=joint_steps, joint_offsets=joint_offsets,
        puzzle=tables.puzzle_starts[begun, column],
        touching=tables.start_touching[chosen, column], primitives=torch.zeros_like(state.primitives),
        noise_key=noise_key, instance=instance, episode=episode, has_ended=torch.zeros_like(state.has_ended),
    )
    pairs = zip(fresh, state, strict=True)
    return TensorState(*(old if new is old else torch.where(where, new, old) for new, old in pairs))


def begin(layout: Layout, tables: Tables, seed: Tensor, instance: Tensor) -> TensorState:
    """Seed every room and begin its first episode, in a random instance if the layout resamples."""
    rooms, device = len(seed), seed.device
    numbers = torch.zeros(rooms, dtype=torch.float64, device=device)
    steps = torch.zeros(rooms, dtype=torch.int32, device=device)
    words = torch.zeros(rooms, dtype=torch.int64, device=device)
    joints = (layout.robot.joints, rooms)
    state = TensorState(
        x=numbers, y=numbers, heading_steps=steps, heading_offset=numbers,
        joint_steps=steps.new_zeros(joints), joint_offsets=numbers.new_zeros(joints),
        puzzle=words, touching=words, primitives=steps, noise_key=words, instance=instance, seed=seed,
        episode=steps - 1, has_ended=steps + 1,
    )
    return restart(layout, tables, state, state.has_ended != 0)
