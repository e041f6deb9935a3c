"""Lower bounds on the primitives of a leg, from geometry alone: straight lines, no obstacles.

The bounds hold because no primitive moves the body's axis farther than the longest
of the action table. One primitive may press two targets that are close together. Task planning
prunes by them, and `escape_bound.py` bounds whole escapes.
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


class LegBounds:
    """Lower bounds of the legs between a room's operators.

    Attributes:
        step: longest move of the body's axis in a primitive, m.
        reach: largest distance between the body's axis and a target that it presses, m.
    """

    def __init__(self, instance: RoomInstance) -> None:
        self._instance = instance
        self.step = instance.robot.actions.longest
        self.reach = self._compute_reach()
        by_hand = instance.dynamics.press_with == "hand"
        size = instance.robot.hand_radius if by_hand else instance.robot.outer_radius
        self._span = 2 * (size + instance.dynamics.press_margin)
        if isinstance(instance.puzzle, Mapped):
            self._span = -1.0  # one cell, one target
        area = instance.exit
        half_x, half_y = (area.x_max - area.x_min) / 2, (area.y_max - area.y_min) / 2
        self._exit = make_footprint(*area.centre, half_x, half_y)
        self._known: dict[tuple[str | None, str | None], int] = {}

    def _compute_reach(self) -> float:
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
        if then is not None and self.is_anywhere(then):
            return 1
        shape, reach = self.get_place(then)
        return self._count(compute_distance(state.x, state.y, shape) - reach, then)

    def get_area(self, goal: Goal) -> tuple[Footprint, float]:
        """Footprint of a goal, and the largest distance from it at which the body's axis can reach the goal, m."""
        area = compute_goal_area(goal, self._instance)
        return area.footprint, self.reach if isinstance(goal, PressGoal) else area.reach

    def bound_goals(self, state: RoomState, goals: Sequence[Goal]) -> int:
        """Bound the primitives that reach goals in order, none of which is reached yet, from a state."""
        total, here = 0, None
        for goal in goals:
            shape, reach = self.get_area(goal)
            least = int(isinstance(goal, PressGoal))
            if here is None:
                gap = compute_distance(state.x, state.y, shape) - reach
            elif shape.is_disc or here[0].is_disc:
                around = sum(s.half_x if s.is_disc else math.hypot(s.half_x, s.half_y) for s in (shape, here[0]))
                gap = math.hypot(shape.x - here[0].x, shape.y - here[0].y) - around - reach - here[1]
            else:
                gap = _compute_gap(here[0], shape) - reach - here[1]
            if here is not None and self._is_beside(here[0], shape):
                least = 0
            total += max(least, math.ceil(gap / self.step - 1e-9))
            here = shape, reach
        return total

    def bound_leg(self, last: Operator | None, then: Operator | None) -> int:
        """Bound the leg from operator `last` to operator `then`; None is any start, or the exit."""
        key = (last and last.name, then and then.name)
        if key not in self._known:
            self._known[key] = self._compute_leg(last, then)
        return self._known[key]

    def _compute_leg(self, last: Operator | None, then: Operator | None) -> int:
        if last is None or any(op and self.is_anywhere(op) for op in (last, then)):
            return 0 if then is None else 1
        (begin, begin_reach), (end, end_reach) = self.get_place(last), self.get_place(then)
        gap = _compute_gap(begin, end) - begin_reach - end_reach
        return 0 if then and gap <= 0 and self._is_beside(begin, end) else self._count(gap, then)

    def _is_beside(self, a: Footprint, b: Footprint) -> bool:
        """Return whether one primitive may press both targets."""
        if a.is_disc or b.is_disc:
            return math.hypot(a.x - b.x, a.y - b.y) - math.hypot(a.half_x, a.half_y) - math.hypot(
                b.half_x, b.half_y) <= self._span
        return _compute_gap(a, b) <= self._span

    def is_anywhere(self, op: Operator) -> bool:
        """Return whether an operator has no place of its own: a push, or on a map putting down a held thing."""
        return op.action == "push" or (op.action == "release" and isinstance(self._instance.puzzle, Mapped))

    def get_place(self, op: Operator | None) -> tuple[Footprint, float]:
        """Footprint of an operator's target or of the exit, and how far from it the body's axis may be, m."""
        if op is None:
            return self._exit, 0.0
        names = self._instance.puzzle.target_names
        return self._instance.targets[names.index(op.target)].footprint, self.reach

    def _count(self, distance: float, then: Operator | None) -> int:
        least = 0 if then is None else 1  # a press takes a primitive
        return max(least, math.ceil(distance / self.step - 1e-9))


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
