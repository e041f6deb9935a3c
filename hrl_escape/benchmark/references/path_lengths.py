"""Lengths of planned paths between the targets of a room and its exit."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import PlanningFailed
from hrl_escape.planning.goals import ExitGoal, Goal, PressGoal
from hrl_escape.planning.planner import RoomPlanner

_NO_PATH = 1e4
"""Length of a path that the planner does not find."""


@dataclasses.dataclass(frozen=True)
class PathLengths:
    """Path lengths between places, in primitives."""

    legs: NDArray[np.floating]  # float (places, buttons), from a place to the press of a button
    arrivals: NDArray[np.int64]  # int (places, buttons), the place of the robot after that
    leaving: NDArray[np.floating]  # float (places,), from a place to the open exit
    failure: float = 0.0  # cost of a failed puzzle


def measure_paths(planner: RoomPlanner, solved: Any = None) -> PathLengths:
    """Measure planned paths from target to target and to the exit, with all inner doors open.

    A place is the pose after pressing a target, coming from the start or from another target, because path lengths
    depend on the initial heading. Its number is `before * targets + target`; `before` is the number of targets for the
    start.

    Args:
        planner: of the room.
        solved: state of the puzzle in which paths are planned; by default of buttons that are all on.
    """
    room = planner.instance
    count = len(room.targets)
    legs = np.full(((count + 1) * count, count), _NO_PATH, np.float32)
    leaving = np.full((count + 1) * count, _NO_PATH, np.float32)
    solved = (1 << count) - 1 if solved is None else solved
    start = planner.rules.make_state(room.starts[0])._replace(puzzle=solved)

    def arrive(before: RoomState, target: int) -> RoomState | None:
        state = walk_path(planner, before, PressGoal(target))[0]
        return None if state is None else state._replace(puzzle=solved)

    states = [*(arrive(start, target) for target in range(count)), start]
    for place, (before, target) in enumerate(itertools.product(states, range(count))):
        state = before and arrive(before, target)
        if state is not None:
            legs[place] = [walk_path(planner, state, PressGoal(other))[1] for other in range(count)]
            leaving[place] = walk_path(planner, state, ExitGoal())[1]
    arrivals = np.tile(np.arange(count) * count, count + 1)[:, None] + np.arange(count)
    failure = room.reward.exit / -room.reward.step if room.reward.step < 0 else 0.0
    return PathLengths(legs, arrivals, leaving, failure)


def walk_path(planner: RoomPlanner, state: RoomState, goal: Goal) -> tuple[RoomState | None, float]:
    """Return the final state of a planned path and its primitives, or None and `_NO_PATH` without a path."""
    try:
        plan = planner.plan(state, goal)
        return plan.states[-1], float(plan.cost)
    except PlanningFailed:
        return None, _NO_PATH
