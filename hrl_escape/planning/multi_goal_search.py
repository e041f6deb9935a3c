"""A* through several goals at once, so that each leg ends where the rest is shortest.

Options reach one goal after another, each with the fewest primitives, and so may end where the
next leg is longer. Here cost-to-go fields are chained backwards through all goals, and one A* over
primitives follows them: the legs are shortest *together*, as far as the fields can tell. The best
known return of a room rests on this search. Body presses only.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.geometry import compute_distance_many, stack_footprints
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.planning.goals import ExitGoal, Goal, PressGoal
from hrl_escape.planning.lattice.areas import compute_goal_area
from hrl_escape.planning.lattice.cost_to_go import FieldMaker, Seeds

__all__ = ["find_multi_goal_plan"]

HEURISTIC_OFFSETS = (0, 2)
"""Primitives subtracted from the cost-to-go in each search: none for a quick plan, then some for a shorter one."""
NODES_A_SEARCH = 20_000
"""Nodes that each search may expand."""


class _GoalField:
    """Cost-to-go of one goal and all that follow, at every cell and heading of a grid."""

    def __init__(self, maker: FieldMaker, field: NDArray[np.int16]) -> None:
        self._costs: list[int] = field.tolist()
        self._low_x, self._low_y = maker.low.tolist()
        self._size, self._classes = maker.size, maker.classes
        self._columns, self._rows = maker.shape

    def find_place(self, state: RoomState) -> int:
        """Index of the cell and heading class of a pose."""
        i = min(max(int((state.x - self._low_x) / self._size), 0), self._columns - 1)
        j = min(max(int((state.y - self._low_y) / self._size), 0), self._rows - 1)
        return (i * self._rows + j) * self._classes + state.heading_steps % self._classes

    def get_cost_to_go(self, place: int) -> int:
        """Approximate primitives to the last goal; -1 where the goals cannot be reached."""
        return self._costs[place]


def find_multi_goal_plan(rules: Kinematics, state: RoomState, goals: Sequence[Goal], shut: FieldMaker,
                         opened: FieldMaker, most: int) -> tuple[int, ...] | None:
    """Search for primitives that press targets in order and then escape.

    Args:
        rules: kinematics without noise and slip.
        state: first state; its heading is on the lattice.
        goals: `PressGoal`s in order, then `ExitGoal`.
        shut: field maker of the room with its door shut.
        opened: the same with the door open, for the last leg.
        most: plans of this many primitives or more are discarded.

    Returns:
        Fewer than `most` primitives that end the episode by escaping, or None.
    """
    stages = _chain_fields(rules, state, goals, shut, opened)
    if stages is None or stages[0].get_cost_to_go(stages[0].find_place(state)) < 0:
        return None
    best = None
    for offset in HEURISTIC_OFFSETS:
        found = _search_goals(rules, state, goals, stages, offset, most if best is None else len(best))
        best = found or best
    return best


def _search_goals(rules: Kinematics, state: RoomState, goals: Sequence[Goal], stages: Sequence[_GoalField], offset: int,
                  most: int) -> tuple[int, ...] | None:
    """A* over primitives; poses in one cell of the fields' grid count as one."""
    tie = itertools.count()
    heap: list[tuple[int, int, int, int, RoomState, Any]] = [(0, 0, next(tie), 0, state, None)]
    best: dict[tuple[int, int, bool], int] = {}
    for _ in range(NODES_A_SEARCH):
        if not heap:
            return None
        _, less, _, number, here, trail = heapq.heappop(heap)  # ties go to the longest plan so far
        if trail is not None and trail[2]:
            return _unwind(trail)
        spent = 1 - less
        for action in rules.actions.base:
            step = rules.step(here, action)
            after, then = step.state, number
            if after.has_pose_of(here):
                continue
            if step.pressed:
                if step.pressed != (getattr(goals[number], "target", None),):
                    continue
                then += 1
            if step.terminated and spent < most:
                heapq.heappush(heap, (spent, -spent, next(tie), then, after, (trail, action, True)))
            if step.terminated or then == len(goals):
                continue
            place = stages[then].find_place(after)
            cost_to_go = stages[then].get_cost_to_go(place)
            total = spent + max(cost_to_go - offset, 0)
            key = (then, place, after.touching != 0)
            if 0 <= cost_to_go and total < most and spent < best.get(key, most):
                best[key] = spent
                heapq.heappush(heap, (total, -spent, next(tie), then, after, (trail, action, False)))
    return None


def _unwind(trail: tuple | None) -> tuple[int, ...]:
    actions = []
    while trail is not None:
        trail, action, _ = trail
        actions.append(action)
    return tuple(reversed(actions))


def _chain_fields(rules: Kinematics, state: RoomState, goals: Sequence[Goal], shut: FieldMaker,
                  opened: FieldMaker) -> list[_GoalField] | None:
    """Compute fields from the last goal backwards: the cost of reaching a goal includes the cost-to-go from there."""
    area = compute_goal_area(ExitGoal(), rules.instance)
    following = _GoalField(opened, opened.make_field(opened.find_seeds(*area)))
    stages = [following]
    for goal in reversed(goals[:-1]):
        assert isinstance(goal, PressGoal)
        seeds, costs = _find_press_states(rules, state, goal, shut, following)
        if not seeds:
            return None
        following = _GoalField(shut, shut.make_field(Seeds(np.array(seeds), np.array(costs), shut.classes)))
        stages.insert(0, following)
    return stages


def _find_press_states(rules: Kinematics, state: RoomState, goal: PressGoal, maker: FieldMaker, following: _GoalField
                   ) -> tuple[list[int], list[int]]:
    """States of the grid from which one primitive presses the target, and their cost-to-go to the last goal."""
    area = compute_goal_area(goal, rules.instance)
    step = rules.instance.robot.move_step
    away = compute_distance_many(maker.points, stack_footprints([area.footprint]))
    near = np.flatnonzero(maker.standing & (away > area.reach) & (away <= area.reach + step))
    seeds, costs = [], []
    for cell in near.tolist():
        x, y = maker.points[cell].tolist()
        for heading in range(maker.classes):
            begin = state._replace(x=x, y=y, heading_steps=heading, heading_offset=0.0, touching=0)
            least = -1
            for action in rules.actions.translations:
                reached = rules.step(begin, action)
                if reached.pressed == (goal.target,):
                    cost_to_go = following.get_cost_to_go(following.find_place(reached.state))
                    if cost_to_go >= 0 and (least < 0 or cost_to_go < least):
                        least = cost_to_go
            if least >= 0:
                seeds.append(cell * maker.classes + heading)
                costs.append(1 + least)
    return seeds, costs
