"""Lower bounds on the primitives of a leg, from geometry alone: straight lines, no obstacles.

The bounds hold because no primitive moves the body's axis farther than the longest
of the action table. Task planning
prunes by them, and they bound the distance of a plan from the optimum.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.geometry import Footprint, compute_distance, make_footprint
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.puzzles.symbolic import Operator
from hrl_escape.env.puzzles.traits import Mapped
from hrl_escape.env.robot import make_robot
from hrl_escape.planning.areas import compute_goal_area
from hrl_escape.planning.goals import Goal, PressGoal
from hrl_escape.planning.symbolic.operator_order import Leg, TaskSearch

__all__ = ["LegBounds", "bound_escape"]

BOUND_LEGS = 20_000
"""Most legs examined in the search for the bound of an escape."""


def bound_escape(instance: RoomInstance, state: RoomState) -> float:
    """Fewest primitives of an escape that straight lines allow, over all orders; infinity if no order escapes."""
    bounds = LegBounds(instance)
    search = TaskSearch(instance.symbolic_model, lower_bound=bounds.bound_leg)

    def extend(last: Operator | None, then: Operator | None) -> Leg:
        cost = bounds.bound_start(state, then) if last is None else bounds.bound_leg(last, then)
        return Leg(cost, then)

    tasks = search.find_order(instance.puzzle.symbolic.get_facts(state.puzzle), None, extend, BOUND_LEGS)
    return math.inf if tasks is None else max(1.0, tasks.lower_bound)


class LegBounds:
    """Lower bounds of the legs between a room's operators."""

    def __init__(self, instance: RoomInstance) -> None:
        self._instance = instance
        self._step = instance.robot.actions.longest
        self._reach = self._compute_reach()
        area = instance.exit
        half_x, half_y = (area.x_max - area.x_min) / 2, (area.y_max - area.y_min) / 2
        self._exit = make_footprint(*area.centre, half_x, half_y)
        self._known: dict[tuple[str | None, str | None], int] = {}

    def _compute_reach(self) -> float:
        """Largest distance between the body's axis and a target that it presses, m."""
        robot, margin = self._instance.robot, self._instance.dynamics.press_margin
        if isinstance(self._instance.puzzle, Mapped):
            return robot.actions.stride  # from the cell before it
        if self._instance.dynamics.press_with == "body":
            return robot.outer_radius + margin
        arm = sum(float(np.linalg.norm(joint.origin[:3, 3])) for joint in make_robot(robot).chain)
        sliding = sum(max(abs(j.low), abs(j.high)) for j in make_robot(robot).chain if j.kind == "prismatic")
        return arm + sliding + robot.hand_radius + margin

    def bound_start(self, state: RoomState, then: Operator | None) -> int:
        """Bound the leg from a state to operator `then`; None is the exit."""
        if then is not None and self._is_anywhere(then):
            return 1
        shape, reach = self._get_place(then)
        return self._count(compute_distance(state.x, state.y, shape) - reach, then)

    def get_area(self, goal: Goal) -> tuple[Footprint, float]:
        """Footprint of a goal, and the largest distance from it at which the body's axis can reach the goal, m."""
        area = compute_goal_area(goal, self._instance)
        return area.footprint, self._reach if isinstance(goal, PressGoal) else area.reach

    def bound_goals(self, state: RoomState, goals: Sequence[Goal]) -> int:
        """Bound the primitives that reach goals in order, none of which is reached yet, from a state."""
        total, here = 0, None
        for goal in goals:
            shape, reach = self.get_area(goal)
            if here is None:
                gap = compute_distance(state.x, state.y, shape) - reach
            elif shape.is_disc or here[0].is_disc:
                around = sum(s.half_x if s.is_disc else math.hypot(s.half_x, s.half_y) for s in (shape, here[0]))
                gap = math.hypot(shape.x - here[0].x, shape.y - here[0].y) - around - reach - here[1]
            else:
                gap = _compute_gap(here[0], shape) - reach - here[1]
            total += max(int(isinstance(goal, PressGoal)), math.ceil(gap / self._step - 1e-9))
            here = shape, reach
        return total

    def bound_leg(self, last: Operator | None, then: Operator | None) -> int:
        """Bound the leg from operator `last` to operator `then`; None is any start, or the exit."""
        key = (last and last.name, then and then.name)
        if key not in self._known:
            self._known[key] = self._compute_leg(last, then)
        return self._known[key]

    def _compute_leg(self, last: Operator | None, then: Operator | None) -> int:
        if last is None or any(op and self._is_anywhere(op) for op in (last, then)):
            return 0 if then is None else 1
        (begin, begin_reach), (end, end_reach) = self._get_place(last), self._get_place(then)
        return self._count(_compute_gap(begin, end) - begin_reach - end_reach, then)

    def _is_anywhere(self, op: Operator) -> bool:
        """Return whether an operator has no place of its own: a push, or on a map putting down a held thing."""
        return op.action == "push" or (op.action == "release" and isinstance(self._instance.puzzle, Mapped))

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
