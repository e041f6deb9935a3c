"""Lower bound on the primitives of a whole escape, from geometry alone: straight lines, no obstacles.

Bounds of legs add up as if the robot could leave a press at another place than it arrived at. In puzzles of few states
the legs are bounded jointly: each place from which a target can be pressed is cut into cells, and the fewest
primitives to be in each cell after each press follow from those of the press before (dynamic programming over states of
the puzzle, targets and cells). A cell holds more than one pose, so the bound stays one.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.geometry import Footprint
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.puzzles.symbolic import Operator
from hrl_escape.planning.lower_bounds import LegBounds
from hrl_escape.planning.symbolic.operator_order import EXIT, START, Leg, TaskNode, TaskSearch

BOUND_LEGS = 20_000
"""Most legs examined in the search for the bound of an escape."""
JOINT_LEGS = 1_000
"""Most legs of a puzzle whose legs are bounded jointly: six targets in any order have 1,000."""
GIVE = 0.01
"""Most that a wall gives way to a body, m."""
CELLS = 8
"""Cells along the longer side of the place of a target."""


def bound_escape(instance: RoomInstance, state: RoomState) -> float:
    """Fewest primitives of an escape that straight lines allow, over all orders; infinity if no order escapes."""
    bounds = LegBounds(instance)
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
            found = (costs[node][:, None] + compute_costs(node[1], then[1])).min(axis=0)
            if then[1] == EXIT:
                best = min(best, float(found.min()))
                continue
            old = costs.get(then)
            better = found if old is None else np.minimum(old, found)
            if old is None or (better < old).any():
                costs[then] = better
                heapq.heappush(queue, (float(found.min()), then))
    return best


def _cut_place(instance: RoomInstance, bounds: LegBounds, op: Operator | None) -> NDArray[np.float64]:
    """Boxes x_low, y_low, x_high, y_high (cells, 4) that hold every place of the body's axis at the end of a leg."""
    if op is not None and bounds.is_anywhere(op):
        return np.array([[-np.inf, -np.inf, np.inf, np.inf]])
    shape, reach = bounds.get_place(op)
    half = _measure(shape) + reach
    low, high = np.array([shape.x, shape.y]) - half, np.array([shape.x, shape.y]) + half
    counts = np.maximum(1, np.ceil((high - low) / ((high - low).max() / CELLS) - 1e-9)).astype(int)
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
