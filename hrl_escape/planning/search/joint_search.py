"""Joint search for whole escapes: one A* over poses and puzzle states, whose legs end where the rest is short.

Options reach one goal after another, each with the fewest primitives. They can end where the next leg is longer, or
press in a costly order. Here every state of the puzzle has its own cost-to-go field. Its seeds are the poses where one
primitive presses a target, at the cost-to-go of the puzzle's next state where the primitive ends. A compiled A*
over exact poses (`a_star.py`) follows these fields through all orders at once, and the room's kinematics replay the
result. It is for presses by the body; presses by hand are in `hand_search.py`.
"""

from __future__ import annotations

import itertools
from collections.abc import Hashable, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hrl_escape.clock import NO_LIMIT, Clock
from hrl_escape.env.geometry import compute_distance_many, stack_footprints
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.floor.cost_to_go import Seeds
from hrl_escape.planning.areas import Area, compute_goal_area, get_presser
from hrl_escape.planning.goals import ExitGoal, Goal, PressGoal
from hrl_escape.planning.search import a_star
from hrl_escape.planning.search.a_star import JointQuery, expand_until_escape
from hrl_escape.planning.search.primitive_search import PrimitiveSearch, make_motions

MOST_PUZZLE_STATES = 64
"""Maximum number of puzzle states with fields: all subsets of six buttons. Larger puzzles have fields along given
orders only."""
SEARCHES = ((0, 1, 20_000), (2, 1, 100_000)), ((3, 1, 300_000),), ((3, 2, 500_000), (3, 3, 500_000))
"""Searches of each effort: primitives subtracted from the cost-to-go, bins along the side of a usual bin, and maximum
number of nodes. First a quick plan and a shorter one, then searches that trust the fields less and use smaller bins."""
NODES_A_LEG = 2_000
"""Maximum number of nodes expanded by the search for one leg."""
FIRST_NODES = 1 << 14
"""Initial capacity of a search, in nodes."""
_SLICE = 5_000
"""Nodes expanded between two checks of the time limit."""
MOST_NODES = 1_000_000
"""Maximum number of nodes expanded for one escape."""
_LOOKS = 5
"""Places along a move where its distance from a target is measured."""
MOST_FIELDS = 256
"""Maximum number of cached fields, for four sets of puzzle states."""


Fields: TypeAlias = dict[Hashable, NDArray[np.int16]]
_Ways: TypeAlias = tuple[tuple[int, int], ...]
"""Key of a field: (target, number of the field after its press) for each press that leads on; () at the exit."""


class Presses(NamedTuple):
    """Poses of the grid that press a target."""

    states: NDArray[np.int64]  # cell * layers + heading, shape (n,)
    places: NDArray[np.int64]  # where the press leads, as (cell, layer) of the grid, shape (n,)
    costs: NDArray[np.int64]  # primitives that it takes, shape (n,)


