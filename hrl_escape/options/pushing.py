"""Pushes of a block onto a plate under rigid-body physics, in closed loop.

A cost-to-go field over the places of the block gives the next side to push from. The body must fit behind the block
there, and a change of sides costs a drive around it. Between pushes the base drives to a place behind the block, around
all blocks. The block is observed after every primitive, without predictions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.floor_grid import FloorGrid
from hrl_escape.env.geometry import Footprint, compute_distance, compute_distance_many, stack_footprints
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import PlanningFailed, PlanningReason
from hrl_escape.options.option import Option
from hrl_escape.planning.goals import PoseGoal, PushGoal, find_push
from hrl_escape.planning.planner import RoomPlanner
from hrl_escape.planning.props import GRAZE, get_prop_poses, list_blocks, meets
from hrl_escape.planning.route import Route

CELL = 0.25
SIDES = tuple((i, j) for i in range(-2, 3) for j in range(-2, 3) if math.gcd(i, j) == 1)
"""Directions of pushes on the grid, in cells."""
CHANGE = 5.0
"""Cost of a drive to another side in the field, in primitives."""
ASIDE, ASKEW = 0.12, math.radians(6)
"""Largest offset of a push from the block's centre, in m, and from its direction, in rad."""
GAPS = (0.1, 0.4, 0.7)
"""Distances between body and block before a push, in moves."""
MOST_PUSH_PRIMITIVES = 400
DRIVES = ((3_000, False), (20_000, True))
"""Node budget of a drive behind the block, and whether finer grids are used: first a quick search, then a thorough
one."""


class _Push(NamedTuple):
    """Next push: from `block` along `direction` (rad) over `length` (m)."""

    block: tuple[float, float]
    direction: float
    length: float


class PushField:
    """Cost-to-go field of pushing a block from any place onto a plate."""

    def __init__(self, instance: RoomInstance, goal: PushGoal) -> None:
        block, plate = (instance.props[i] for i in (goal.prop, goal.destination))
        self._instance = instance
        self.half, self.radius = block.prop.half_size, instance.robot.outer_radius
        self.goal, self.goal_half = (plate.x, plate.y), plate.prop.half_size
        self._solids = stack_footprints([solid.footprint for solid in instance.all_solids])
        self._grid = FloorGrid.cover(instance.reach_x, instance.reach_y, CELL)

    @cached_property
    def costs(self) -> NDArray[np.float64]:
        """Return the cost-to-go of each cell, (cells,), in primitives; infinity if unreachable."""
        (columns, rows), cells = self._grid.shape, self._grid.cells
        i, j = self._grid.list_cells().T
        points = self._grid.get_centres()
        fits = compute_distance_many(points, self._solids) > self.half
        sources, sinks, costs = [], [], []
        for side, (di, dj) in enumerate(SIDES):
            length = CELL * math.hypot(di, dj)
            behind = points - np.array([di, dj]) * CELL / length * (self.radius + self.half + 0.1)
            stands = fits & (compute_distance_many(behind, self._solids) > self.radius + 0.02)
            ahead = (i + di) * rows + j + dj
            inside = (0 <= i + di) & (i + di < columns) & (0 <= j + dj) & (j + dj < rows)
            moves = np.flatnonzero(stands & inside)
            moves = moves[stands[ahead[moves]]]
            layer = (side + 1) * cells
            sources += [layer + moves, np.flatnonzero(stands), layer + np.arange(cells)]
            sinks += [layer + ahead[moves], layer + np.flatnonzero(stands), np.arange(cells)]
            costs += [np.full(len(moves), length / self._instance.robot.actions.stride),
                       np.full(int(stands.sum()), CHANGE), np.full(cells, 1e-6)]
        from scipy.sparse import coo_array, csgraph  # loads slowly

        size = (len(SIDES) + 1) * cells
        graph = coo_array((np.concatenate(costs), (np.concatenate(sinks), np.concatenate(sources))), (size, size))
        away = np.abs(points - self.goal).max(axis=1)
        seeds = np.flatnonzero(away <= max(CELL, self.goal_half / 2))
        return csgraph.dijkstra(graph.tocsr(), indices=seeds, min_only=True)[:cells]

    def get_cost(self, x: float, y: float) -> float:
        """Return the cost-to-go of a place; infinity outside the floor."""
        cell = self._grid.find_number(x, y)
        return float(self.costs[cell]) if cell >= 0 else math.inf

    def find_push(self, x: float, y: float, headings: int, others: Sequence[Footprint] = ()) -> _Push | None:
        """Return the best next push of the block from a place, among the headings of the base.

        Block and body keep clear of the footprints of `others`.
        """
        step = self._instance.robot.actions.stride
        goal_x, goal_y = self.goal
        left = math.hypot(goal_x - x, goal_y - y)
        best, found = math.inf, None
        for k in range(headings):
            direction = k * math.tau / headings
            cos, sin = math.cos(direction), math.sin(direction)
            away = self.radius + self.half
            behind = x - cos * (away + 0.05), y - sin * (away + 0.05)
            if not self._can_stand(*behind) or any(compute_distance(*behind, o) <= self.radius for o in others):
                continue
            along = (goal_x - x) * cos + (goal_y - y) * sin
            lengths = {0.5 * step, step} | ({along} if 0.05 < along < step and left < 2 * step else set())
            for length in sorted(lengths):
                to_x, to_y = x + cos * length, y + sin * length
                if meets(x, y, to_x, to_y, others, self.half * math.sqrt(2.0)):
                    continue
                cost = self.get_cost(to_x, to_y)
                off = math.hypot(goal_x - to_x, goal_y - to_y)
                total = (1.0 if length < step else length / step) + cost + 0.5 * min(off, step)
                if total < best and self._can_stand(to_x - cos * away, to_y - sin * away):
                    best, found = total, _Push((x, y), direction, length)
        return found

    def _can_stand(self, x: float, y: float) -> bool:
        return bool(compute_distance_many(np.array([[x, y]]), self._solids)[0] > self.radius)


