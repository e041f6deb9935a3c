"""Situations: the pose, touched targets and facts of a room that tasks read, packed into an observation and back.

Without noise the vector is the full state of a room, except the number of primitives.
"""

from __future__ import annotations

from collections.abc import Hashable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from hrl_escape.agents.hierarchy.task import Seen
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.puzzles.symbolic import Operator
from hrl_escape.errors import PlanningFailed, UnsupportedError
from hrl_escape.planning.goals import ExitGoal, Goal, PressGoal
from hrl_escape.planning.planner import RoomPlanner, get_planner
from hrl_escape.planning.route import Route
from hrl_escape.planning.symbolic.operator_order import find_relevant_operators

SECTORS = 8
"""Largest number of directions in a learned low level."""

_Pose = tuple[int, int, int, tuple[int, ...], int, bool]
"""Column and row of a cell, sector of the heading, joints, touched targets as bits, an open door."""


class Situation(NamedTuple):
    """Situation of a room at one time."""

    state: RoomState  # pose and touching; the puzzle's state is one representative with the same open exit
    facts: frozenset[str]  # propositions that hold
    is_open: bool  # the exit is open


class Situations:
    """Predicates, views and plans of one room, for its tasks.

    Attributes:
        model: of the puzzle.
        operators: operators that are relevant to the exit.
        space: of packed observations.

    Raises:
        UnsupportedError: the puzzle requires more than presses.
    """

    def __init__(self, instance: RoomInstance, cell: float | None = None) -> None:
        self.model = model = instance.symbolic_model
        self.instance = instance
        self.operators: tuple[Operator, ...] = find_relevant_operators(model)
        if instance.inner_doors:
            raise UnsupportedError(f"no hierarchy is synthesised for the room {instance.name!r}: it has inner doors, "
                                   "and what tasks see does not say which of them are open")
        others = {operator.action for operator in self.operators} - {"press"}
        if others:
            asked = "its props must be pushed" if "push" in others else "its targets must be gripped"
            raise UnsupportedError(f"no hierarchy is synthesised for the puzzle {instance.puzzle.kind!r}: {asked}, and "
                                   "tasks are made of presses")
        if any(operator.when for operator in self.operators):
            raise UnsupportedError(f"no hierarchy is synthesised for the puzzle {instance.puzzle.kind!r}: its "
                                   "operators have conditional effects, and tasks are made of preconditions")
        self._propositions, self._goal = model.propositions, model.goal
        self._cell = cell or instance.robot.actions.stride
        self._joints = instance.robot.joints
        self.fact_count = len(model.propositions) + len(instance.targets)
        self.pose_count = 4 + self._joints + len(instance.targets)
        self._numbers = 4 + 2 * self._joints + len(model.propositions) + len(instance.targets)
        self.space = spaces.Box(-np.inf, np.inf, (self._numbers,), np.float64)
        self.target_names = instance.puzzle.target_names

    @cached_property
    def planner(self) -> RoomPlanner:
        """The room's planner, shared by the process."""
        return get_planner(self.instance)

    # --- packing ------------------------------------------------------------------------

    def pack(self, state: RoomState) -> NDArray[np.float64]:
        """Pack a state into an observation, float64 (numbers,)."""
        facts = self.instance.puzzle.symbolic.get_facts(state.puzzle)
        targets = range(len(self.instance.targets))
        return np.array([
            state.x, state.y, state.heading_steps, state.heading_offset, *state.joint_steps,
            *(state.joint_offsets or (0.0,) * self._joints),
            *(proposition in facts for proposition in self._propositions),
            *(state.touching >> target & 1 for target in targets),
        ], np.float64)

    def read(self, observation: Any) -> Situation:
        """Unpack the situation of an observation."""
        numbers, joints = np.asarray(observation).tolist(), self._joints
        offsets = tuple(numbers[4 + joints : 4 + 2 * joints])
        held = numbers[4 + 2 * joints : 4 + 2 * joints + len(self._propositions)]
        touched = numbers[4 + 2 * joints + len(self._propositions) :]
        facts = frozenset(name for name, holds in zip(self._propositions, held, strict=True) if holds)
        is_open = self._goal <= facts
        state = RoomState(numbers[0], numbers[1], int(numbers[2]), numbers[3], tuple(map(int, numbers[4 : 4 + joints])),
                          offsets if any(offsets) else (), self._get_puzzle(is_open),
                          sum(1 << target for target, touches in enumerate(touched) if touches), 0, 0)
        return Situation(state, facts, is_open)

    def _get_puzzle(self, is_open: bool) -> Hashable:
        return self.planner.orders.solved_puzzle if is_open else self.instance.puzzle.make_state()

    # --- predicates ---------------------------------------------------------------------

    def is_touching(self, seen: Seen, target: int) -> bool:
        """Return whether the robot touches a target."""
        return bool(seen.state.state.touching >> target & 1)

    # --- plans --------------------------------------------------------------------------

    def find_route(self, here: Situation, goal: Goal) -> Route | None:
        """Plan a route, or None if there is none."""
        try:
            return self.planner.routes.find_route(here.state, goal)
        except PlanningFailed:
            return None

    def plan_first(self, here: Situation, goal: Goal) -> int | None:
        """Return the first primitive of the planned route, or None without a route or at its end."""
        route = self.find_route(here, goal)
        return next(iter(route.primitives), None) if route else None

    def can_escape(self, seen: Seen, primitive: int) -> bool:
        """Return whether a primitive ends the episode."""
        return self.planner.rules.step(seen.state.state, primitive).terminated

    def get_goal(self, target: int | None) -> Goal:
        """Return the planner's goal: press a target, or go to the exit if `target` is None."""
        return ExitGoal() if target is None else PressGoal(target)

    def get_place(self, target: int | None) -> tuple[float, float]:
        """Return the position of a target on the floor, or of the exit if `target` is None, m."""
        if target is None:
            return self.instance.exit.centre
        return self.instance.targets[target].x, self.instance.targets[target].y

    # --- views --------------------------------------------------------------------------

    def see_place(self, seen: Seen) -> Hashable:
        """View of facts and touched targets."""
        return tuple(sorted(seen.state.facts)), seen.state.state.touching

    def see_pose(self, seen: Seen) -> _Pose:
        """View of cell, sector, joints, touched targets and the open exit, without facts of the puzzle."""
        return self._get_pose(seen.state)

    def _get_pose(self, here: Situation) -> _Pose:
        state, rules = here.state, self.planner.rules
        sectors = min(SECTORS, rules.headings)
        sector = round(rules.get_heading(state) / (2 * np.pi) * sectors) % sectors
        door = bool(self.instance.door) and here.is_open
        return round(state.x / self._cell), round(state.y / self._cell), sector, state.joint_steps, state.touching, door

    def list_facts(self, here: Situation) -> NDArray[np.float64]:
        """Return `see_place` as a vector (fact_count,): 1 for each true fact and each touched target."""
        return np.array([*(name in here.facts for name in self._propositions),
                         *(here.state.touching >> target & 1 for target in range(len(self.instance.targets)))],
                        np.float64)

    def list_pose(self, here: Situation) -> NDArray[np.float64]:
        """Return `see_pose` as a vector (pose_count,)."""
        column, row, sector, joints, touching, door = self._get_pose(here)
        touched = (touching >> target & 1 for target in range(len(self.instance.targets)))
        return np.array([column, row, sector, door, *joints, *touched], np.float64)

    def see_all(self, seen: Seen) -> Hashable:
        """Pose, and all facts."""
        return self.see_pose(seen), tuple(sorted(seen.state.facts))
