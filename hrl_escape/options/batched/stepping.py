"""One primitive in every room of a batch, with the decisions that begin and end there: pure functions of tensors.

The loop of `OptionsEnv.step`, turned inside out for many rooms. Rules are the batched engine's,
choices `policy.py`'s; `env.py` keeps the tensors.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from hrl_escape.env.batched.observations import TensorObservation, observe
from hrl_escape.env.batched.poses import TensorState
from hrl_escape.env.batched.rules import is_in_exit, restart, step
from hrl_escape.env.batched.tables import Layout, Tables
from hrl_escape.options.batched.cost_to_go import CostFields
from hrl_escape.options.batched.decisions import ENDINGS, PLAN_LENGTH, OpenDecisions, Transitions
from hrl_escape.options.batched.policy import MEMORY, Choice, can_start, choose_primitive
from hrl_escape.options.batched.value_iteration import UNREACHABLE

__all__ = ["FAIL_AFTER", "PLAN_AFTER", "AgentView", "StepSettings", "begin_decisions", "make_decisions", "make_view",
           "step_decisions"]

PLAN_AFTER = 4
"""Primitives without progress after which an option follows a plan instead of its field."""
FAIL_AFTER = 120
"""Primitives without progress after which it fails; more where primitives slip."""
REACHED, TIMEOUT, EPISODE_OVER, FAILED = range(len(ENDINGS))


class StepSettings(NamedTuple):
    """Constants of a compiled kernel besides the layout."""

    observation: TensorObservation
    primitives: int
    gamma: float
    fail_after: int
    max_duration: int
    autoreset: bool


class AgentView(NamedTuple):
    """Present input of an agent: observation float32 (rooms, numbers), and legal actions bool (rooms, actions)."""

    observation: Tensor
    mask: Tensor


def make_view(layout: Layout, tables: Tables, state: TensorState, settings: StepSettings) -> AgentView:
    """Observe every room and list its legal actions."""
    options = can_start(layout, tables, state)
    mask = torch.cat([torch.ones_like(options[:, :1]).expand(-1, settings.primitives), options], dim=1)
    mask = mask | ~mask.any(dim=1, keepdim=True)  # nothing can start: any choice then waits one primitive
    return AgentView(observe(layout, tables, state, settings.observation), mask)


def step_decisions(layout: Layout, settings: StepSettings, tables: Tables, fields: CostFields | None,
                   state: TensorState, running: OpenDecisions, view: AgentView, action: Tensor
                   ) -> tuple[TensorState, OpenDecisions, AgentView, Transitions]:
    """Run one primitive in every room, and begin and end decisions; the function that is compiled."""
    is_over = state.has_ended != 0
    running = begin_decisions(running, (running.action < 0) & ~is_over & (action >= 0), action, view.observation)
    is_over = is_over | (running.action < 0)  # rooms that wait and are given no action stand still as well
    is_new = running.duration == 0
    is_option = running.action >= settings.primitives
    goal = (running.action - settings.primitives).clamp(min=0)
    is_legal = torch.gather(view.mask, 1, running.action.clamp(min=0).unsqueeze(1)).squeeze(1)

    planned = _read_plan(running)
    if fields is None:  # all options are planned; a room without a plan found none, or its option was masked
        choice = Choice(planned, running.plan_left.to(torch.float32), torch.zeros_like(planned))
        has_failed = is_option & (running.plan_left == 0)
    else:
        choice = choose_primitive(layout, tables, fields, state, goal, running.cells, running.costs)
        has_failed = is_new & is_option & (~is_legal | (choice.cost >= UNREACHABLE))
    chosen = torch.where(running.plan_left > 0, planned, choice.primitive)
    primitive = torch.where(has_failed, layout.actions.wait, torch.where(is_option, chosen, running.action))
    is_nearer = choice.cost < running.least - 0.5
    stalled = torch.where(is_nearer, 0, running.stalled + 1)
    slot = torch.arange(MEMORY, device=action.device).unsqueeze(1) == running.duration % MEMORY
    running = running._replace(
        least=torch.minimum(running.least, choice.cost), stalled=stalled,
        plan_left=(running.plan_left - 1).clamp(min=0),
        cells=torch.where(slot, choice.cell, running.cells), costs=torch.where(slot, choice.cost, running.costs),
    )

    after, reward, terminated, truncated, pressed = step(layout, tables, state, primitive)
    after = TensorState(*(torch.where(is_over, old, new) for old, new in zip(state, after, strict=True)))
    running = running._replace(
        reward=running.reward + reward, discounted_reward=running.discounted_reward + running.discount * reward,
        discount=running.discount * settings.gamma, duration=running.duration + 1, pressed=running.pressed | pressed,
    )
    is_press = goal < layout.targets
    has_pressed = (pressed >> goal.clamp(max=max(layout.targets - 1, 0))) & 1 != 0
    is_there = torch.where(is_press, has_pressed, is_in_exit(layout, tables, after.instance, after.x, after.y))
    has_ended = (terminated | truncated) & ~is_over
    ended = torch.where(stalled > settings.fail_after, FAILED, -1)
    ended = torch.where(running.duration >= settings.max_duration, TIMEOUT, ended)
    ended = torch.where(has_ended, EPISODE_OVER, ended)
    ended = torch.where(is_there | ~is_option, REACHED, ended)
    ended = torch.where(has_failed, FAILED, ended)
    where = (ended >= 0) & ~is_over

    final = make_view(layout, tables, after, settings)
    decisions = Transitions(
        where, running.observation, running.action, running.reward, running.discounted_reward, running.duration,
        running.discount, final.observation, final.mask, terminated & ~is_over, truncated & ~is_over,
        ended.to(torch.int8), running.pressed, after.primitives,
    )
    if settings.autoreset:
        after = restart(layout, tables, after, has_ended)
        final = make_view(layout, tables, after, settings)
    return after, running._replace(action=torch.where(where, -1, running.action)), final, decisions


def _read_plan(running: OpenDecisions) -> Tensor:
    """Next primitive of each room's plan, int64 (rooms,); arbitrary where it has none."""
    at = (PLAN_LENGTH - running.plan_left).clamp(max=PLAN_LENGTH - 1).to(torch.int64)
    return torch.gather(running.plan, 0, at.unsqueeze(0))[0].to(torch.int64)


def begin_decisions(running: OpenDecisions, where: Tensor, action: Tensor, observation: Tensor) -> OpenDecisions:
    """Begin decisions in the rooms of `where`, bool (rooms,), for the actions given."""
    fresh = make_decisions(observation)._replace(action=action)
    return OpenDecisions(*(torch.where(where.unsqueeze(1) if new is observation else where, new, old)
                     for new, old in zip(fresh, running, strict=True)))


def make_decisions(observation: Tensor) -> OpenDecisions:
    """Decisions that have not begun yet."""
    number = observation.new_zeros(len(observation))
    count, word = number.to(torch.int32), number.to(torch.int64)
    return OpenDecisions(
        action=word - 1, observation=observation, reward=number, discounted_reward=number, discount=number + 1.0,
        duration=count, pressed=word, least=number + math.inf, stalled=count,
        cells=word.expand(MEMORY, -1) - 1, costs=number.expand(MEMORY, -1).clone(),
        plan=count.to(torch.int8).expand(PLAN_LENGTH, -1).clone(), plan_left=count,
    )
