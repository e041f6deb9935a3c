"""Lower bounds on the primitives of a leg and of a whole escape, from geometry alone: straight lines, no obstacles.

They hold because no primitive moves the body's axis farther than the longest of the action table, and no target moves:
of a thing that has been put down or pushed elsewhere on a map, no way is counted. One primitive may press two targets
that are close together. Bounds of legs add up as if the robot could leave a press at another place
than it arrived at. In puzzles of few states the legs of an escape are bounded jointly: the places to press a target
from are divided into cells. Dynamic programming over puzzle states, targets and cells then bounds the primitives to
each cell. A cell contains more than one pose, so the bound remains a bound.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.bases.rectangle import compute_base_distance
from hrl_escape.env.geometry import Footprint, compute_distance, make_footprint
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.puzzles.mixins import Mapped
from hrl_escape.env.puzzles.symbolic import Operator
from hrl_escape.env.robot import make_robot
from hrl_escape.planning.areas import compute_goal_area
from hrl_escape.planning.goals import Goal, GripGoal, PressGoal
from hrl_escape.planning.symbolic.operator_order import EXIT, START, Leg, TaskNode, TaskSearch


class LegBounds:
    """Lower bounds of the legs between a room's operators; `step` is the longest move of a primitive, m.

    `reach` is the largest distance between the body's axis and a target that it presses, m.
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
        """Bound the leg from a state to operator `then`, or to the exit for None."""
        if then is not None and self.is_anywhere(then):
            return 1
        shape, reach = self.get_place(then)
        return self._count(compute_distance(state.x, state.y, shape) - reach, then)

    def list_areas(self, state: RoomState, goals: Sequence[Goal]) -> list[tuple[Footprint, float] | None]:
        """Areas of goals that are reached in order from a state, see `get_area`.

        None of a thing on a map that can lie elsewhere than at first, and of putting it down, which can be anywhere.
        """
        areas, moved = list[tuple[Footprint, float] | None](), set[int]()
        for goal in goals:
            is_away = False
            if isinstance(goal, GripGoal) and isinstance(self._instance.puzzle, Mapped):
                is_away = (goal.action == "release" or goal.target in moved
                           or _has_moved(self._instance.puzzle, state, goal.target))
                if goal.action not in ("grip", "use"):
                    moved.add(goal.target)
            areas.append(None if is_away else self.get_area(goal))
        return areas

    def get_area(self, goal: Goal) -> tuple[Footprint, float]:
        """Return the footprint of a goal, and the largest distance, m, of the body's axis that reaches it."""
        area = compute_goal_area(goal, self._instance)
        return area.footprint, self.reach if self._is_before(goal) or isinstance(goal, PressGoal) else area.reach

    def _is_before(self, goal: Goal) -> bool:
        """Return whether a goal takes a primitive of its own, in the cell before its target on a map."""
        return isinstance(goal, GripGoal) and isinstance(self._instance.puzzle, Mapped)

    def bound_goals(self, state: RoomState, goals: Sequence[Goal]) -> int:
        """Bound the primitives to reach goals in order, from a state before the first."""
        total, here = 0, None
        for goal, area in zip(goals, self.list_areas(state, goals), strict=True):
            own = int(self._is_before(goal))
            total += own
            if area is None:
                continue
            shape, reach = area
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
            here = area
        return total

    def bound_leg(self, last: Operator | None, then: Operator | None) -> int:
        """Bound the leg from operator `last` to operator `then`; as `last`, None is any start, as `then` the exit."""
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
        """Return the footprint of an operator's target or of the exit, and the most distance of the body's axis, m."""
        if op is None:
            return self._exit, 0.0
        names = self._instance.puzzle.target_names
        return self._instance.targets[names.index(op.target)].footprint, self.reach

    def _count(self, distance: float, then: Operator | None) -> int:
        least = 0 if then is None else 1  # a press takes a primitive
        return max(least, math.ceil(distance / self.step - 1e-9))


def _compute_gap(a: Footprint, b: Footprint) -> float:
    """Distance between two boxes; 0 where they overlap."""
    return compute_base_distance(a.x, a.y, a.cos, a.sin, (a.half_x, a.half_y), b)


BOUND_LEGS = 20_000
"""Most legs examined in the search for the bound of an escape."""
JOINT_LEGS = 1_000
"""Most legs of a puzzle whose legs are bounded jointly: six targets in any order have 1,000."""
GIVE = 0.01
"""Most that a wall gives way to a body, m."""
CELLS = 8
"""Cells along the longer side of the place of a target."""


def bound_escape(instance: RoomInstance, state: RoomState) -> float:
    """Fewest primitives of an escape that straight lines allow, over all orders of the puzzle's operators.

    Infinity without such an order. If a thing was put down elsewhere than in its first place, only the line to the
    exit counts.
    """
    bounds = LegBounds(instance)
    if _has_moved_things(instance, state):
        return max(1.0, bounds.bound_start(state, None))
    search = TaskSearch(instance.symbolic_model, lower_bound=bounds.bound_leg)
    facts = instance.puzzle.symbolic.get_facts(state.puzzle)

    def extend(last: Operator | None, then: Operator | None) -> Leg:
        cost = bounds.bound_start(state, then) if last is None else bounds.bound_leg(last, then)
        return Leg(cost, then)

    legs = search.list_legs(facts, JOINT_LEGS + 1)
    if len(legs) <= JOINT_LEGS:
        return max(1.0, _bound_jointly(instance, state, bounds, search, legs))
    tasks = search.find_order(facts, None, extend, BOUND_LEGS)
    return math.inf if tasks is None else max(1.0, tasks.lower_bound)


