"""One primitive in every room of a batch, and the decisions that begin and end with it: pure functions of tensors.

What `OptionsEnv.step` does for one room with a loop, written for many without one. Rules are the
batched engine's, choices `policy.py`'s; who keeps the tensors is `env.py`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from hrl_escape.env.primitives import BASE_PRIMITIVES
from hrl_escape.env.tensor_instances import Layout, Tables
from hrl_escape.env.tensor_observations import observe
from hrl_escape.env.tensor_poses import TensorState
from hrl_escape.env.tensor_rules import restart, step
from hrl_escape.options.batched.decisions import ENDINGS, PLANNED, Decisions, Running
from hrl_escape.options.batched.policy import REMEMBERED, Choice, can_start, choose, is_in_exit
from hrl_escape.options.batched.prices import Prices
from hrl_escape.options.batched.relaxing import FAR

__all__ = ["PATIENCE", "STUCK", "Settings", "Shown", "advance", "begin", "make_running", "show"]

WAIT = [primitive.name for primitive in BASE_PRIMITIVES].index("turn-left")
STUCK = 4
"""Primitives without coming nearer after which an option follows a plan instead of its field."""
PATIENCE = 120
"""Primitives without coming nearer after which it gives up; more where primitives slip."""
REACHED, TIMEOUT, EPISODE_OVER, FAILED = range(len(ENDINGS))


class Settings(NamedTuple):
    """What a compiled kernel depends on besides the layout."""

    kind: str
    primitives: int
    gamma: float
    patience: int
    max_duration: int
    autoreset: bool


class Shown(NamedTuple):
    """What the rooms show now: observation float32 (rooms, numbers), and legal actions bool (rooms, actions)."""

    observation: Tensor
    mask: Tensor


def show(layout: Layout, tables: Tables, state: TensorState, settings: Settings) -> Shown:
    """Observe every room and say what may be chosen there."""
    options = can_start(layout, tables, state)
    mask = torch.cat([torch.ones_like(options[:, :1]).expand(-1, settings.primitives), options], dim=1)
    mask = mask | ~mask.any(dim=1, keepdim=True)  # nothing can be done: whatever is chosen then waits one primitive
    return Shown(observe(layout, tables, state, settings.kind), mask)


def advance(layout: Layout, settings: Settings, tables: Tables, prices: Prices | None, state: TensorState,
            running: Running, shown: Shown, action: Tensor) -> tuple[TensorState, Running, Shown, Decisions]:
    """One primitive in every room, and whatever begins and ends with it: what gets compiled."""
    is_over = state.has_ended != 0
    running = begin(running, (running.action < 0) & ~is_over, action, shown.observation)
    is_new = running.duration == 0
    is_option = running.action >= settings.primitives
    goal = (running.action - settings.primitives).clamp(min=0)
    is_legal = torch.gather(shown.mask, 1, running.action.clamp(min=0).unsqueeze(1)).squeeze(1)

    planned = _look_ahead(running)
    if prices is None:  # all is planned; no plan means that none was found, or that the option was masked
        choice = Choice(planned, running.planned.to(torch.float32), torch.zeros_like(planned))
        has_failed = is_option & (running.planned == 0)
    else:
        choice = choose(layout, tables, prices, state, goal, running.places, running.costs)
        has_failed = is_new & is_option & (~is_legal | (choice.cost >= FAR))
    chosen = torch.where(running.planned > 0, planned, choice.primitive)
    primitive = torch.where(has_failed, WAIT, torch.where(is_option, chosen, running.action))
    is_nearer = choice.cost < running.least - 0.5
    waited = torch.where(is_nearer, 0, running.waited + 1)
    slot = torch.arange(REMEMBERED, device=action.device).unsqueeze(1) == running.duration % REMEMBERED
    running = running._replace(
        least=torch.minimum(running.least, choice.cost), waited=waited, planned=(running.planned - 1).clamp(min=0),
        places=torch.where(slot, choice.cell, running.places), costs=torch.where(slot, choice.cost, running.costs),
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
    has_ended = terminated | truncated
    ended = torch.where(waited > settings.patience, FAILED, -1)
    ended = torch.where(running.duration >= settings.max_duration, TIMEOUT, ended)
    ended = torch.where(has_ended, EPISODE_OVER, ended)
    ended = torch.where(is_there | ~is_option, REACHED, ended)
    ended = torch.where(has_failed, FAILED, ended)
    where = (ended >= 0) & ~is_over

    final = show(layout, tables, after, settings)
    decisions = Decisions(
        where, running.observation, running.action, running.reward, running.discounted_reward, running.duration,
        running.discount, final.observation, final.mask, terminated & ~is_over, truncated & ~is_over,
        ended.to(torch.int8), running.pressed, after.primitives,
    )
    if settings.autoreset:
        after = restart(layout, tables, after, has_ended)
        final = show(layout, tables, after, settings)
    return after, running._replace(action=torch.where(where, -1, running.action)), final, decisions


def _look_ahead(running: Running) -> Tensor:
    """The next primitive of each room's plan, int64 (rooms,); anything where it has none."""
    at = (PLANNED - running.planned).clamp(max=PLANNED - 1).to(torch.int64)
    return torch.gather(running.plan, 0, at.unsqueeze(0))[0].to(torch.int64)


def begin(running: Running, where: Tensor, action: Tensor, observation: Tensor) -> Running:
    """Begin decisions in some rooms, bool (rooms,), for the actions given."""
    fresh = make_running(observation)._replace(action=action)
    return Running(*(torch.where(where.unsqueeze(1) if new is observation else where, new, old)
                     for new, old in zip(fresh, running, strict=True)))


def make_running(observation: Tensor) -> Running:
    """Decisions that have not begun."""
    number = observation.new_zeros(len(observation))
    count, word = number.to(torch.int32), number.to(torch.int64)
    return Running(
        action=word - 1, observation=observation, reward=number, discounted_reward=number, discount=number + 1.0,
        duration=count, pressed=word, least=number + math.inf, waited=count,
        places=word.expand(REMEMBERED, -1) - 1, costs=number.expand(REMEMBERED, -1).clone(),
        plan=count.to(torch.int8).expand(PLANNED, -1).clone(), planned=count,
    )
