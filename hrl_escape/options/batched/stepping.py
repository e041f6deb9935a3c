"""One primitive in every room of a batch, with the decisions that begin and end there: pure functions of tensors.

The loop of `OptionsEnv.step`, turned inside out for many rooms, by the batched engine's rules. An option's policy is
greedy: the primitive that leads to the least cost-to-go. Moves are swept exactly, with walls and press margins; the
cost-to-go of their ends is interpolated (`cost_to_go.py`). Where fields mislead, stored costs of the last cells prevent
circles (learning real-time A*, Korf 1990).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from hrl_escape.env.batched.observations import observe
from hrl_escape.env.batched.poses import TensorState
from hrl_escape.env.batched.rules import find_shut, is_in_exit, restart, step
from hrl_escape.env.batched.tables import Layout, Tables, map_tensors, pick
from hrl_escape.env.noise import MASK, philox
from hrl_escape.env.observations.base import BatchObservation
from hrl_escape.env.tensor_geometry import wrap
from hrl_escape.names import number_options
from hrl_escape.options.batched.aims import Aims, find_possible, has_acted, read_acts, read_targets
from hrl_escape.options.batched.cost_to_go import (
    OTHER_PRESS_COST,
    CostFields,
    classify_headings,
    interpolate_cost,
    locate,
)
from hrl_escape.options.batched.hand_policy import CHOSEN, Reach, estimate_arm_costs, estimate_hand_costs, find_reach
from hrl_escape.options.batched.successors import (
    MoveEnds,
    find_ends,
    is_in_doorway,
    is_solved,
    make_column,
    presses_by_hand,
    repeat_rooms,
)
from hrl_escape.options.batched.value_iteration import UNREACHABLE
from hrl_escape.options.degraded import FAILURE, STOP, OptionDegradation
from hrl_escape.step_info import ENDINGS

PLAN_LENGTH = 64
"""Longest plan that a room keeps, primitives."""
ORDER_LENGTH = 16
"""Most goals of one option that a room keeps; it asks for the rest of a longer order once these are reached."""
NOT_ASKED = -1
"""Placeholder for a goal that the planner must still choose: the next one of an option that presses ancestors first."""
PLAN_AFTER = 4
"""Primitives without progress before an option follows a plan instead of its field."""
FAIL_AFTER = 120
"""Primitives without progress before it fails; more where primitives slip."""
_OF_GOAL = ("age", "postures", "least", "stalled", "cells", "costs", "plan_left")
_OF_RUN = (*_OF_GOAL, "option", "run", "goal", "order_left")
_UNREAD = ("plan", "order")  # unchanged while nothing of them is left
REACHED, TIMEOUT, EPISODE_OVER, FAILED, INTERRUPTED = range(len(ENDINGS))


class Transitions(NamedTuple):
    """SMDP transitions that ended with the last primitive; rows count only where `where` is true."""

    where: Tensor  # rooms whose decision ended, bool (rooms,)
    observation: Tensor  # observation at the start of the decision, float32 (rooms, numbers)
    action: Tensor  # the action chosen, int64 (rooms,)
    reward: Tensor  # sum of the primitive rewards, float32 (rooms,)
    discounted_reward: Tensor  # sum over i < k of gamma^i r_i, float32 (rooms,)
    duration: Tensor  # k >= 1, primitives that ran, int32 (rooms,)
    discount: Tensor  # gamma^k, float32 (rooms,)
    next_observation: Tensor  # observation at its end, before any automatic reset
    next_action_mask: Tensor  # the actions legal there, bool (rooms, actions)
    terminated: Tensor  # the robot escaped, or the puzzle was failed, bool (rooms,)
    truncated: Tensor  # the horizon was reached, bool (rooms,); bootstrap from the state reached
    success: Tensor  # the robot escaped, bool (rooms,)
    ended: Tensor  # its ending, an index into `ENDINGS`, int8 (rooms,)
    pressed: Tensor  # bit i is set if target i was pressed by any of the k primitives, int64 (rooms,)
    primitives: Tensor  # primitives of the episode so far, int32 (rooms,)


class OpenDecisions(NamedTuple):
    """Decisions in progress; every field is (rooms,) unless stated."""

    action: Tensor  # the action chosen, int64; -1 where a room waits for one
    observation: Tensor  # observation at its start, float32 (rooms, numbers)
    reward: Tensor  # sum of primitive rewards so far, float32
    discounted_reward: Tensor  # their discounted sum, float32
    discount: Tensor  # gamma to the power of the duration so far, float32
    duration: Tensor  # primitives so far, int32
    pressed: Tensor  # bits of the targets pressed so far, int64
    option: Tensor  # action of the option that runs, or was interrupted and can be continued, int64; -1 for none
    run: Tensor  # primitives of its run so far, interruptions included, int32
    goal: Tensor  # number of the option that it carries out now, itself or a part, or `NOT_ASKED`, int64
    age: Tensor  # primitives since it took up this goal, int32
    postures: Tensor  # candidate postures for a press by hand, int64 (`CHOSEN`, rooms)
    order: Tensor  # goals to follow, or `NOT_ASKED` to ask again, aligned to the end, int16 (`ORDER_LENGTH`, rooms)
    order_left: Tensor  # number of goals left in `order`, int32
    least: Tensor  # lowest cost-to-go that the option has met, float32
    stalled: Tensor  # primitives since then, int32
    cells: Tensor  # cells of the last choices, int64 (memory, rooms)
    costs: Tensor  # cost-to-go found there, float32 (memory, rooms)
    plan: Tensor
    """Primitives to follow where the field made no progress, aligned to the end, int8 (`PLAN_LENGTH`, rooms)."""
    plan_left: Tensor  # primitives of the plan still to run, int32


class StepSettings(NamedTuple):
    """Constants of a compiled kernel in addition to the layout."""

    observation: BatchObservation  # what agents see
    primitives: int  # primitives that are actions
    options: int  # options that are actions, the exit's last
    gamma: float  # discount per primitive
    fail_after: int  # primitives without progress before an option fails
    max_duration: int  # maximum primitives of an option
    autoreset: bool  # begin the next episode as one ends
    interruptible: bool  # ask the agent again after every primitive of an option
    has_ancestors: bool  # options carry out the ancestors of their goal first
    degradation: OptionDegradation  # degradation of the options


class AgentView(NamedTuple):
    """Present input of an agent: observation float32 (rooms, numbers), and legal actions bool (rooms, actions)."""

    observation: Tensor
    mask: Tensor


def find_startable(layout: Layout, tables: Tables, aims: Aims, state: TensorState, settings: StepSettings) -> Tensor:
    """Find the options that may start, bool (rooms, options)."""
    can = can_start(layout, tables, aims, state, settings.has_ancestors)
    if not settings.degradation.missing:
        return can
    keys = number_options(settings.options)
    return can & torch.tensor([not settings.degradation.lacks(key) for key in keys], device=can.device)


def make_view(layout: Layout, tables: Tables, aims: Aims, state: TensorState, settings: StepSettings,
              option: Tensor | None = None) -> AgentView:
    """Observe every room and list its legal actions; an interrupted `option`, int64 (rooms,), can be continued."""
    options = find_startable(layout, tables, aims, state, settings)
    mask = torch.cat([torch.ones_like(options[:, :1]).expand(-1, settings.primitives), options], dim=1)
    if option is not None and settings.interruptible:
        mask = mask | (torch.arange(mask.shape[1], device=mask.device) == option.unsqueeze(1))
    mask = mask | ~mask.any(dim=1, keepdim=True)  # nothing can start: any choice then waits one primitive
    return AgentView(observe(layout, tables, state, settings.observation).contiguous(), mask)


def step_decisions(layout: Layout, settings: StepSettings, tables: Tables, fields: CostFields,
                   state: TensorState, running: OpenDecisions, view: AgentView, action: Tensor,
                   choice: Choice | None = None, looks: bool = False
                   ) -> tuple[TensorState, OpenDecisions, AgentView, Transitions, Tensor]:
    """Run one primitive in every room, and begin and end decisions; the function that is compiled.

    Returns the primitives last, int64 (rooms,). Options choose here, unless there is a `choice`. With `looks` it begins
    episodes only where any has ended, which takes a look that neither a compiled step nor an accelerator stops for.
    """
    is_over = state.has_ended != 0
    running = begin_decisions(settings, running, (running.action < 0) & ~is_over & (action >= 0), action,
                              view.observation)
    is_over = is_over | (running.action < 0)  # waiting rooms without an action stand still as well
    is_option = running.action >= settings.primitives
    option = (running.action - settings.primitives).clamp(min=0)
    goal = running.goal.clamp(min=0)
    is_wasting = is_option & (running.run < settings.degradation.detour)
    is_new = running.run == 0
    can = find_startable(layout, tables, fields.aims, state, settings)
    fails = is_new & ~torch.gather(can, 1, option.unsqueeze(1)).squeeze(1)
    if settings.degradation.failure:
        drawn = _draw_uniform(settings, option, FAILURE, state)
        fails = fails | (is_new & (drawn < settings.degradation.failure))

    planned = _read_aligned(running.plan, running.plan_left)
    target = read_targets(layout, fields.aims, state.instance, goal)
    if choice is None:
        choice = choose_primitive(layout, tables, fields, state,
                                  Search(target, running.postures, running.cells, running.costs))
    is_lost = (running.age == 0) & (choice.cost >= UNREACHABLE)
    has_failed = is_option & (fails | (~is_wasting & (is_lost | (running.goal == NOT_ASKED))))
    primitive = torch.where(running.plan_left > 0, planned, choice.primitive)
    own = target.clamp(max=max(layout.targets - 1, 0))
    act = read_acts(layout, fields.aims, state.instance, goal) if len(fields.aims.acts) else None
    if act is not None:
        primitive = torch.where((act >= 0) & ((state.touching >> own) & 1 != 0), act, primitive)
    primitive = torch.where(is_option, primitive, running.action)
    if settings.degradation.detour:
        to, fro = layout.actions.turns[:2]
        primitive = torch.where(is_wasting, torch.where(running.run % 2 == 0, to, fro), primitive)
    primitive = torch.where(has_failed, layout.actions.wait, primitive)
    running = _watch_progress(running, choice, is_wasting)

    after, reward, terminated, truncated, pressed, escaped = step(layout, tables, state, primitive)
    after = TensorState(*(torch.where(is_over, old, new) for old, new in zip(state, after, strict=True)))
    running = running._replace(
        reward=running.reward + reward, discounted_reward=running.discounted_reward + running.discount * reward,
        discount=running.discount * settings.gamma, duration=running.duration + 1, pressed=running.pressed | pressed,
        run=running.run + 1,
    )
    is_there = torch.where(target < layout.targets, (pressed >> own) & 1 != 0,
                           is_in_exit(layout, tables, after.instance, after.x, after.y))
    if act is not None:
        has_done = (primitive == act) & has_acted(layout, fields.aims, goal, state, after)
        is_there = torch.where(act < 0, is_there, has_done)
    is_there = is_there & ~is_wasting
    is_done = is_there & (running.order_left == 0)
    if settings.degradation.early_stop:
        # an option asks after each primitive of its own; one of several parts, after each part
        drawn = _draw_uniform(settings, option, STOP, after)
        has_parts = settings.has_ancestors & (option < settings.options - 1)
        is_done = is_done | ((drawn < settings.degradation.early_stop) & (is_wasting | is_there | ~has_parts))

    has_ended = (terminated | truncated) & ~is_over
    ended = torch.where(is_option, INTERRUPTED if settings.interruptible else -1, REACHED)
    ended = torch.where(is_option & (running.stalled > settings.fail_after), FAILED, ended)
    ended = torch.where(running.run >= settings.max_duration, TIMEOUT, ended)
    ended = torch.where(has_ended, EPISODE_OVER, ended)
    ended = torch.where(is_done | ~is_option, REACHED, ended)
    ended = torch.where(has_failed, FAILED, ended)
    where = (ended >= 0) & ~is_over
    is_left = where & (ended != INTERRUPTED)
    running = running._replace(option=torch.where(is_left, -1, running.option))
    if settings.has_ancestors:
        running = _take_next_goal(running, is_there & ~is_left & ~is_over)

    final = make_view(layout, tables, fields.aims, after, settings, running.option)
    decisions = Transitions(
        where, running.observation, running.action, running.reward, running.discounted_reward, running.duration,
        running.discount, final.observation, final.mask, terminated & ~is_over, truncated & ~is_over,
        escaped & ~is_over, ended.to(torch.int8), running.pressed, after.primitives,
    )
    if settings.autoreset and not (looks and not has_ended.any()):
        after = restart(layout, tables, after, has_ended)
        final = make_view(layout, tables, fields.aims, after, settings, running.option)
    return after, running._replace(action=torch.where(where, -1, running.action)), final, decisions, primitive


def _watch_progress(running: OpenDecisions, choice: Choice, is_wasting: Tensor) -> OpenDecisions:
    """Remember the choice's cell and cost, and count primitives without progress."""
    is_nearer = choice.cost < running.least - 0.5
    slot = torch.arange(MEMORY, device=is_nearer.device).unsqueeze(1) == wrap(running.age, MEMORY)
    slot = slot & ~is_wasting
    return running._replace(
        least=torch.where(is_wasting, running.least, torch.minimum(running.least, choice.cost)),
        stalled=torch.where(is_nearer | is_wasting, 0, running.stalled + 1),
        age=torch.where(is_wasting, running.age, running.age + 1),
        plan_left=(running.plan_left - 1).clamp(min=0),
        cells=torch.where(slot, choice.cell, running.cells), costs=torch.where(slot, choice.cost, running.costs),
    )


