"""Several goals in one search: where one leg ends is chosen for the sake of the next.

Options reach one goal after another, each with the fewest primitives, and so may end where the
next leg is longer. Here cost-to-go fields are chained backwards through all goals and an A*
over primitives follows them, so the legs are as short *together* as the fields can tell. It
is what the best known return of a room rests on; body presses only.
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
from hrl_escape.options.goals import ExitGoal, Goal, PressGoal
from hrl_escape.options.lattice.areas import compute_area
from hrl_escape.options.lattice.fields import FieldMaker

__all__ = ["find_joint_plan"]

TRANSLATIONS = 4
SLACKS = (0, 2)
"""Primitives by which a field's price is lowered: first trusted, to have a plan soon, then doubted."""
EXPANSIONS = 20_000


class _Stage:
    """One goal: the price, at every cell and heading of a grid, of this goal and all that follow."""

    def __init__(self, maker: FieldMaker, field: NDArray[np.int16]) -> None:
        self._prices: list[int] = field.tolist()
        self._low_x, self._low_y = maker.low.tolist()
        self._size, self._classes = maker.size, maker.classes
        self._columns, self._rows = maker.shape

    def find_place(self, state: RoomState) -> int:
        """Number of the cell and heading class that a pose lies in."""
        i = min(max(int((state.x - self._low_x) / self._size), 0), self._columns - 1)
        j = min(max(int((state.y - self._low_y) / self._size), 0), self._rows - 1)
        return (i * self._rows + j) * self._classes + state.heading_steps % self._classes

    def get_price(self, place: int) -> int:
        """Primitives still to come, about; -1 where the goals cannot be reached."""
        return self._prices[place]


def find_joint_plan(rules: Kinematics, state: RoomState, goals: Sequence[Goal], shut: FieldMaker,
                    opened: FieldMaker, most: int, expansions: int = EXPANSIONS) -> tuple[int, ...] | None:
    """Search for primitives that press targets in order and then escape.

    Args:
        rules: kinematics without noise and slip.
        state: where to begin; its heading is on the lattice.
        goals: `PressGoal`s in order, then `ExitGoal`.
        shut: field maker of the room with its door shut.
        opened: the same with the door open, for the last leg.
        most: plans of this many primitives are of no use.
        expansions: nodes that each of two searches may expand.

    Returns:
        Fewer than `most` primitives that end the episode by escaping, or None.
    """
    stages = _chain_fields(rules, state, goals, shut, opened)
    if stages is None or stages[0].get_price(stages[0].find_place(state)) < 0:
        return None
    best = None
    for slack in SLACKS:
        found = _search(rules, state, goals, stages, slack, most if best is None else len(best), expansions)
        best = found or best
    return best


def _search(rules: Kinematics, state: RoomState, goals: Sequence[Goal], stages: Sequence[_Stage], slack: int,
            most: int, expansions: int) -> tuple[int, ...] | None:
    """A* over primitives; poses in one cell of the fields' grid count as one."""
    tie = itertools.count()
    heap: list[tuple[int, int, int, int, RoomState, Any]] = [(0, 0, next(tie), 0, state, None)]
    best: dict[tuple[int, int, bool], int] = {}
    for _ in range(expansions):
        if not heap:
            return None
        _, less, _, number, here, trail = heapq.heappop(heap)  # of equal estimates the one that has come farthest
        if trail is not None and trail[2]:
            return _unwind(trail)
        spent = 1 - less
        for action in range(TRANSLATIONS + 2):
            step = rules.step(here, action)
            after, then = step.state, number
            if after[:6] == here[:6]:
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
            price = stages[then].get_price(place)
            total = spent + max(price - slack, 0)
            key = (then, place, after.touching != 0)
            if 0 <= price and total < most and spent < best.get(key, most):
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
                  opened: FieldMaker) -> list[_Stage] | None:
    """Fields from the last goal backwards: reaching a goal is worth what remains from where that leads."""
    area = compute_area(ExitGoal(), rules.instance)
    following = _Stage(opened, opened.make_field(area.footprint, area.reach))
    stages = [following]
    for goal in reversed(goals[:-1]):
        assert isinstance(goal, PressGoal)
        seeds, costs = _price_presses(rules, state, goal, shut, following)
        if not seeds:
            return None
        following = _Stage(shut, shut.spread(np.array(seeds), np.array(costs), shut.classes))
        stages.insert(0, following)
    return stages


def _price_presses(rules: Kinematics, state: RoomState, goal: PressGoal, maker: FieldMaker, following: _Stage
                   ) -> tuple[list[int], list[int]]:
    """States of the grid from which one primitive presses the target, and what it and the rest cost."""
    area = compute_area(goal, rules.instance)
    step = rules.instance.robot.move_step
    away = compute_distance_many(maker.points, stack_footprints([area.footprint]))
    near = np.flatnonzero(maker.standing & (away > area.reach) & (away <= area.reach + step))
    seeds, costs = [], []
    for cell in near.tolist():
        x, y = maker.points[cell].tolist()
        for heading in range(maker.classes):
            begin = state._replace(x=x, y=y, heading_steps=heading, heading_offset=0.0, touching=0)
            least = -1
            for action in range(TRANSLATIONS):
                reached = rules.step(begin, action)
                if reached.pressed == (goal.target,):
                    price = following.get_price(following.find_place(reached.state))
                    if price >= 0 and (least < 0 or price < least):
                        least = price
            if least >= 0:
                seeds.append(cell * maker.classes + heading)
                costs.append(1 + least)
    return seeds, costs
