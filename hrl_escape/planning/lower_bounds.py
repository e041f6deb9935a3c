"""Lower bounds on the primitives of a leg, from geometry alone: straight lines, no obstacles.

The bounds hold because a primitive moves the body's axis by at most one move step. Task planning
prunes by them, and they bound the distance of a plan from the optimum.
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
from hrl_escape.planning.goals import PushGoal, make_goal

__all__ = ["LegBounds"]


class LegBounds:
    """Lower bounds of the legs between a room's operators."""

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
        """Bound the leg from a state to operator `then`; None is the exit."""
        if then is not None and isinstance(make_goal(then, self._instance), PushGoal):
            return 1
        shape, reach = self._get_place(then)
        return self._count(compute_distance(state.x, state.y, shape) - reach, then)

    def bound_leg(self, last: Operator | None, then: Operator | None) -> int:
        """Bound the leg from operator `last` to operator `then`; None is any start, or the exit."""
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
        least = 0 if then is None else 1  # a press takes a primitive
        return max(least, math.ceil(distance / self._step - 1e-9))


def _compute_gap(a: Footprint, b: Footprint) -> float:
    """Distance between two boxes: they are convex, so it is that of some corner to the other box, or 0."""
    corners = [*(compute_distance(x, y, b) for x, y in _list_corners(a)),
               *(compute_distance(x, y, a) for x, y in _list_corners(b))]
    return 0.0 if _do_cross(a, b) else min(corners)


def _list_corners(shape: Footprint) -> NDArray[np.float64]:
    signs = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)]) * (shape.half_x, shape.half_y)
    return signs @ np.array([[shape.cos, shape.sin], [-shape.sin, shape.cos]]) + (shape.x, shape.y)


def _do_cross(a: Footprint, b: Footprint) -> bool:
    """Return whether two boxes overlap, by the separating axis theorem."""
    corners = _list_corners(a), _list_corners(b)
    for shape in (a, b):
        for axis in ((shape.cos, shape.sin), (-shape.sin, shape.cos)):
            (low_a, high_a), (low_b, high_b) = ((float(min(c @ axis)), float(max(c @ axis))) for c in corners)
            if high_a < low_b or high_b < low_a:
                return False
    return True