def _take_next_goal(running: OpenDecisions, where: Tensor) -> OpenDecisions:
    """Take up the next goal of the order in some rooms, bool (rooms,), with the memory of the last one cleared."""
    following = _read_aligned(running.order, running.order_left)
    return forget_progress(running, where)._replace(goal=torch.where(where, following, running.goal),
                                                    order_left=running.order_left - where.to(torch.int32))


def forget_progress(running: OpenDecisions, where: Tensor) -> OpenDecisions:
    """Clear the memory of how near to their goals some rooms, bool (rooms,), have come."""
    fresh = make_decisions(running.observation)
    return running._replace(**{name: torch.where(where, getattr(fresh, name), getattr(running, name))
                               for name in _OF_GOAL})


def _read_aligned(rows: Tensor, left: Tensor) -> Tensor:
    """Next entry of lists aligned to the end, int64 (rooms,); arbitrary where nothing is left."""
    at = (len(rows) - left).clamp(max=len(rows) - 1).to(torch.int64)
    return torch.gather(rows, 0, at.unsqueeze(0))[0].to(torch.int64)


def begin_decisions(settings: StepSettings, running: OpenDecisions, where: Tensor, action: Tensor,
                    observation: Tensor) -> OpenDecisions:
    """Begin decisions in the rooms of `where`, bool (rooms,), for given actions; an interrupted option continues."""
    option = torch.where(action >= settings.primitives, action, -1)
    goal = action - settings.primitives
    if settings.has_ancestors:
        goal = torch.where(goal < settings.options - 1, NOT_ASKED, goal)
    fresh = make_decisions(observation)._replace(action=action, option=option, goal=goal)
    is_new_run = where & ((option < 0) | (option != running.option))
    return OpenDecisions(*(
        old if name in _UNREAD else
        torch.where(is_new_run if name in _OF_RUN else where.unsqueeze(1) if new is observation else where, new, old)
        for name, new, old in zip(OpenDecisions._fields, fresh, running, strict=True)))