class JointSearch:
    """Fields of one room's puzzle states, and searches through them; `rules` are without noise and slip."""

    def __init__(self, search: PrimitiveSearch) -> None:
        self.rules, self._legs = search.kinematics, search
        self._shut, self._opened = search.get_maker(True), search.get_maker(False)
        self._layers = self._shut.classes
        self._presses: dict[int, Presses] = {}
        self._fields: list[NDArray[np.int16]] = []
        self._numbers: dict[_Ways, int] = {}
        self._recent: tuple[tuple, Fields] | None = None
        self._puzzles: _Puzzles | None = None

    def find_escape(self, state: RoomState, order: Sequence[Goal], most: int, *, clock: Clock = NO_LIMIT,
                    effort: int = 0, budget: int = MOST_NODES) -> tuple[tuple[int, ...] | None, int]:
        """Search for the fewest primitives that escape.

        Args:
            state: first state; heading and joints are on their lattices.
            order: an order of goals; its puzzle states are used if the puzzle has more than `MOST_PUZZLE_STATES`.
            most: plans of this many primitives or more are discarded.
            clock: time limit.
            effort: 0, 1 or 2; higher efforts use longer searches.
            budget: maximum number of expanded search nodes.

        Returns:
            Fewer than `most` primitives that end the episode by escaping, or None; and the number of expanded nodes.
        """
        fields = self.get_fields(state, order, clock)
        best, spent = None, 0
        if state.puzzle not in fields:
            return best, spent
        query = self._make_query(state, fields)
        for offset, fineness, nodes in SEARCHES[effort]:
            nodes = min(budget - spent, nodes)
            if clock.is_up() or nodes <= 0:
                break
            finer = query._replace(offset=offset, bin_size=query.bin_size / fineness)
            found, used = self._search(state, finer, most if best is None else len(best), nodes, clock)
            best, spent = found or best, spent + used
        return best, spent

    def find_leg(self, state: RoomState, order: Sequence[Goal]) -> tuple[int, ...] | None:
        """Search for the primitives to the next change of the puzzle, or to the exit, with a short rest.

        It takes milliseconds, because the length of the rest is read from the field of the puzzle's next state. It
        returns None if the fields lead nowhere from this state. The order is as in `find_escape`; every heading is
        supported.
        """
        fields = self.get_fields(state, order, NO_LIMIT)
        if state.puzzle not in fields:
            return None
        query = self._make_query(state, fields)._replace(one_leg=True)
        return self._search(state, query, a_star.MOST_PRIMITIVES, NODES_A_LEG, NO_LIMIT)[0]

    def list_goals(self, state: RoomState, primitives: Sequence[int]) -> tuple[Goal, ...]:
        """Return the presses that change the puzzle on the way of a plan, in order, and the exit."""
        goals: list[Goal] = []
        for primitive in primitives:
            step = self.rules.step(state, primitive)
            if step.pressed and step.state.puzzle != state.puzzle:
                goals.append(PressGoal(step.pressed[-1]))
            state = step.state
        return (*goals, ExitGoal())

    # --- puzzle states -------------------------------------------------------------------

    def press(self, puzzle: Hashable, target: int) -> Hashable:
        """Return the state of the puzzle after a press."""
        return self.rules.instance.puzzle.update(puzzle, Contacts((target,)))

    def _list_puzzle_states(self, begin: Hashable, order: Sequence[Goal]) -> list[Hashable]:
        """Return the puzzle states reachable by presses, or those along an order if there are too many."""
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
        """Return the fields of the puzzle states ahead, and reuse the previous call's fields for the same states."""
        key = (state.puzzle, tuple(order))
        if self._recent is None or self._recent[0] != key:
            if len(self._fields) > MOST_FIELDS:
                self._fields.clear()
                self._numbers.clear()
            fields = self._make_fields(state, self._list_puzzle_states(state.puzzle, key[1]), clock)
            self._recent = key, fields
        return self._recent[1]

    def _make_fields(self, state: RoomState, puzzles: list[Hashable], clock: Clock) -> Fields:
        """Make the fields of puzzle states, from the solved ones backwards. Equal continuations share a field."""
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
        states, costs = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
        for target, after in ways:
            presses = self.find_presses(state, target)
            cost = self._fields[after][presses.places].astype(np.int64)
            states.append(presses.states[cost >= 0])
            costs.append(presses.costs[cost >= 0] + cost[cost >= 0])
        return self._shut.make_field(Seeds(np.concatenate(states), np.concatenate(costs), self._layers), clock=clock)

    def find_presses(self, state: RoomState, target: int) -> Presses:
        """Find the poses where one primitive presses a target; the pose of the state itself has no effect."""
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
            can_press = self._find_moves_to(area, maker.points[near], actions) if layers == 1 else None
            found = []
            for (row, cell), heading in itertools.product(enumerate(near.tolist()), range(maker.classes)):
                x, y = maker.points[cell].tolist()
                begin = state._replace(x=x, y=y, heading_steps=heading, heading_offset=0.0, touching=0,
                                       puzzle=rules.instance.puzzle.make_state())
                if layers > 1 and not (maker.fits[cell * layers + heading]
                                       and not rules.compute_touching(*begin.pose) >> target & 1):
                    continue
                for column, action in enumerate(actions):
                    if can_press is not None and not can_press[row, heading, column]:
                        continue
                    reached = rules.step(begin, action)
                    if reached.pressed == (target,):
                        found.append((cell * maker.classes + heading, self._find_place(reached.state)))
            table = np.array(found, dtype=np.int64).reshape(-1, 2)
            self._presses[target] = Presses(table[:, 0], table[:, 1], np.ones(len(table), dtype=np.int64))
        return self._presses[target]

    def _find_moves_to(self, area: Area, points: NDArray[np.float64], actions: Sequence[int]) -> NDArray[np.bool_]:
        """Return which moves from points can come within reach of an area, bool (points, heading classes, actions).

        The distance is measured at `_LOOKS` places of a move. All others are within half their spacing of one.
        """
        rules = self.rules
        moves = np.array([[rules.actions.primitives[action].compute_move(*rules.rotations[heading])
                           for action in actions] for heading in range(self._shut.classes)])
        looks = points[:, None, None, None] + np.linspace(0.0, 1.0, _LOOKS)[:, None] * moves[:, :, None]
        away = compute_distance_many(looks.reshape(-1, 2), stack_footprints([area.footprint]))
        between = rules.actions.longest / (2 * (_LOOKS - 1)) + 1e-9
        return away.reshape(looks.shape[:-1]).min(axis=-1) <= area.reach + between

    def _find_place(self, state: RoomState) -> int:
        """Return the index of the cell and heading class of a pose."""
        maker = self._shut
        i = min(max(int((state.x - maker.low[0]) / maker.size), 0), maker.shape[0] - 1)
        j = min(max(int((state.y - maker.low[1]) / maker.size), 0), maker.shape[1] - 1)
        return (i * maker.shape[1] + j) * maker.classes + state.heading_steps % maker.classes

    # --- the search ----------------------------------------------------------------------

    def _search(self, state: RoomState, query: JointQuery, most: int, nodes: int, clock: Clock
                ) -> tuple[tuple[int, ...] | None, int]:
        """Run A* over primitives; poses in one bin with the same puzzle state count as one."""
        frontier = self._legs.frontiers.take(FIRST_NODES, min(most, a_star.MOST_PRIMITIVES))
        found, has_more = None, True
        while found is None and has_more and not clock.is_up():
            limit = min(nodes, int(frontier.counts[2]) + _SLICE)
            node = int(expand_until_escape(self._shut.scene, self._opened.scene, query, frontier, limit))
            if node >= 0:
                found = self._replay(state, frontier.list_actions(node), query.one_leg)
            elif node == a_star.GROW:
                frontier = self._legs.frontiers.enlarge(frontier)
            else:
                has_more = node == a_star.BUDGET and limit < nodes
        spent = int(frontier.counts[2])
        self._legs.frontiers.give_back(frontier)
        return found, spent

    def _replay(self, state: RoomState, actions: Sequence[int], one_leg: bool) -> tuple[int, ...] | None:
        """Return the actions up to the escape or the end of one leg, by the room's kinematics, or None."""
        puzzle = state.puzzle
        for count, action in enumerate(actions, 1):
            state, _, terminated, _, _ = self.rules.step(state, action)
            if terminated or (one_leg and state.puzzle != puzzle):
                return tuple(actions[:count]) if not terminated or self.rules.has_escaped(state) else None
        return None

    def _make_query(self, state: RoomState, fields: Fields) -> JointQuery:
        """Make the query of a search through fields, with bins as wide as in a search for one goal."""
        maker, rules, offset = self._shut, self.rules, state.heading_offset
        if self._puzzles is None or self._puzzles.fields is not fields:
            self._puzzles = _Puzzles.make(self, fields)
        area, puzzles = rules.instance.exit, self._puzzles
        return JointQuery(
            x=state.x, y=state.y, heading=state.heading_steps, touched=np.uint64(state.touching),
            puzzle=puzzles.numbers[state.puzzle],
            motions=make_motions(rules, offset) if offset else self._legs.motions,
            presses=puzzles.presses, solved=puzzles.solved,
            exit=np.array([area.x_min, area.x_max, area.y_min, area.y_max]), fields=puzzles.stack,
            field_of=puzzles.field_of, layers=maker.classes, shift=round(offset / rules.turn_step) % maker.classes,
            low=maker.low, size=maker.size, rows=maker.shape[1], offset=0, bin_size=maker.bin_size,
            bin_headings=maker.classes, one_leg=False)


class _Puzzles(NamedTuple):
    """Puzzle states with fields, as arrays of a `JointQuery`."""

    fields: Fields
    numbers: dict[Hashable, int]
    presses: NDArray[np.int64]
    solved: NDArray[np.bool_]
    stack: NDArray[np.int16]
    field_of: NDArray[np.int64]

    @classmethod
    def make(cls, search: JointSearch, fields: Fields) -> _Puzzles:
        """Number the states of some fields."""
        numbers = {puzzle: n for n, puzzle in enumerate(fields)}
        targets = range(len(search.rules.instance.targets))
        presses = [[numbers.get(search.press(puzzle, target), -1) for target in targets] for puzzle in fields]
        distinct = {id(field): field for field in fields.values()}  # states with the same prospects share one
        places = {key: n for n, key in enumerate(distinct)}
        return cls(
            fields, numbers, np.array(presses, dtype=np.int64).reshape(len(fields), len(targets)),
            np.array([search.rules.instance.puzzle.is_solved(puzzle) for puzzle in fields], dtype=np.bool_),
            np.stack(list(distinct.values())), np.array([places[id(field)] for field in fields.values()]))
