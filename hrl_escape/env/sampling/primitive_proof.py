"""Proof that primitives solve a room: a sufficient condition, and a search for rooms that do not meet it.

**The condition.** The base turns anywhere, the floor is one empty rectangle, presses never undo anything, and turns are
at most 15 degrees. A step s is at most half the range of the body's axis along x and along y. A step in one direction
and back in the next direction shifts the robot by e = 2 s sin(t / 2) for a turn step t, both ways, and from any place
in directions that span the plane. The robot therefore comes within e of every place. (A base that does not strafe must
have headings perpendicular to each wall: its turns must divide 90 degrees.) A button that the body touches along a
stretch of 3 e of the wall is therefore reached by driving at that wall, and an exit of 3 e by 3 e is entered.

**The search.** It is best-first over the kinematics without noise, from every start, target by target in an order from
the puzzle's symbolic model, then to the exit. Its path is the proof. Rooms under physics have no such proof; their
certificate is the geometric one.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Hashable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.config import CONTACT_SKIN, PASSAGE_SLACK
from hrl_escape.env.floor_grid import coarsen, spread_waves
from hrl_escape.env.geometry import compute_distance, compute_distance_many, stack_footprints
from hrl_escape.env.instance import RoomInstance, Target
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.env.puzzles.mixins import Pushing
from hrl_escape.env.puzzles.symbolic import Operator
from hrl_escape.env.robot import sample_hand_positions, sample_joint_steps
from hrl_escape.env.sampling.certificate import Floors, find_unmet, make_floors
from hrl_escape.env.sight import list_hiders

_FINEST_TURN_DEG = 15.0
_SHIFTS = 3
"""Smallest length of a button's stretch and of the exit's sides, in shifts e."""
_MOST_CELLS = 40_000
"""Most cells of the grid for waves. They only guide the search, and a coarse grid is enough."""
_EXPANSIONS = 4000
"""Most states that the search for one button or the exit expands, plus 20 for each step of the way."""
_FINENESS = (0.05, 0.3, 1e-4)
"""Fractions of a step within which two places count as one; the search is repeated with the next after a failure."""
_HANDS = 4000
_MOST_PRESSES = 4
"""Presses per target, on average, of the longest solution that is tried with primitives."""


def find_unmet_constraint(instance: RoomInstance) -> str | None:
    """Return the part of the certificate that an instance fails, or None if it holds.

    Start, touching places and exit must be on one connected floor; under physics no arm may begin in a wall. Primitives
    must then solve the room.
    """
    floors = make_floors(instance)
    return find_unmet(instance, floors) or find_unproven(instance, floors)


def find_unproven(instance: RoomInstance, floors: Floors) -> str | None:
    """Return the goal that no primitives were found for, or None if the room is proven solvable.

    The geometric certificate must hold. The budget of the free space pays for the search.

    Raises:
        OutOfWork: the budget is spent.
    """
    if instance.dynamics.kind == "physics" or meets_condition(instance):
        return None
    return _Search(instance, floors).find_unproven()


# --- the condition -------------------------------------------------------------------------


def meets_condition(instance: RoomInstance) -> bool:
    """Return whether the sufficient condition holds."""
    robot, puzzle = instance.robot, instance.puzzle
    radius = robot.outer_radius + CONTACT_SKIN
    free_x, free_y = instance.half_width - radius, instance.half_depth - radius
    needed = _SHIFTS * 2 * robot.actions.stride * math.sin(math.radians(robot.turn_step_deg) / 2)
    area = instance.exit
    exit_x = min(area.x_max, free_x) - max(area.x_min, -free_x)
    exit_y = min(area.y_max, free_y) - max(area.y_min, -free_y)
    return (
        robot.base.turns_anywhere and instance.dynamics.press_with == "body" and instance.door is None
        and not list_hiders(instance)
        and isinstance(puzzle, ButtonsPuzzle) and puzzle.on_violation == "ignore" and not puzzle.allow_off
        and not puzzle.symbolic.has_dead_ends
        and (robot.drive == "strafing" or (360 / robot.turn_step_deg) % 4 == 0)
        and robot.turn_step_deg <= _FINEST_TURN_DEG and robot.actions.stride <= min(free_x, free_y)
        and min(exit_x, exit_y) >= needed
        and all(_measure_stretch(instance, target, free_x, free_y) >= needed for target in instance.targets)
    )


def _measure_stretch(instance: RoomInstance, target: Target, free_x: float, free_y: float) -> float:
    """Length along the wall behind a target where the body, against the wall, touches it."""
    reach, shape = instance.compute_press_reach(target), target.footprint
    axes = ((target.x, free_x), (target.y, free_y))
    (along, free_along), (across, free) = axes if abs(shape.sin) < 1e-12 else axes[::-1]
    away = max(abs(abs(across) - free) - target.half_y, 0.0)
    if min(abs(shape.sin), abs(shape.cos)) >= 1e-12 or away > reach:
        return 0.0
    half = target.half_x + math.sqrt(reach**2 - away**2)
    return min(along + half, free_along) - max(along - half, -free_along)


# --- the search ----------------------------------------------------------------------------


class _Goal(NamedTuple):
    """Goal of one leg, with the guidance of the search towards it."""

    distances: NDArray[np.float64]  # waves from the goal, for each cell of the grid
    is_reached: Callable[[RoomState], RoomState | None]
    """Test of a state, which can apply joint steps; returns the final state, or None."""
    measure: Callable[[float, float], float]  # lower bound on the remaining floor distance, m
    count_turns: Callable[[RoomState], float]  # number of turns until the arm points at the goal
    is_allowed: Callable[[Hashable], bool]  # whether a puzzle state may occur on the way


class _Search:
    """Search for primitives that solve a room."""

    def __init__(self, instance: RoomInstance, floors: Floors) -> None:
        self._instance, self._floors = instance, floors
        self._work = floors.shut.work
        self._rules = Kinematics(instance, is_still=True)
        self._step = self._rules.actions.stride
        headings, symmetry = self._rules.headings, self._rules.symmetry
        alike = headings // symmetry if headings % symmetry == 0 else headings
        self._alike = alike if instance.dynamics.press_with == "body" else self._rules.headings
        self._stride = math.ceil(math.sqrt(max(1.0, floors.shut.free.size / _MOST_CELLS)))
        self._distances: dict[int, NDArray[np.float64]] = {}
        self._base_actions = self._rules.actions.base
        self._hands: NDArray[np.float64] | None = None
        self._joint_steps = np.zeros((0, 0), dtype=np.int64)
        if instance.dynamics.press_with == "hand":
            self._joint_steps = sample_joint_steps(self._rules.robot, _HANDS)
            self._hands = sample_hand_positions(self._rules.robot, _HANDS)

    def find_unproven(self) -> str | None:
        """Run the search from every start; returns as the module's `find_unproven`."""
        for start in self._instance.starts:
            state = self._rules.make_state(start)
            for _ in range(_MOST_PRESSES * len(self._instance.targets) + 1):
                if self._is_way_out_open(state.puzzle):
                    break
                wanted = self._choose_target(state.puzzle)
                if wanted is None:
                    return self._find_unsolvable(state)
                found = self._reach(state, self._make_press(wanted, state))
                if found is None:
                    return f"{self._instance.targets[wanted].name} must be pressed by a sequence of primitives"
                state = found
            if self._reach(state, self._make_exit()) is None:
                return "the exit must be reached by a sequence of primitives"
        return None

    def _is_way_out_open(self, puzzle_state: Hashable) -> bool:
        puzzle, doors = self._instance.puzzle, self._rules.inner_doors
        if not puzzle.is_solved(puzzle_state) or doors is None or not self._instance.ways:
            return puzzle.is_solved(puzzle_state)
        return not any(doors.get_shut(puzzle_state) >> door & 1 for door in self._instance.ways[-1])

    def _find_unsolvable(self, state: RoomState) -> str | None:
        """Name a failed push, or None for puzzles with grips, where only the geometry is certified."""
        puzzle, cells = self._instance.puzzle, self._rules.inner_doors
        if not isinstance(puzzle, Pushing) or cells is None:
            return None
        if puzzle.symbolic.plan(state.puzzle, cells.find_at(state.x, state.y)):
            return None
        return "the puzzle must be solvable by pushes from the start"

    def _choose_target(self, puzzle_state: Hashable) -> int | None:
        """Next target to press for the puzzle's goal, ignoring deletions."""
        puzzle = self._instance.puzzle
        model, names = self._instance.symbolic_model, puzzle.target_names
        if any(operator.when for operator in model.operators):
            known = puzzle.symbolic.plan(puzzle_state)
            path = known or model.find_fewest(puzzle.symbolic.get_facts(puzzle_state)) or tuple[Operator]()
            is_short = 0 < len(path) <= _MOST_PRESSES * len(names)
            return names.index(path[0].target) if is_short and path[0].action == "press" else None
        first = {fact: None for fact in puzzle.symbolic.get_facts(puzzle_state)}
        layer = True
        while layer and not model.goal <= first.keys():
            known = frozenset(first)
            layer = [(op, new) for op in model.operators if (new := op.relax(known) - known)]
            for operator, new in layer:
                for fact in new - first.keys():
                    first[fact] = operator  # type: ignore[assignment]  # the first operator that adds it
        if not model.goal <= first.keys():
            return None
        needed, open_facts = [], list(model.goal)
        while open_facts:
            operator = first[open_facts.pop()]
            if operator is not None and operator not in needed:
                needed.append(operator)
                open_facts += operator.preconditions
        facts = puzzle.symbolic.get_facts(puzzle_state)
        locking = [op.forbidden - op.add for op in needed] if puzzle.symbolic.has_dead_ends else []
        spoils = frozenset[str]().union(*locking)
        for operator in model.operators:
            if operator in needed and operator.is_applicable(facts) and operator.action == "press" and not (
                    operator.add & spoils):
                return names.index(operator.target)
        return None

    # --- goals -------------------------------------------------------------------------

    def _make_press(self, index: int, before: RoomState) -> _Goal:
        instance, target = self._instance, self._instance.targets[index]
        puzzle, footprint = instance.puzzle, target.footprint
        expected, facts = puzzle.update(before.puzzle, Contacts((index,))), puzzle.symbolic.get_facts(before.puzzle)

        def is_better(now: Hashable) -> bool:
            """Return whether a state is the expected one or, in a puzzle without dead ends, has more facts."""
            return now == expected or (not puzzle.symbolic.has_dead_ends and puzzle.symbolic.get_facts(now) > facts)

        reach, fan = instance.compute_press_reach(target), math.pi
        if self._hands is not None:
            flat = self._hands[np.abs(self._hands[:, 2] - target.z) <= target.half_z]
            reach = float(np.hypot(*flat[:, :2].T).max(initial=0.0)) + instance.robot.hand_radius
            fan = float(np.abs(np.arctan2(flat[:, 1], flat[:, 0])).max(initial=0.0))
        return _Goal(
            self._spread_from(index, reach),
            lambda state: (state if state.puzzle != before.puzzle and is_better(state.puzzle)
                           else self._press_by_hand(state, index, expected)),
            lambda x, y: max(compute_distance(x, y, footprint) - reach, 0.0),
            lambda state: self._count_turns(state, target, fan),
            lambda now: now == before.puzzle or is_better(now),
        )

    def _count_turns(self, state: RoomState, target: Target, fan: float) -> float:
        """Number of turns until a target is within the angle that the arm covers on either side."""
        if fan >= math.pi:
            return 0.0
        bearing = math.atan2(target.y - state.y, target.x - state.x) - self._rules.get_heading(state)
        return max(abs(math.remainder(bearing, math.tau)) - fan, 0.0) / self._rules.turn_step

    def _press_by_hand(self, state: RoomState, index: int, expected: Hashable) -> RoomState | None:
        """State after joint steps that press a target from the base's place, or None if there are none."""
        target = self._instance.targets[index]
        if self._hands is None or state.touching >> index & 1:
            return None
        self._work.spend(30)
        if compute_distance(state.x, state.y, target.footprint) > np.hypot(*self._hands[:, :2].T).max() + 1.0:
            return None
        self._work.spend(len(self._hands) / 10)
        cos, sin = self._rules.get_rotation(state.heading_steps, state.heading_offset)
        x, y, z = self._hands.T
        points = np.stack([state.x + cos * x - sin * y, state.y + sin * x + cos * y], axis=1)
        above = np.maximum(np.abs(z - target.z) - target.half_z, 0.0)
        limit = self._instance.robot.hand_radius + self._instance.dynamics.press_margin - 1e-6
        away = np.hypot(compute_distance_many(points, stack_footprints([target.footprint])), above)
        for number in np.flatnonzero(away <= limit)[:20].tolist():
            found = self._move_joints(state, self._joint_steps[number].tolist(), expected)
            if found is not None:
                return found
        return None

    def _move_joints(self, state: RoomState, wanted: list[int], expected: Hashable) -> RoomState | None:
        before = state.puzzle
        for joint, to in enumerate(wanted):
            while state.joint_steps[joint] != to and state.puzzle == before:
                up, down = self._rules.actions.joints[joint]
                state = self._rules.step(state, up if to > state.joint_steps[joint] else down).state
                self._work.spend(10)
        return state if state.puzzle == expected else None

    def _make_exit(self) -> _Goal:
        area = self._instance.exit
        x, y = area.centre
        half_x, half_y = area.x_max - x, area.y_max - y
        is_solved = self._instance.puzzle.is_solved
        return _Goal(
            self._spread_from(-1, 0.0),
            lambda state: state if area.contains(state.x, state.y) and is_solved(state.puzzle) else None,
            lambda at_x, at_y: max(abs(at_x - x) - half_x, abs(at_y - y) - half_y, 0.0),
            lambda state: 0.0, is_solved,
        )

    def _spread_from(self, index: int, reach: float) -> NDArray[np.float64]:
        """Waves from a target (or the exit, -1) over the coarse grid; cached."""
        if index not in self._distances:
            space = self._floors.opened if index < 0 else self._floors.shut
            free = coarsen(space.free, self._stride)
            cells = np.argwhere(np.ones_like(free)) * self._stride + self._stride // 2
            centres = space.grid.get_centres(cells)
            links = self._floors.touches.get(index)
            if links:
                near = np.zeros(len(cells), dtype=bool)
                near[[i // self._stride * free.shape[1] + j // self._stride for i, j in (a.cell for a in links)]] = True
            elif index < 0:
                area = self._instance.exit
                near = ((centres >= (area.x_min, area.y_min)) & (centres <= (area.x_max, area.y_max))).all(axis=1)
            else:
                shape = stack_footprints([self._instance.targets[index].footprint])
                near = compute_distance_many(centres, shape) <= reach + PASSAGE_SLACK + 2 * space.resolution
            self._work.spend(len(cells) / 2)
            seeds = near.reshape(free.shape)
            on_floor = seeds & free
            self._distances[index] = spread_waves(free, on_floor if on_floor.any() else seeds)
        return self._distances[index]

    # --- one leg -----------------------------------------------------------------------

    def _reach(self, start: RoomState, goal: _Goal) -> RoomState | None:
        """Best-first search for a state that reaches the goal, or None if it fails."""
        tried = (self._search(start, goal, fineness * self._step) for fineness in _FINENESS)
        return next((found for found in tried if found is not None), None)

    def _search(self, start: RoomState, goal: _Goal, width: float) -> RoomState | None:
        numbers, seen = itertools.count(), {self._identify(start, width)}
        queue = [(0.0, next(numbers), 0, start)]
        for _ in range(_EXPANSIONS + round(20 * self._estimate(start.x, start.y, goal) / self._step)):
            if not queue:
                return None
            _, _, steps, state = heapq.heappop(queue)
            self._work.spend(60)
            found = goal.is_reached(state)
            if found is not None:
                return found
            for action in self._base_actions:
                after = self._rules.step(state, action).state
                if not goal.is_allowed(after.puzzle):
                    continue
                name = self._identify(after, width)
                if name not in seen:
                    seen.add(name)
                    left = 2.0 * (self._estimate(after.x, after.y, goal) / self._step + goal.count_turns(after))
                    heapq.heappush(queue, (steps + 1 + left, next(numbers), steps + 1, after))
        return None

    def _identify(self, state: RoomState, width: float) -> tuple[Hashable, ...]:
        return (round(state.x / width), round(state.y / width), state.heading_steps % self._alike, state.touching,
                state.puzzle)

    def _estimate(self, x: float, y: float, goal: _Goal) -> float:
        space, stride = self._floors.shut, self._stride
        i, j = space.find_cell(x, y)
        waves = read_nearest(goal.distances, i // stride, j // stride)
        return max(waves * stride * space.resolution, goal.measure(x, y))


def read_nearest(waves: NDArray[np.float64], i: int, j: int) -> float:
    """Return the value of the finite cell that is nearest to cell (i, j); the lowest j, then i, of several."""
    here = float(waves[i, j])
    if math.isfinite(here):
        return here
    reach = 1
    while True:
        low_i, low_j = max(i - reach, 0), max(j - reach, 0)
        window = waves[low_i : i + reach + 1, low_j : j + reach + 1]
        rows, columns = np.nonzero(np.isfinite(window).T)
        away = (columns + low_i - i) ** 2 + (rows + low_j - j) ** 2
        if away.min(initial=reach**2 + 1) <= reach**2 or window.shape == waves.shape:
            return float(window[columns[away.argmin()], rows[away.argmin()]]) if len(away) else math.inf
        reach = 2 * reach + 1