def begin_some(settings: StepSettings, running: OpenDecisions, rooms: Tensor, action: Tensor, observation: Tensor
               ) -> OpenDecisions:
    """Begin decisions in the rooms numbered `rooms`, int64 (some,), alone; see `begin_decisions`."""
    if not len(rooms):
        return running
    some = OpenDecisions(*(field[rooms] if name == "observation" else field[..., rooms]
                           for name, field in running._asdict().items()))
    begun = begin_decisions(settings, some, torch.ones_like(rooms, dtype=torch.bool), action[rooms], observation[rooms])
    return OpenDecisions(*(old if name in _UNREAD else old.index_copy(0 if name == "observation" else -1, rooms, new)
                           for name, old, new in zip(OpenDecisions._fields, running, begun, strict=True)))


def make_decisions(observation: Tensor) -> OpenDecisions:
    """Make the empty decisions of rooms."""
    number = observation.new_zeros(len(observation))
    count, word = number.to(torch.int32), number.to(torch.int64)
    return OpenDecisions(
        action=word - 1, observation=observation, reward=number, discounted_reward=number, discount=number + 1.0,
        duration=count, pressed=word, option=word - 1, run=count, goal=word, age=count,
        postures=word.expand(CHOSEN, -1).clone(),
        order=count.to(torch.int16).expand(ORDER_LENGTH, -1).clone(), order_left=count,
        least=number + math.inf, stalled=count,
        cells=word.expand(MEMORY, -1) - 1, costs=number.expand(MEMORY, -1).clone(),
        plan=count.to(torch.int8).expand(PLAN_LENGTH, -1).clone(), plan_left=count,
    )


