"""Joint steps along a path of the arm: A* over the joint lattice within a tube round the path.

A path of joint angles leads round solids where the fewest joint steps do not. Rounding it to whole steps
may touch what the path clears, so the lattice is searched near it, and every step is tested in between as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import PlanningFailed
from hrl_escape.search import find_cheapest_steps

if TYPE_CHECKING:
    from hrl_escape.planning.arm.reacher import Reacher

Posture: TypeAlias = tuple[int, ...]
PATH_TESTS = 20_000
"""Most configurations tested for one path."""
TUBES = (1.0, 2.0)
"""Half widths of the tubes that are tried, in joint steps."""
TESTED_SHARES = (0.25, 0.5, 0.75, 1.0)
"""Fractions of a joint step at which the arm is tested for collisions."""


def plan_steps(reacher: Reacher, state: RoomState, joint_steps: Posture, others: int = 0) -> tuple[int, ...] | None:
    """Plan joint steps round solids, along a path through the space of joint angles, the base at rest.

    Args:
        reacher: the room's arm.
        state: base and arm at the beginning.
        joint_steps: last posture, from home.
        others: bits of targets that may not be pressed on the way.

    Returns:
        Primitives; None where no path is found, or no joint steps along it.
    """
    rules, robot, offsets = reacher.kinematics, reacher.kinematics.robot, state.joint_offsets
    heading = reacher.kinematics.get_heading(state)
    home = np.array(robot.compute_angles((0,) * len(joint_steps), offsets))
    goal = home + robot.step * np.array(joint_steps)
    try:
        path = reacher.planner.plan(state, goal, budget=PATH_TESTS).interpolate(robot.step / 4)
    except PlanningFailed:
        return None

    @cache
    def get_touching(posture: Posture) -> int:
        return rules.compute_touching(*state._replace(joint_steps=posture).pose)

    @cache
    def can_step(a: Posture, b: Posture) -> bool:
        if any(not low <= n <= high for low, n, high in zip(robot.step_low, b, robot.step_high, strict=True)):
            return False
        if get_touching(b) & ~get_touching(a) & others:
            return False
        places = (home + robot.step * (np.array(a) + share * np.subtract(b, a)) for share in TESTED_SHARES)
        return all(reacher.is_collision_free(state.x, state.y, heading, place.tolist()) for place in places)

    steps = follow_path((path - home) / robot.step, state.joint_steps, joint_steps, can_step)
    if steps is None:
        return None
    pairs, changes = rules.actions.joints, np.diff([state.joint_steps, *steps], axis=0)
    return tuple(pairs[joint].increment if change[joint] > 0 else pairs[joint].decrement
                 for change in changes.tolist() for joint in range(len(change)) if change[joint])


def follow_path(path: NDArray[np.float64], begin: Posture, end: Posture, can_step: Callable[[Posture, Posture], bool]
                ) -> tuple[Posture, ...] | None:
    """Find the fewest joint steps from one posture to another near a path.

    Args:
        path: places along it, at most a fraction of a step apart, shape (n, joints), in joint steps from home.
        begin: first posture, in joint steps from home.
        end: last posture.
        can_step: (posture, a neighbouring one) -> the arm may go from one to the other.

    Returns:
        Postures after each step; None where no tube holds a way.
    """
    found = (_search_tube(path, begin, end, can_step, wide) for wide in TUBES)
    return next((postures for postures in found if postures is not None), None)


def _search_tube(path: NDArray[np.float64], begin: Posture, end: Posture, can_step: Callable[[Posture, Posture], bool],
                 wide: float) -> tuple[Posture, ...] | None:
    def list_steps(here: Posture) -> Iterator[tuple[Posture, int, Posture]]:
        for there in _list_neighbours(here):
            is_near = there == end or float(np.abs(path - there).max(axis=1).min()) <= wide
            if is_near and can_step(here, there):
                yield there, 1, there

    return find_cheapest_steps(begin, end.__eq__, list_steps, lambda posture: _count_steps(posture, end))


def _count_steps(a: Posture, b: Posture) -> int:
    return sum(abs(i - j) for i, j in zip(a, b, strict=True))


def _list_neighbours(posture: Posture) -> Iterator[Posture]:
    for joint in range(len(posture)):
        for change in (-1, 1):
            yield (*posture[:joint], posture[joint] + change, *posture[joint + 1 :])
