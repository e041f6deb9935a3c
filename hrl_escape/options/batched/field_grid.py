"""Grid of one room on which the cost-to-go fields of its goals are found together.

Cells are those of the planners' grid (`floor/cost_to_go.py`), halved. The goal of a press is a move that begins to
touch a target with the body, or the states from which the hand touches it in one posture; `value_iteration.py` goes
from there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.geometry import compute_distance_many, stack_footprints
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.floor.cost_to_go import count_classes, lay_grid, make_collision
from hrl_escape.floor.dijkstra import choose_points
from hrl_escape.floor.sweeps import make_sweep_scene
from hrl_escape.options.batched.value_iteration import AT_GOAL, UNREACHABLE, encode_values, iterate_values, trace_moves
from hrl_escape.planning.goals import Goal, PressGoal

OTHER_PRESS_COST = 100.0
"""Cost of touching another target: an option does so only where nothing else leads to its goal."""
_FINE_STATES = 600_000  # cells are halved, at most twice, up to this many (cell, heading) states
_TOLERANCE, _SWEEPS = 0.5, 80
_NO_TARGET = 1 << 63  # bit of a goal that no move begins to touch


class FieldGrid:
    """Grid of one room with its door, if any, shut or open, on which fields are computed.

    Attributes:
        low: corner of the grid, shape (2,), m.
        size: side of a cell, m.
        shape: columns and rows of cells.
        states: cells times headings.
    """

    def __init__(self, instance: RoomInstance, rules: Kinematics, offset: float, door_shut: bool) -> None:
        self._instance, exit_, step = instance, instance.exit, rules.actions.longest
        by_hand = instance.dynamics.press_with == "hand"
        headings = rules.headings if by_hand else count_classes(rules)  # a hand points one way, so all headings differ
        states = lay_grid(instance, rules).cells * headings
        refinement = min(int(math.log(max(_FINE_STATES / states, 1.0), 4)), 2)
        grid = lay_grid(instance, rules, refinement)
        self.low, self.size, self.shape = grid
        collision = make_collision(instance, door_shut)
        scene = make_sweep_scene(collision, len(instance.solids) if door_shut and instance.door else -1, step)
        self._points, self._standing = np.empty((grid.cells, 2)), np.zeros(grid.cells, np.bool_)
        self.states = headings * len(self._points)
        choose_points(scene, self.low, self.size, self.shape[1], 0, self.shape[0],
                      np.ones_like(self._standing), self._points, self._standing)
        self._angles = np.arange(headings) * rules.turn_step + offset
        moves = rules.actions.compute_moves(np.cos(self._angles), np.sin(self._angles))
        self._turn_steps = rules.actions.turn_steps
        pressed = () if by_hand else instance.targets
        reaches = np.array([instance.compute_press_reach(target) for target in pressed], dtype=np.float64)
        self._moves = trace_moves(scene, self._points, self._standing, self.shape[1], self.low, self.size, moves,
                                  stack_footprints([target.footprint for target in pressed]), reaches,
                                  np.array([exit_.x_min, exit_.x_max, exit_.y_min, exit_.y_max]))

    def compute_fields(self, goals: Sequence[tuple[Goal, bool]]) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
        """Compute the cost-to-go of goals; each comes with a flag: entering the exit ends the episode without it.

        Returns:
            `values` and `scales` of `InstanceFields`.
        """
        own = np.array([1 << goal.target if isinstance(goal, PressGoal) else 0 for goal, _ in goals], dtype=np.uint64)
        return self._iterate(self._make_values(len(goals)), own, [UNREACHABLE * leaves for _, leaves in goals])

    def compute_hand_fields(self, approaches: NDArray[np.float64], limit: float
                            ) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
        """Compute the cost-to-go of presses by hand, each in one posture, and last that of the exit.

        Args:
            approaches: rows of (target, x, y, z): the hand in the base frame, m.
            limit: largest distance from the hand's centre that touches, m.

        Returns:
            `values` and `scales` of `InstanceFields`.
        """
        values = self._make_values(len(approaches) + 1)
        for number, (target, *hand) in enumerate(approaches.tolist()):
            heading, cell = self._find_touching(int(target), hand, limit)
            values[heading, cell, number] = AT_GOAL
        own = np.full(len(approaches) + 1, _NO_TARGET, dtype=np.uint64)
        own[-1] = 0
        return self._iterate(values, own, [OTHER_PRESS_COST] * len(approaches) + [0.0])

    def _make_values(self, fields: int) -> NDArray[np.float32]:
        """Initial values, all `UNREACHABLE`, (headings, cells, fields)."""
        return np.full((len(self._angles), len(self._points), fields), UNREACHABLE, dtype=np.float32)

    def _iterate(self, values: NDArray[np.float32], own: NDArray[np.uint64], leaving: Sequence[float]
                 ) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
        """Find fields, (headings, cells, fields), from those of their states that are goals; see `iterate_values`."""
        values = values.reshape(len(values), -1)
        iterate_values(values, self._moves, self._turn_steps, own, np.array(leaving, dtype=np.float32),
                       np.float32(OTHER_PRESS_COST), np.float32(_TOLERANCE), _SWEEPS)
        return encode_values(values, len(own))

    def _find_touching(self, target: int, hand: Sequence[float], limit: float
                       ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Find the headings and cells of all states from which a hand that rests touches a target."""
        goal = self._instance.targets[target]
        outline = stack_footprints([goal.footprint])
        beyond = max(abs(hand[2] - goal.z) - goal.half_z, 0.0)
        reach = math.sqrt(max(limit**2 - beyond**2, 0.0))
        cos, sin = np.cos(self._angles), np.sin(self._angles)
        offsets = np.stack([cos * hand[0] - sin * hand[1], sin * hand[0] + cos * hand[1]], axis=1)  # (headings, 2)
        away = compute_distance_many(self._points, outline)
        near = np.flatnonzero(self._standing & (away <= math.hypot(*hand[:2]) + reach))
        places = (self._points[near] + offsets[:, None]).reshape(-1, 2)
        heading, which = np.nonzero((compute_distance_many(places, outline) <= reach).reshape(len(offsets), -1))
        return heading, near[which]