def _draw_uniform(settings: StepSettings, option: Tensor, purpose: int, state: TensorState) -> Tensor:
    """Uniform numbers in (0, 1) for `FAILURE` or `STOP` at the present primitives, float64 (rooms,), as `OptionsEnv`'s.

    `option` is the number of each room's option, int64 (rooms,).
    """
    keys = [settings.degradation.make_key(key) for key in number_options(settings.options)]
    keys = torch.tensor(keys, device=option.device)[option]
    episode, primitive = state.noise_key, state.primitives.to(torch.int64)
    word, *_ = philox((primitive & MASK, torch.full_like(episode, purpose), episode & MASK, (episode >> 32) & MASK),
                      (keys[:, 0], keys[:, 1]))
    return (word.to(torch.float64) + 0.5) / 2**32


# --- the greedy policy ----------------------------------------------------------------------

MEMORY = 8
"""Number of recent cells with stored costs, per room."""
_FINE_HEADINGS = 16  # robots with coarser turns look two primitives ahead: fields are less precise for them


class Search(NamedTuple):
    """Goal of every room's option, and what it has found on its way there."""

    goal: Tensor  # target to press, or the number of targets for the exit, int64 (rooms,)
    postures: Tensor  # postures that a hand may press in, int64 (`CHOSEN`, rooms)
    cells: Tensor  # cells of the last choices, int64 (memory, rooms)
    costs: Tensor  # cost-to-go found there, float32 (memory, rooms)


