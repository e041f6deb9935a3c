"""Grid of one room on which the cost-to-go fields of its goals are found together.

Fields start from estimates on the planners' grid (`lattice/cost_to_go.py`), and are found by value
iteration on a finer one (`value_iteration.py`). The goal of a press is a move that begins to touch a target with the
body, or the states from which the hand touches it in one posture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.geometry import compute_distance_many
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.options.batched.value_iteration import AT_GOAL, UNREACHABLE, encode_values, iterate_values, trace_moves
from hrl_escape.planning.goals import ExitGoal, Goal, PressGoal
from hrl_escape.planning.lattice.areas import compute_goal_area
from hrl_escape.planning.lattice.cost_to_go import FieldMaker, Seeds, lay_grid
from hrl_escape.planning.lattice.dijkstra_kernels import choose_points

__all__ = ["OTHER_PRESS_COST", "FieldGrid"]

OTHER_PRESS_COST = 100.0
"""Cost of touching another target: an option does so only where nothing else leads to its goal."""
_FINE_STATES = 600_000  # cells are halved, at most twice, up to this many (cell, heading) states
_TOLERANCE, _SWEEPS = 0.02, 80
_NO_TARGET = 1 << 63  # bit of a goal that no move begins to touch


class FieldGrid:
    """Grid of one room with its door, if any, shut or open, on which fields are computed.

    Attributes:
        maker: the planners' grid.
        size: side of a cell, m.
        shape: columns and rows of cells.
        states: cells times headings.
    """

    def __init__(self, instance: RoomInstance, rules: Kinematics, offset: float, door_shut: bool) -> None:
        self._instance, exit_ = instance, instance.exit
        self.maker = maker = FieldMaker(instance, rules, door_shut=door_shut)
        by_hand = instance.dynamics.press_with == "hand"
        self._headings = maker.headings if by_hand else maker.classes  # a hand points one way
        states = maker.states * self._headings // maker.classes
        self._refinement = min(int(math.log(max(_FINE_STATES / states, 1.0), 4)), 2)
        _, self.size, self.shape = lay_grid(instance, rules, self._refinement)
        self._points, self._standing = np.empty((math.prod(self.shape), 2)), np.zeros(math.prod(self.shape), np.bool_)
        self.states = self._headings * len(self._points)
        choose_points(maker.scene, maker.low, self.size, self.shape[1], 0, self.shape[0],
                      np.ones_like(self._standing), self._points, self._standing)
        columns, rows = (np.arange(side) >> self._refinement for side in self.shape)
        self._cells = (columns[:, None] * maker.shape[1] + rows).ravel()  # of the planners' grid
        self._angles = np.arange(self._headings) * rules.turn_step + offset
        moves = instance.robot.move_step * rules.actions.compute_moves(np.cos(self._angles), np.sin(self._angles))
        targets = maker.targets[:0] if by_hand else maker.targets
        reaches = np.array([instance.compute_press_reach(target) for target in instance.targets], dtype=np.float64)
        self._moves = trace_moves(maker.scene, self._points, self._standing, self.shape[1], maker.low, self.size, moves,
                                  targets, reaches[: len(targets)],
                                  np.array([exit_.x_min, exit_.x_max, exit_.y_min, exit_.y_max]))
        self._touches = np.array([compute_distance_many(maker.points, row[None]) <= reach
                                  for row, reach in zip(targets, reaches, strict=False)]
                                 ).reshape(-1, len(maker.points))
        x, y = maker.points.T
        self._is_outside = (x < exit_.x_min) | (x > exit_.x_max) | (y < exit_.y_min) | (y > exit_.y_max)

    def compute_fields(self, goals: Sequence[tuple[Goal, bool]]) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
        """Compute the cost-to-go of goals, each beside whether entering the exit ends the episode without it.

        Returns:
            `values` and `scales` of `InstanceFields`.
        """
        estimates = {goal: self._estimate(goal) for goal in dict.fromkeys(goal for goal, _ in goals)}
        values = np.stack([estimates[goal][leaves].T[:, self._cells] for goal, leaves in goals], axis=2)
        own = np.array([1 << goal.target if isinstance(goal, PressGoal) else 0 for goal, _ in goals], dtype=np.uint64)
        return self._iterate(values, own, [UNREACHABLE * leaves for _, leaves in goals])

    def compute_hand_fields(self, approaches: NDArray[np.float64], limit: float
                            ) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
        """Compute the cost-to-go of presses by hand, each in one posture, and last that of the exit.

        Args:
            approaches: rows of (target, x, y, z): the hand in the base frame, m.
            limit: largest distance from the hand's centre that touches, m.

        Returns:
            `values` and `scales` of `InstanceFields`.
        """
        way_out = np.tile(self._estimate(ExitGoal())[0], self._headings // self.maker.classes).T[:, self._cells]
        values = [*(self._estimate_press(int(target), hand, limit) for target, *hand in approaches.tolist()), way_out]
        own = np.full(len(values), _NO_TARGET, dtype=np.uint64)
        own[-1] = 0
        return self._iterate(np.stack(values, axis=2), own, [OTHER_PRESS_COST] * len(approaches) + [0.0])

    def _iterate(self, values: NDArray[np.float32], own: NDArray[np.uint64], leaving: Sequence[float]
                 ) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
        """Find fields from estimates (headings, cells, fields); see `iterate_values`."""
        values = np.where(self._standing[:, None], values, np.float32(UNREACHABLE)).reshape(len(values), -1)
        iterate_values(values, self._moves, own, np.array(leaving, dtype=np.float32), np.float32(OTHER_PRESS_COST),
                       np.float32(_TOLERANCE), _SWEEPS)
        return encode_values(values, len(own))

    def _estimate(self, goal: Goal) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Estimate the cost-to-go of a goal on the planners' grid, float32 (cells, classes), twice.

        Presses go round the exit, in the first estimate where that is possible, in the second always.
        """
        maker = self.maker
        is_press = isinstance(goal, PressGoal)
        others = np.delete(self._touches, goal.target, axis=0) if is_press else self._touches
        seeds = maker.find_seeds(*compute_goal_area(goal, self._instance))
        stays = self._is_outside if is_press else maker.everywhere
        allowed = stays & ~others.any(axis=0)
        costs = [maker.make_field(seeds, allowed)] * 2
        if (costs[0].reshape(-1, maker.classes)[maker.standing & allowed] < 0).any():
            # some places can be left only past another target or through the exit
            wider = maker.make_field(seeds), maker.make_field(seeds, stays)
            costs = [np.where((least < 0) & (more >= 0), more + np.int16(OTHER_PRESS_COST), least)
                     for least, more in zip(costs, wider, strict=True)]
        first, second = (np.where(cost >= 0, cost, np.float32(UNREACHABLE)).reshape(-1, maker.classes)
                         for cost in costs)
        return first, second

    def _estimate_press(self, target: int, hand: Sequence[float], limit: float) -> NDArray[np.float32]:
        """Estimate the cost-to-go of a touch by a hand that rests, float32 (headings, cells); `AT_GOAL` in touch."""
        goal, outline = self._instance.targets[target], self.maker.targets[target][None]
        beyond = max(abs(hand[2] - goal.z) - goal.half_z, 0.0)
        reach = math.sqrt(max(limit**2 - beyond**2, 0.0))
        cos, sin = np.cos(self._angles), np.sin(self._angles)
        offsets = np.stack([cos * hand[0] - sin * hand[1], sin * hand[0] + cos * hand[1]], axis=1)  # (headings, 2)
        away = compute_distance_many(self._points, outline)
        near = np.flatnonzero(self._standing & (away <= math.hypot(*hand[:2]) + reach))
        places = (self._points[near] + offsets[:, None]).reshape(-1, 2)
        heading, which = np.nonzero((compute_distance_many(places, outline) <= reach).reshape(len(offsets), -1))
        if len(which) == 0:
            return np.full((self._headings, len(self._points)), UNREACHABLE, dtype=np.float32)
        states = np.unique(self._cells[near[which]] * self._headings + heading)
        costs = self.maker.make_field(Seeds(states, np.zeros_like(states), self._headings)).reshape(-1, self._headings)
        values = np.where(costs >= 0, np.maximum(costs, 1), UNREACHABLE).astype(np.float32).T[:, self._cells]
        values[heading, near[which]] = AT_GOAL
        return values