def _has_moved_things(instance: RoomInstance, state: RoomState) -> bool:
    """A thing that can be gripped lies in another cell of its map than at first."""
    puzzle = instance.puzzle
    if not isinstance(puzzle, Mapped):
        return False
    grips = {op.target for op in instance.symbolic_model.operators if op.action == "grip"}
    return any(_has_moved(puzzle, state, target) for target, name in enumerate(puzzle.target_names) if name in grips)


def _has_moved(puzzle: Mapped, state: RoomState, target: int) -> bool:
    """A target lies in another cell of its map than at first; one that is held lies nowhere."""
    return any(puzzle.blockable_cells[number] != puzzle.target_cells[target]
               for number in puzzle.list_cells(state.puzzle, "grip", target))


def _bound_jointly(instance: RoomInstance, state: RoomState, bounds: LegBounds, search: TaskSearch,
                   legs: Sequence[tuple[TaskNode, TaskNode]]) -> float:
    operators = {number: search.operators[number] for _, (_, number) in legs if number >= 0}
    cells = {number: _cut_place(instance, bounds, operator) for number, operator in operators.items()}
    cells[EXIT] = _cut_place(instance, bounds, None)
    after: dict[TaskNode, list[TaskNode]] = {}
    for node, then in legs:
        after.setdefault(node, []).append(then)
    known: dict[tuple[int, int], NDArray[np.float64]] = {}

    def compute_costs(last: int, then: int) -> NDArray[np.float64]:
        """Primitives of a leg from each cell of `last` to each of `then`, (cells, cells)."""
        key = last, then
        if key not in known:
            to = operators.get(then)
            if last == START:
                least, place = bounds.bound_start(state, to), np.array([[state.x, state.y, state.x, state.y]])
            else:
                least, place = bounds.bound_leg(operators[last], to), cells[last]
            known[key] = np.maximum(least, np.ceil(_compute_gaps(place, cells[then]) / bounds.step - 1e-9))
        return known[key]

    begin = legs[0][0]
    costs: dict[TaskNode, NDArray[np.float64]] = {begin: np.zeros(1)}
    best, queue = math.inf, [(0.0, begin)]
    while queue:  # from the cheapest; a node whose cells get cheaper comes again
        least, node = heapq.heappop(queue)
        if least >= best:
            break
        for then in after.get(node, ()):
            found = (costs[node][:, None] + compute_costs(node[1], then[1])).min(axis=0, initial=math.inf)
            if then[1] == EXIT:
                best = min(best, float(found.min(initial=math.inf)))
                continue
            old = costs.get(then)
            better = found if old is None else np.minimum(old, found)
            if old is None or (better < old).any():
                costs[then] = better
                heapq.heappush(queue, (float(found.min(initial=math.inf)), then))
    return best


def _cut_place(instance: RoomInstance, bounds: LegBounds, op: Operator | None) -> NDArray[np.float64]:
    """Boxes x_low, y_low, x_high, y_high (cells, 4) that hold every place of the body's axis at the end of a leg.

    There are none if the target cannot be touched.
    """
    if op is not None and bounds.is_anywhere(op):
        return np.array([[-np.inf, -np.inf, np.inf, np.inf]])
    shape, reach = bounds.get_place(op)
    if reach < 0.0:
        return np.zeros((0, 4))
    half = _measure(shape) + reach
    low, high = np.array([shape.x, shape.y]) - half, np.array([shape.x, shape.y]) + half
    longest = max((high - low).max(), 1e-9)  # an exit may be a point
    counts = np.maximum(1, np.ceil((high - low) / (longest / CELLS) - 1e-9)).astype(int)
    edges = [np.linspace(low[axis], high[axis], counts[axis] + 1) for axis in (0, 1)]
    x, y = (part.ravel() for part in np.meshgrid(*(np.arange(count) for count in counts), indexing="ij"))
    boxes = np.stack([edges[0][x], edges[1][y], edges[0][x + 1], edges[1][y + 1]], axis=1)
    inner = np.array([instance.half_width, instance.half_depth]) - instance.robot.inner_radius + GIVE
    clipped = np.concatenate([np.maximum(boxes[:, :2], -inner), np.minimum(boxes[:, 2:], inner)], axis=1)
    is_in_room = (clipped[:, :2] <= clipped[:, 2:]).all(axis=1)
    area = instance.exit
    way_out = np.array([[area.x_min, area.y_min, area.x_max, area.y_max]])
    is_near_exit = _compute_gaps(boxes, way_out)[:, 0] <= instance.robot.outer_radius  # the alcove behind a door
    boxes = np.where(is_near_exit[:, None], boxes, clipped)
    kept = boxes[is_in_room | is_near_exit]
    return kept if op is None else kept[_compute_gaps(kept, np.array([_bound(shape)]))[:, 0] <= reach + 1e-9]


def _measure(shape: Footprint) -> NDArray[np.float64]:
    """Half sides of the upright box round a footprint."""
    if shape.is_disc:
        return np.array([shape.half_x, shape.half_x])
    cos, sin = abs(shape.cos), abs(shape.sin)
    return np.array([cos * shape.half_x + sin * shape.half_y, sin * shape.half_x + cos * shape.half_y])


def _bound(shape: Footprint) -> NDArray[np.float64]:
    half, centre = _measure(shape), np.array([shape.x, shape.y])
    return np.concatenate([centre - half, centre + half])


def _compute_gaps(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distances between upright boxes, (n, 4) and (m, 4) to (n, m); 0 where they overlap."""
    apart = np.maximum(a[:, None, :2] - b[None, :, 2:], b[None, :, :2] - a[:, None, 2:])
    return np.hypot(*np.moveaxis(np.maximum(apart, 0.0), 2, 0))