class Choice(NamedTuple):
    """Next primitive of the options; all fields (rooms,)."""

    primitive: Tensor  # int64
    cost: Tensor  # cost-to-go, this primitive included, float32; `UNREACHABLE` or more without a way
    cell: Tensor  # cell and heading class of the room, int64


def can_start(layout: Layout, tables: Tables, aims: Aims, state: TensorState, has_ancestors: bool) -> Tensor:
    """Options that may start, bool (rooms, options): those at targets that the room has, and the exit.

    The exit cannot start if the robot is in it already or a shut door blocks it. Options behind shut inner doors can
    only start if ancestors come first. Otherwise a grip or release that the puzzle's state forbids cannot start.
    """
    inside = is_in_exit(layout, tables, state.instance, state.x, state.y)
    has_door = pick(layout, tables.doors, state.instance).x[0] < 1e5
    exit_ = ~inside & (~has_door | is_solved(layout, tables, state))
    counts = pick(layout, tables.target_counts, state.instance).squeeze(0).expand(len(exit_))
    can = torch.arange(layout.targets, device=exit_.device) < counts.unsqueeze(1)
    is_open = None
    if layout.inner_doors:
        shut = find_shut(layout, tables, state)  # (inner doors, rooms)
        bits = (shut.to(torch.int64) << torch.arange(len(shut), device=shut.device).unsqueeze(1)).sum(0)
        is_open = (pick(layout, tables.ways, state.instance) & bits == 0).T
        can, exit_ = can & (is_open[:, :-1] | has_ancestors), exit_ & is_open[:, -1]
    can = torch.cat([can, exit_.unsqueeze(1)], dim=1)
    if not len(aims.acts):
        return can
    targets = read_targets(layout, aims, state.instance.unsqueeze(1), torch.arange(len(aims.acts), device=can.device))
    possible = find_possible(layout, aims, state)
    if is_open is not None and has_ancestors:
        possible = possible | ~torch.gather(is_open, 1, targets)
    return torch.gather(can, 1, targets) & possible


