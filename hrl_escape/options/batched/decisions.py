"""Decisions of a batch of rooms as plain tensors, rooms first.

`Transitions` holds the finished ones, for learners: the fields of `OptionsEnv`'s transitions, one
row a room. `OpenDecisions` holds those in progress. `stepping.py` chooses for options, `env.py`
steps the rooms.
"""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

ENDINGS = ("reached", "timeout", "episode-over", "planning-failed", "interrupted")
"""Endings of decisions, in the words of `info["option"]["ended"]`; `Transitions.ended` is an index into it."""

PLAN_LENGTH = 64
"""Longest plan that a room keeps, primitives."""
ORDER_LENGTH = 16
"""Most goals of one option that a room keeps; it asks for the rest of a longer order once these are reached."""
CHOSEN = 4
"""Number of candidate postures that a hand keeps on its way to a target."""
NOT_ASKED = -1
"""Stands for a goal that the planner must still choose: the next one of an option that presses ancestors first."""


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
    option: Tensor  # action of the option that runs, or was interrupted and may be continued, int64; -1 for none
    run: Tensor  # primitives of its run so far, interruptions included, int32
    goal: Tensor  # target of the option, the number of targets for the exit, or `NOT_ASKED`, int64
    age: Tensor  # primitives since it took up this goal, int32
    postures: Tensor  # candidate postures for a press by hand, int64 (`CHOSEN`, rooms)
    order: Tensor  # goals to follow, or `NOT_ASKED` to ask again, aligned to the end, int8 (`ORDER_LENGTH`, rooms)
    order_left: Tensor  # number of goals left in `order`, int32
    least: Tensor  # lowest cost-to-go that the option has met, float32
    stalled: Tensor  # primitives since then, int32
    cells: Tensor  # cells of the last choices, int64 (memory, rooms)
    costs: Tensor  # cost-to-go found there, float32 (memory, rooms)
    plan: Tensor
    """Primitives to follow where the field made no progress, aligned to the end, int8 (`PLAN_LENGTH`, rooms)."""
    plan_left: Tensor  # primitives of the plan still to run, int32
