"""Escapes of a planner that knows the room and plans anew wherever noise or slip has led it away from its plan."""

from __future__ import annotations

import hashlib
from typing import NamedTuple

import numpy as np

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.noise import draw_episode
from hrl_escape.errors import EscapeError
from hrl_escape.planning.best_known import find_best_known
from hrl_escape.planning.plan import Plan, strip
from hrl_escape.planning.room_planner import get_planner

__all__ = ["ROLLOUTS", "ExpectedEscape", "Replanner", "compute_expected_escape"]

ROLLOUTS = 20
"""Rollouts behind an expectation."""


class Replanner:
    """Policy that follows the best known plan and plans anew where the robot is not where the plan has it.

    Args:
        instance: the room.
    """

    def __init__(self, instance: RoomInstance) -> None:
        self._instance = instance
        self._plan: Plan | None = None
        self._next = 0

    def choose(self, state: RoomState, begins: bool) -> int | None:
        """Next primitive; None where no plan leads out.

        Args:
            state: present state of the room.
            begins: the episode begins here.
        """
        if begins or self._plan is None or not self._find_place(self._plan, state):
            self._plan, self._next = self._make_plan(state, begins), 0
        if self._plan is None or self._next >= len(self._plan.primitives):
            return None
        self._next += 1
        return self._plan.primitives[self._next - 1]

    def _find_place(self, plan: Plan, state: RoomState) -> bool:
        """Return whether the robot is where the plan has it, or still where it was before a slip."""
        here = strip(state)
        if self._next < len(plan.primitives) and here == strip(plan.states[self._next]):
            return True
        if self._next and here == strip(plan.states[self._next - 1]):
            self._next -= 1
            return True
        return False

    def _make_plan(self, state: RoomState, begins: bool) -> Plan | None:
        try:
            return (find_best_known(self._instance, state).plan if begins
                    else get_planner(self._instance).solve(state))
        except EscapeError:
            return None


class ExpectedEscape(NamedTuple):
    """Means over rollouts of the `Replanner`.

    Attributes:
        value: undiscounted return.
        primitives: primitives to the escape; the horizon for a rollout without one.
        rollouts: number of rollouts.
    """

    value: float
    primitives: float
    rollouts: int


def compute_expected_escape(instance: RoomInstance, state: RoomState, rollouts: int = ROLLOUTS) -> ExpectedEscape:
    """Compute the escape to be expected of the planner from one state, by rollouts with noise of their own.

    The noise follows from the room and the rollout's number, so the numbers are the same every time.

    Args:
        instance: a room whose moves may err or slip, without physics.
        state: first state of the episode.
        rollouts: number of rollouts.
    """
    rules = Kinematics(instance)
    stream = int.from_bytes(hashlib.sha256(f"rollouts of {instance.id}".encode()).digest()[:8], "big") >> 1
    returns, lengths = [], []
    for number in range(rollouts):
        here = state._replace(noise_key=draw_episode(stream, number, 1)[1], primitives=0)
        policy, total, length, ended = Replanner(instance), 0.0, 0, False
        while not ended and length < instance.horizon:
            primitive = policy.choose(here, length == 0)
            if primitive is None:  # stands to the end
                total += (instance.horizon - length) * instance.reward.step
                length = instance.horizon
                break
            step = rules.step(here, primitive)
            here, total, length, ended = step.state, total + step.reward, length + 1, step.terminated
        returns.append(total)
        lengths.append(length)
    return ExpectedEscape(float(np.mean(returns)), float(np.mean(lengths)), rollouts)