def choose_primitive(layout: Layout, tables: Tables, fields: CostFields, state: TensorState, search: Search) -> Choice:
    """Choose every room's next primitive."""
    reach = _find_reach(layout, tables, fields, state, search)
    depth = 1 if layout.headings >= _FINE_HEADINGS else 2
    after = _estimate_costs(layout, tables, fields, state, search, reach, depth)
    if reach is not None:
        after = torch.cat([after, estimate_arm_costs(layout, tables, state, reach, search.goal < layout.targets)])
    best = after.amin(0)
    numbers = torch.arange(len(after), device=best.device).unsqueeze(1)
    primitive = torch.where(after == best, numbers, len(after)).amin(0)
    here = locate(layout, fields, state.instance, state.x, state.y)
    heading, _ = classify_headings(layout, fields, state)
    return Choice(primitive, best + 1.0, here.cell * fields.classes + heading)


def choose_some(layout: Layout, tables: Tables, fields: CostFields, state: TensorState, search: Search, rooms: Tensor
                ) -> Choice:
    """Choose the next primitives of the rooms numbered `rooms`, int64 (some,)."""
    state, search = (map_tensors(lambda field: field[..., rooms], each) for each in (state, search))
    return choose_primitive(layout, tables, fields, state, search)


def _find_reach(layout: Layout, tables: Tables, fields: CostFields, state: TensorState, search: Search
                ) -> Reach | None:
    """Presses by hand near each room's present place, or None where the base presses."""
    if not presses_by_hand(layout):
        return None
    return find_reach(layout, tables, fields, state, search.goal, search.postures)


def _estimate_costs(layout: Layout, tables: Tables, fields: CostFields, state: TensorState, search: Search,
                    reach: Reach | None, depth: int) -> Tensor:
    """Cost-to-go after each base primitive, by a look-ahead of `depth` primitives; (primitives, rooms)."""
    goal = search.goal
    instance = state.instance
    solved = is_solved(layout, tables, state)
    is_press = goal < layout.targets
    is_open = solved | is_in_doorway(layout, tables, state)
    ends = find_ends(layout, tables, state, is_open)
    x, y, touched, is_blocked = ends
    turn = make_column(layout, state, "turn", torch.int64)
    own = torch.where(is_press, 1 << goal.clamp(max=max(layout.targets - 1, 0)), 0)
    begun = touched & ~state.touching
    arrived = is_in_exit(layout, tables, instance, x, y)
    hit = torch.where(is_press, begun & own != 0, arrived)
    if depth == 1:
        place = locate(layout, fields, instance, x, y)
        heading, between = classify_headings(layout, fields, state)
        facing = wrap(heading + turn, fields.classes)
        way_out = len(fields.begins) - 1
        field = torch.where(is_press if reach is None else torch.zeros_like(is_press), 2 * goal + is_open, way_out)
        after = interpolate_cost(layout, fields, instance, field, place, facing, between)
        if reach is not None:
            press = estimate_hand_costs(layout, tables, fields, state, reach, x, y, turn, heading, between,
                                        touched & own != 0)
            after = torch.where(is_press, press, after)
        keys = place.cell * fields.classes + facing
        for cell, cost in zip(search.cells, search.costs, strict=True):
            after = torch.maximum(after, torch.where(cell == keys, cost, 0.0))
        after = after.clamp(min=1.0) + (touched & own != 0)
    else:
        after = _estimate_from_successors(layout, tables, fields, state, search, depth, ends, turn)
    after = torch.where(hit, 0.0, after) + OTHER_PRESS_COST * (begun & ~own != 0)
    after = after + UNREACHABLE * (arrived & solved & is_press)
    return torch.where(is_blocked & ~hit, 2 * UNREACHABLE, after)


def _estimate_from_successors(layout: Layout, tables: Tables, fields: CostFields, state: TensorState, search: Search,
                              depth: int, ends: MoveEnds, turn: Tensor) -> Tensor:
    """Cost-to-go after each base primitive: the cost of the best next primitive, plus one."""
    count = len(ends.x)
    headings = wrap(state.heading_steps + turn, layout.headings).to(torch.int32)
    later = repeat_rooms(state, count)._replace(x=ends.x.flatten(), y=ends.y.flatten(),
                                                heading_steps=headings.flatten(), touching=ends.touched.flatten())
    repeated = Search(search.goal.repeat(count), *(each.repeat(1, count) for each in search[1:]))
    reach = _find_reach(layout, tables, fields, later, repeated)
    after = _estimate_costs(layout, tables, fields, later, repeated, reach, depth - 1)
    return after.amin(0).view_as(ends.x) + 1.0
