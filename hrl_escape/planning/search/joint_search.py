"""Joint search for whole escapes: one A* over poses and puzzle states, so that legs end where the rest is shortest.

Options reach one goal after another, each with the fewest primitives, and so may end where the next
leg is longer, or press in an order whose legs do not fit together. Here every state of the puzzle has a
cost-to-go field of its own: its seeds are the poses from which one primitive presses a target, at the
cost-to-go that the puzzle's next state has where the primitive ends. A* over the room's own
kinematics follows these fields through all orders at once. It is for presses by the body: after a press by
hand the arm's posture counts, too (`hand_search.py`).
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Hashable, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hrl_escape.clock import NO_LIMIT, Clock
from hrl_escape.env.geometry import compute_distance_many, stack_footprints
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.floor.cost_to_go import FieldMaker, Seeds
from hrl_escape.planning.areas import compute_goal_area, get_presser
from hrl_escape.planning.goals import ExitGoal, Goal, PressGoal
from hrl_escape.planning.search import a_star

__all__ = ["Fields", "JointSearch", "Presses"]

MOST_PUZZLE_STATES = 64
"""Most puzzle states with fields: all subsets of six buttons. A puzzle with more has them along given orders only."""
HEURISTIC_OFFSETS = (0, 2, 3, 5)
"""Primitives subtracted from the cost-to-go in each search: none for a quick plan, then some for shorter ones; the last
two only where more effort is asked for."""
NODES_A_SEARCH = 20_000
"""Most nodes expanded by each search."""
NODES_A_LEG = 2_000
"""Most nodes expanded by the search for one leg."""
MOST_FIELDS = 256
"""Most fields kept: those of four sets of puzzle states."""


Fields: TypeAlias = dict[Hashable, NDArray[np.int16]]
_Ways: TypeAlias = tuple[tuple[int, int], ...]
"""Key of a field: (target, number of the field after its press) for each press that leads on; () at the exit."""


class Presses(NamedTuple):
    """Poses of the grid from which a target is pressed.

    Attributes:
        states: cell * layers + heading, shape (n,).
        places: where the press leads, as (cell, layer) of the grid, shape (n,).
        costs: primitives that it takes, shape (n,).
    """

    states: NDArray[np.int64]
    places: NDArray[np.int64]
    costs: NDArray[np.int64]


class JointSearch:
    """Fields of one room's puzzle states, and searches through them.

    Attributes:
        rules: kinematics without noise and slip.
    """

    def __init__(self, rules: Kinematics, shut: FieldMaker, opened: FieldMaker) -> None:
        """Prepare nothing yet.

        Args:
            rules: kinematics without noise and slip.
            shut: field maker of the room with its door shut.
            opened: the same with the door open.
        """
        self.rules, self._shut, self._opened, self._layers = rules, shut, opened, shut.classes
        self._presses: dict[int, Presses] = {}
        self._fields: list[NDArray[np.int16]] = []
        self._numbers: dict[_Ways, int] = {}
        self._recent: tuple[tuple, Fields] | None = None

    def find_escape(self, state: RoomState, order: Sequence[Goal], most: int, *, clock: Clock = NO_LIMIT,
                    effort: int = 0, budget: int = NODES_A_SEARCH) -> tuple[tuple[int, ...] | None, int]:
        """Search for the fewest primitives that escape.

        Args:
            state: first state; heading and joints are on their lattices.
            order: an order of goals; its puzzle states are used if the puzzle has more than `MOST_PUZZLE_STATES`.
            most: plans of this many primitives or more are discarded.
            clock: time limit.
            effort: 0, 1 or 2; higher values search longer.
            budget: search nodes that may be expanded.

        Returns:
            Fewer than `most` primitives that end the episode by escaping, or None; and the nodes expanded.
        """
        fields = self.get_fields(state, order, clock)
        best, spent = None, 0
        for offset in HEURISTIC_OFFSETS[: 2 + effort]:
            nodes = min(budget - spent, NODES_A_SEARCH * 4**effort)
            if clock.is_up() or state.puzzle not in fields or nodes <= 0:
                break
            found, used = self._search(state, fields, offset, most if best is None else len(best), nodes, clock)
            best, spent = found or best, spent + used
        return best, spent

    def find_leg(self, state: RoomState, order: Sequence[Goal]) -> tuple[int, ...] | None:
        """Search for the primitives to the next change of the puzzle, or to the exit, so that the way on is short, too.

        It takes milliseconds: the way on is not searched, its length is read from the field of the puzzle's next state.

        Args:
            state: first state, whatever its heading.
            order: goals that are left; used if the puzzle has more than `MOST_PUZZLE_STATES` states.

        Returns:
            The primitives; None if the fields lead nowhere from here.
        """
        fields = self.get_fields(state, order, NO_LIMIT)
        if state.puzzle not in fields:
            return None
        return self._search(state, fields, 0, a_star.MOST_PRIMITIVES, NODES_A_LEG, NO_LIMIT, one_leg=True)[0]

    def list_goals(self, state: RoomState, primitives: Sequence[int]) -> tuple[Goal, ...]:
        """Presses that change the puzzle on the way of a plan, in order, and the exit."""
        goals: list[Goal] = []
        for primitive in primitives:
            step = self.rules.step(state, primitive)
            if step.pressed and step.state.puzzle != state.puzzle:
                goals.append(PressGoal(step.pressed[-1]))
            state = step.state
        return (*goals, ExitGoal())

    # --- puzzle states -------------------------------------------------------------------

    def press(self, puzzle: Hashable, target: int) -> Hashable:
        """State of the puzzle after a press."""
        return self.rules.instance.puzzle.update(puzzle, Contacts((target,)))

    def _list_puzzle_states(self, begin: Hashable, order: Sequence[Goal]) -> list[Hashable]:
        """List the puzzle states reachable by presses, or those along an order if there are too many."""
        targets = range(len(self.rules.instance.targets))
        known, queue = {begin: None}, [begin]
        while queue and len(known) <= MOST_PUZZLE_STATES:
            puzzle = queue.pop(0)
            for then in (self.press(puzzle, target) for target in targets):
                if then not in known:
                    known[then] = None
                    queue.append(then)
        if len(known) <= MOST_PUZZLE_STATES:
            return list(known)
        known, puzzle = {begin: None}, begin
        for goal in order:
            if isinstance(goal, PressGoal):
                puzzle = self.press(puzzle, goal.target)
                known[puzzle] = None
        return list(known)

    def get_fields(self, state: RoomState, order: Sequence[Goal], clock: Clock) -> Fields:
        """Fields of the puzzle states ahead; those of the previous call if its states were the same."""
        key = (state.puzzle, tuple(order))
        if self._recent is None or self._recent[0] != key:
            if len(self._fields) > MOST_FIELDS:
                self._fields.clear()
                self._numbers.clear()
            fields = self._make_fields(state, self._list_puzzle_states(state.puzzle, key[1]), clock)
            self._recent = key, fields
        return self._recent[1]

    def _make_fields(self, state: RoomState, puzzles: list[Hashable], clock: Clock) -> Fields:
        """Fields of puzzle states, from the solved ones backwards; states with the same prospects share one."""
        targets = range(len(self.rules.instance.targets))
        is_solved = self.rules.instance.puzzle.is_solved
        if not self._fields:
            area = compute_goal_area(ExitGoal(), self.rules.instance)
            exits = self._opened.make_field(self._opened.find_seeds(*area), clock=clock)
            layers = np.arange(self._layers) % self._opened.classes
            self._fields.append(exits.reshape(-1, self._opened.classes)[:, layers].ravel())
        numbers = {puzzle: 0 for puzzle in puzzles if is_solved(puzzle)}
        left = [puzzle for puzzle in puzzles if puzzle not in numbers]
        while left:
            ready: dict[Hashable, _Ways] = {}
            for puzzle in left:
                ways = tuple((t, numbers[then]) for t in targets if (then := self.press(puzzle, t)) in numbers)
                if ways:
                    ready[puzzle] = ways
            if not ready:
                break
            for puzzle, ways in ready.items():
                if ways not in self._numbers:
                    self._fields.append(self._make_field(state, ways, clock))
                    self._numbers[ways] = len(self._fields) - 1
                numbers[puzzle] = self._numbers[ways]
            left = [puzzle for puzzle in left if puzzle not in ready]
        return {puzzle: self._fields[number] for puzzle, number in numbers.items()}

    def _make_field(self, state: RoomState, ways: _Ways, clock: Clock) -> NDArray[np.int16]:
        """Field of a puzzle state."""
        states, costs = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
        for target, after in ways:
            presses = self.find_presses(state, target)
            cost = self._fields[after][presses.places].astype(np.int64)
            states.append(presses.states[cost >= 0])
            costs.append(presses.costs[cost >= 0] + cost[cost >= 0])
        return self._shut.make_field(Seeds(np.concatenate(states), np.concatenate(costs), self._layers), clock=clock)

    def find_presses(self, state: RoomState, target: int) -> Presses:
        """Find the poses from which one primitive presses a target; the pose of the state itself is not read."""
        if target not in self._presses:
            maker, rules = self._shut, self.rules
            area = compute_goal_area(PressGoal(target), rules.instance)
            away = compute_distance_many(maker.points, stack_footprints([area.footprint]))
            step = rules.actions.longest
            presser = get_presser(PressGoal(target), rules.instance)
            surely = area.reach - presser.outer + presser.inner  # touches at any heading
            near = np.flatnonzero(maker.standing & (away > surely) & (away <= area.reach + step))
            layers = len(maker.fits) // len(maker.points)
            actions = rules.actions.base if layers > 1 else rules.actions.translations  # a turn may press
            found = []
            for cell, heading in itertools.product(near.tolist(), range(maker.classes)):
                x, y = maker.points[cell].tolist()
                begin = state._replace(x=x, y=y, heading_steps=heading, heading_offset=0.0, touching=0,
                                       puzzle=rules.instance.puzzle.make_state())
                if layers > 1 and not (maker.fits[cell * layers + heading]
                                       and not rules.compute_touching(*begin.pose) >> target & 1):
                    continue
                for action in actions:
                    reached = rules.step(begin, action)
                    if reached.pressed == (target,):
                        found.append((cell * maker.classes + heading, self._find_place(reached.state)))
            table = np.array(found, dtype=np.int64).reshape(-1, 2)
            self._presses[target] = Presses(table[:, 0], table[:, 1], np.ones(len(table), dtype=np.int64))
        return self._presses[target]

    def _find_place(self, state: RoomState) -> int:
        """Index of the cell and heading class of a pose."""
        maker = self._shut
        i = min(max(int((state.x - maker.low[0]) / maker.size), 0), maker.shape[0] - 1)
        j = min(max(int((state.y - maker.low[1]) / maker.size), 0), maker.shape[1] - 1)
        return (i * maker.shape[1] + j) * maker.classes + state.heading_steps % maker.classes

    # --- the search ----------------------------------------------------------------------

    def _search(self, state: RoomState, fields: Fields, offset: int, most: int, nodes: int, clock: Clock,
                one_leg: bool = False) -> tuple[tuple[int, ...] | None, int]:
        """A* over primitives; poses in one cell of the grid, with the same puzzle state, count as one."""
        rules, (low_x, low_y), size = self.rules, self._shut.low.tolist(), self._shut.size
        (columns, rows), classes = self._shut.shape, self._shut.classes
        shift = round(state.heading_offset / rules.turn_step)
        costs = {puzzle: field.data for puzzle, field in fields.items()}
        tie = itertools.count()
        heap: list[tuple[int, int, int, RoomState, Any]] = [(0, 0, next(tie), state, None)]
        best: dict[tuple[Hashable, int, bool], int] = {}
        for expanded in range(nodes):
            if not heap or (expanded % 500 == 0 and clock.is_up()):
                return None, expanded
            _, less, _, here, trail = heapq.heappop(heap)  # ties go to the longest plan so far
            if trail is not None and trail[2]:
                return _list_primitives(trail), expanded
            spent = 1 - less
            for action in rules.actions.base:
                step = rules.step(here, action)
                after = step.state
                if after.has_pose_of(here):
                    continue
                if step.terminated:
                    if spent < most and rules.has_escaped(after):
                        heapq.heappush(heap, (spent, -spent, next(tie), after, (trail, action, True)))
                    continue
                field = costs.get(after.puzzle)
                if field is None:
                    continue
                i = min(max(int((after.x - low_x) / size), 0), columns - 1)
                j = min(max(int((after.y - low_y) / size), 0), rows - 1)
                place = (i * rows + j) * classes + (after.heading_steps + shift) % classes
                cost_to_go = field[place]
                ends = one_leg and after.puzzle != state.puzzle
                total = spent + max(cost_to_go - offset, 0)
                key = (after.puzzle, place, after.touching != 0)
                if 0 <= cost_to_go and total < most and spent < best.get(key, most):
                    best[key] = spent
                    heapq.heappush(heap, (total, -spent, next(tie), after, (trail, action, ends)))
        return None, nodes


def _list_primitives(trail: tuple | None) -> tuple[int, ...]:
    actions = []
    while trail is not None:
        trail, action, _ = trail
        actions.append(action)
    return tuple(reversed(actions))
