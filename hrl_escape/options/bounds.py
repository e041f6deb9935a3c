"""How many primitives a leg costs at least, from geometry alone: straight lines, no obstacles.

A primitive moves the body's axis by at most one move step, so nothing goes faster than that.
Task planning uses these bounds to prune, and to say how far from the best a plan can be at most.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.geometry import Footprint, compute_distance, make_footprint
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.puzzles.base import Operator
from hrl_escape.env.robot import make_robot
from hrl_escape.options.goals import PushGoal, make_goal

__all__ = ["LegBounds"]


class LegBounds:
    """Lower bounds between the places where a room's operators are carried out."""

    def __init__(self, instance: RoomInstance) -> None:
        self._instance = instance
        self._step = instance.robot.move_step
        self._reach = self._compute_reach()
        area = instance.exit
        half_x, half_y = (area.x_max - area.x_min) / 2, (area.y_max - area.y_min) / 2
        self._exit = make_footprint(*area.centre, half_x, half_y)
        self._known: dict[tuple[str | None, str | None], int] = {}

    def _compute_reach(self) -> float:
        """Largest distance between the body's axis and a target that it presses, m."""
        robot, margin = self._instance.robot, self._instance.dynamics.press_margin
        if self._instance.dynamics.press_with == "body":
            return robot.body_radius + margin
        arm = sum(float(np.linalg.norm(joint.origin[:3, 3])) for joint in make_robot(robot).chain)
        sliding = sum(max(abs(j.low), abs(j.high)) for j in make_robot(robot).chain if j.kind == "prismatic")
        return arm + sliding + robot.hand_radius + margin

    def bound_start(self, state: RoomState, then: Operator | None) -> int:
        """From a state to carrying out `then` (None: to the exit)."""
        if then is not None and isinstance(make_goal(then, self._instance), PushGoal):
            return 1
        shape, reach = self._get_place(then)
        return self._count(compute_distance(state.x, state.y, shape) - reach, then)

    def bound_leg(self, last: Operator | None, then: Operator | None) -> int:
        """From where `last` is done to carrying out `then`; None is any start, or the exit."""
        key = (last and last.name, then and then.name)
        if key not in self._known:
            self._known[key] = self._compute_leg(last, then)
        return self._known[key]

    def _compute_leg(self, last: Operator | None, then: Operator | None) -> int:
        pushes = [op for op in (last, then) if op and isinstance(make_goal(op, self._instance), PushGoal)]
        if last is None or pushes:
            return 0 if then is None else 1
        (begin, begin_reach), (end, end_reach) = self._get_place(last), self._get_place(then)
        return self._count(_compute_gap(begin, end) - begin_reach - end_reach, then)

    def _get_place(self, op: Operator | None) -> tuple[Footprint, float]:
        if op is None:
            return self._exit, 0.0
        names = self._instance.puzzle.target_names
        return self._instance.targets[names.index(op.target)].footprint, self._reach

    def _count(self, distance: float, then: Operator | None) -> int:
        least = 0 if then is None else 1  # a press begins with some primitive
        return max(least, math.ceil(distance / self._step - 1e-9))


def _compute_gap(a: Footprint, b: Footprint) -> float:
    """Distance between two boxes; they are convex, so a corner of one of them is nearest, or they meet."""
    corners = [*(compute_distance(x, y, b) for x, y in _list_corners(a)),
               *(compute_distance(x, y, a) for x, y in _list_corners(b))]
    return 0.0 if _do_cross(a, b) else min(corners)


def _list_corners(shape: Footprint) -> NDArray[np.float64]:
    signs = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)]) * (shape.half_x, shape.half_y)
    return signs @ np.array([[shape.cos, shape.sin], [-shape.sin, shape.cos]]) + (shape.x, shape.y)


def _do_cross(a: Footprint, b: Footprint) -> bool:
    """Separating axes: boxes meet if they overlap along both axes of each."""
    corners = _list_corners(a), _list_corners(b)
    for shape in (a, b):
        for axis in ((shape.cos, shape.sin), (-shape.sin, shape.cos)):
            (low_a, high_a), (low_b, high_b) = ((float(min(c @ axis)), float(max(c @ axis))) for c in corners)
            if high_a < low_b or high_b < low_a:
                return False
    return True
