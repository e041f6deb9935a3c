"""What a batch of running decisions is made of: plain tensors, rooms first.

`Decisions` is what learners get: the fields of `OptionsEnv`'s transitions, one row a room. `Running`
is what is kept while decisions last. How options choose is `policy.py`, who steps them `env.py`.
"""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

__all__ = ["ENDINGS", "PLANNED", "Decisions", "Running"]

ENDINGS = ("reached", "timeout", "episode-over", "planning-failed")
"""How decisions end; `Decisions.ended` counts into it. The words are those of `info["option"]["ended"]`."""

PLANNED = 64
"""Primitives of a plan that a room keeps."""


class Decisions(NamedTuple):
    """What came to an end with the last primitive; rows count only where `where` is true.

    Attributes:
        where: rooms whose decision ended, bool (rooms,).
        observation: what the room showed when the decision began, float32 (rooms, numbers).
        action: the action chosen, int64 (rooms,).
        reward: sum of the primitive rewards, float32 (rooms,).
        discounted_reward: sum over i < k of gamma^i r_i, float32 (rooms,).
        duration: k >= 1, primitives that ran, int32 (rooms,).
        discount: gamma^k, float32 (rooms,).
        next_observation: what the room showed at the decision's end, before any automatic reset.
        next_action_mask: the actions legal there, bool (rooms, actions).
        terminated: the robot escaped, bool (rooms,).
        truncated: the horizon was reached, bool (rooms,); bootstrap from the state reached.
        ended: how, an index into `ENDINGS`, int8 (rooms,).
        pressed: bit i is set if target i was pressed by any of the k primitives, int64 (rooms,).
        primitives: primitives of the episode so far, int32 (rooms,).
    """

    where: Tensor
    observation: Tensor
    action: Tensor
    reward: Tensor
    discounted_reward: Tensor
    duration: Tensor
    discount: Tensor
    next_observation: Tensor
    next_action_mask: Tensor
    terminated: Tensor
    truncated: Tensor
    ended: Tensor
    pressed: Tensor
    primitives: Tensor


class Running(NamedTuple):
    """Decisions that last; every field is (rooms,) unless said.

    Attributes:
        action: the action chosen, int64; -1 where a room waits for one.
        observation: what was shown when it began, float32 (rooms, numbers).
        reward: sum of primitive rewards so far, float32.
        discounted_reward: their discounted sum, float32.
        discount: gamma to the power of the duration so far, float32.
        duration: primitives so far, int32.
        pressed: bits of the targets pressed so far, int64.
        least: the lowest cost to go that the option has seen, float32.
        waited: primitives since then, int32.
        places: cells lately decided in, int64 (remembered, rooms).
        costs: what was found there, float32 (remembered, rooms).
        plan: primitives to follow where the field has led nowhere, the last ones of it, int8 (`PLANNED`, rooms).
        planned: how many of them are left, int32.
    """

    action: Tensor
    observation: Tensor
    reward: Tensor
    discounted_reward: Tensor
    discount: Tensor
    duration: Tensor
    pressed: Tensor
    least: Tensor
    waited: Tensor
    places: Tensor
    costs: Tensor
    plan: Tensor
    planned: Tensor