class PushOption(Option):
    """Option that pushes a prop onto another in closed loop: go behind it, push, observe, repeat."""

    def __init__(self, name: str, planner: RoomPlanner, goal: PushGoal) -> None:
        super().__init__(name)
        self.instance, self.targets, self.goal = planner.instance, (), goal
        self._room, self._planner = planner.instance, planner
        self._facts = find_push(goal, planner.instance).add
        self._field = PushField(planner.instance, goal)
        self._count = 0
        self._route: Route | None = None
        self._standing: _Push | None = None
        self._place = PoseGoal(0.0, 0.0)

    def initiation(self, state: RoomState) -> bool:
        """Return whether the prop is not at its goal and can be pushed there."""
        return self.termination(state) == 0.0 and math.isfinite(self._field.get_cost(*self._get_place(state)))

    def start(self, state: RoomState) -> None:
        """Reset the pushes, the route and the place of an earlier run."""
        super().start(state)
        self._count, self._route, self._standing = 0, None, None

    def termination(self, state: RoomState) -> float:
        """Return 1 once the facts that the push adds hold in the puzzle."""
        return float(self._facts <= self._room.puzzle.symbolic.get_facts(state.puzzle))

    def _get_place(self, state: RoomState) -> tuple[float, float]:
        return get_prop_poses(state, self._room)[self.goal.prop][:2]

    def policy(self, state: RoomState) -> int:
        """Return a push if the base is behind the block, otherwise a primitive of the drive there."""
        self._count += 1
        if self._count > MOST_PUSH_PRIMITIVES:
            raise self._planner.routes.make_failure(PlanningReason.BUDGET_EXHAUSTED, state, self.goal,
                                             nearest=f"{self._count - 1} primitives of pushing")
        push = self._find_push(state)
        if push is None:
            raise self._planner.routes.make_failure(PlanningReason.UNREACHABLE_AT_RESOLUTION, state, self.goal,
                                             nearest="no side to push from")
        primitive = self._find_pusher(state, push)
        if primitive is not None:
            self._route = None
            return primitive
        return self._drive(state, push)

    def _find_push(self, state: RoomState) -> _Push | None:
        """Return the best next push, around all other blocks or else around those already in place."""
        for others in (list_blocks(state, self._room, without=self.goal.prop),
                       list_blocks(state, self._room, without=self.goal.prop, only_done=True), ()):
            push = self._field.find_push(*self._get_place(state), self._planner.rules.headings, others)
            if push is not None:
                return push
        return None

    def _find_pusher(self, state: RoomState, push: _Push) -> int | None:
        """Return the number of the translation that makes the push from the base's present place, or None."""
        heading = self._planner.rules.get_heading(state)
        dx, dy = push.block[0] - state.x, push.block[1] - state.y
        actions = self._planner.rules.actions
        for primitive in actions.translations:
            move, step = actions.primitives[primitive], actions.primitives[primitive].length
            angle = heading + math.atan2(move.left, move.forward)
            if abs((angle - push.direction + math.pi) % math.tau - math.pi) > ASKEW:
                continue
            along, aside = dx * math.cos(angle) + dy * math.sin(angle), dy * math.cos(angle) - dx * math.sin(angle)
            gap = along - self._field.radius - self._field.half
            moved = step - max(gap, 0.0)
            if along > 0 and abs(aside) <= ASIDE and moved > 0.1 * step and (
                moved <= push.length + max(0.15 * step, self._field.goal_half / 2)
            ):
                return primitive
        return None

    def _drive(self, state: RoomState, push: _Push) -> int:
        """Return the next primitive of the drive to a place behind the block."""
        if self._route is not None and self._standing is not None:
            moved = math.hypot(push.block[0] - self._standing.block[0], push.block[1] - self._standing.block[1])
            rest = self._route.primitives[1:]
            again = self._planner.routes.replay(state, rest, self._place) if rest and moved < 0.02 else None
            if again is not None:
                self._route = again
                return again.primitives[0]
        self._route = self._find_route(state, push)
        self._standing = push
        return self._route.primitives[0]

    def _find_route(self, state: RoomState, push: _Push) -> Route:
        blocks = list_blocks(state, self._room, grown=-GRAZE)
        step, turn = self._planner.rules.actions.stride, math.pi / 2
        heading = self._planner.rules.get_heading(state)
        facing = push.direction + turn * round((heading - push.direction) / turn)
        wanted = 1.0 - push.length / step
        failure: PlanningFailed | None = None
        gaps = dict.fromkeys((max(wanted, 0.05), *(GAPS if push.length >= step else ())))
        for gap, (budget, refine) in ((gap, drive) for drive in DRIVES for gap in gaps):
            away = self._field.radius + self._field.half + gap * step
            self._place = PoseGoal(push.block[0] - away * math.cos(push.direction),
                                   push.block[1] - away * math.sin(push.direction), facing, 0.1 * step, ASKEW / 2)
            try:
                route = self._planner.routes.find_route_around(state, self._place, blocks, budget, self.report,
                                                               refine=refine)
            except PlanningFailed as failed:
                failure = failed
                continue
            if route.primitives:
                return route
        raise failure or self._planner.routes.make_failure(PlanningReason.UNREACHABLE_AT_RESOLUTION, state, self.goal)
