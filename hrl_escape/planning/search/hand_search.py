"""Joint search for whole escapes by hand: a beam search over presses, each planned with the rest of the escape.

After a press by hand the arm's posture counts as well as the base's pose, so no field over poses gives the exact cost
of the rest. Fields of the puzzle's states give it for an arm that reaches at once. A leg is searched by base and arm
together, and ends where its primitives and such a field are least; several of its ends are kept. The next leg's own
field, with the joint steps from the posture, ranks the ends to continue from. Kinematic arms pass through everything,
so base and arm meet only in the presses.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Hashable, Iterator, Sequence
from operator import attrgetter
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hrl_escape.clock import NO_LIMIT, Clock, OutOfTime
from hrl_escape.env.kinematics import RoomState
from hrl_escape.floor.cost_to_go import Seeds
from hrl_escape.planning.arm.reacher import ReachTable
from hrl_escape.planning.goals import ExitGoal, Goal, PressGoal
from hrl_escape.planning.search import a_star
from hrl_escape.planning.search.joint_search import MOST_NODES, Fields, JointSearch, Presses
from hrl_escape.planning.search.primitive_search import PrimitiveSearch, SearchProblem, SearchResult, SearchRun

LIKELY = 2
"""Ends ranked by the next leg's own field, for each end that is continued."""
ENDS_TRIED = 3
"""Ends examined for each that is kept, as some nearly coincide."""
NODES_A_PRESS = 20_000
"""Search nodes of a leg to a press."""
SLACK = 1
"""Largest overestimate of a field in primitives: only ends worse by more are dropped."""


class Beam(NamedTuple):
    """Effort of a beam search."""

    width: int  # partial escapes continued after each press
    ends: int  # ends of a leg that are kept
    place: float = 0.5  # ends in one square of this side, with the same posture, count as one, m
    sector: float = 0.5  # if their headings are in one sector of this size, too, rad
    offset: int = 1  # primitives subtracted from the cost-to-go of legs, whose fields overestimate by about one


BEAMS = Beam(6, 12), Beam(16, 24), Beam(32, 48, place=0.25, sector=1e-6, offset=2)
"""By effort; the first takes a tenth of a second for two buttons."""


_Search: TypeAlias = tuple[SearchProblem, NDArray[np.int16]]
"""Problem of a leg and its field."""


class _Leg(NamedTuple):
    """A possible next leg: its goal, the estimated primitives of the rest with it, and the search of a press."""

    goal: Goal
    rest: int
    search: _Search | None


class _Begun(NamedTuple):
    """A partial escape: its primitives, the state they lead to, and the estimated length of the whole."""

    primitives: tuple[int, ...]
    state: RoomState
    estimate: int
    legs: tuple[_Leg, ...] = ()


_ESTIMATE = attrgetter("estimate")


class HandSearch(JointSearch):
    """Fields of one room's puzzle states for presses by hand, and a beam search through them."""

    def __init__(self, search: PrimitiveSearch) -> None:
        super().__init__(search)
        self._layers = self._shut.headings
        self._problems: dict[Hashable, _Search] = {}

    def find_presses(self, state: RoomState, target: int) -> Presses:
        """Find the poses where the arm reaches a target at all; joint steps are not counted."""
        if target not in self._presses:
            problem = self._legs.make_problem(state._replace(joint_steps=(0,) * len(state.joint_steps)),
                                              PressGoal(target))
            states, _ = self._legs.find_postures(problem, self._shut)
            self._presses[target] = Presses(states, states, np.zeros(len(states), dtype=np.int64))
        return self._presses[target]

    def find_escape(self, state: RoomState, order: Sequence[Goal], most: int, *, clock: Clock = NO_LIMIT,
                    effort: int = 0, budget: int = MOST_NODES) -> tuple[tuple[int, ...] | None, int]:
        """Search for the fewest primitives that escape; see `JointSearch`."""
        rests = self.get_fields(state, order, clock)
        found, spent = self._search_beam(state, rests, most, BEAMS[effort], budget, clock)
        self._problems.clear()
        return found, spent

    def _search_beam(self, state: RoomState, rests: Fields, most: int, beam: Beam, budget: int, clock: Clock
                     ) -> tuple[tuple[int, ...] | None, int]:
        """Search press after press, and keep the most promising partial escapes."""
        best: tuple[int, ...] | None = None
        spent, begun = 0, [self._open_legs(_Begun((), state, 0), rests, clock)]
        while begun and spent < budget:
            ends: dict[Hashable, _Begun] = {}
            for before, leg in ((escape, leg) for escape in begun for leg in escape.legs):
                if clock.is_up() or spent >= budget:
                    return best, spent
                for result in self._list_ends(before, leg, most + SLACK, beam, clock):
                    spent += result.expansions
                    end = _Begun((*before.primitives, *result.primitives), result.states[-1], 0)
                    if self.rules.has_escaped(end.state):
                        if len(end.primitives) < most:
                            best, most = end.primitives, len(end.primitives)
                        continue
                    rest = self._look_up(rests, end.state)
                    end = end._replace(estimate=len(end.primitives) + rest)
                    key = self._describe(end.state, beam)
                    if rest >= 0 and (key not in ends or end.estimate < ends[key].estimate):
                        ends[key] = end
            self._problems.clear()
            likely = sorted(ends.values(), key=_ESTIMATE)[: LIKELY * beam.width]
            try:
                known = sorted((self._open_legs(end, rests, clock) for end in likely), key=_ESTIMATE)
            except OutOfTime:
                return best, spent
            begun = [end for end in known[: beam.width] if end.estimate < most + SLACK]
        return best, spent

    def _open_legs(self, begun: _Begun, rests: Fields, clock: Clock) -> _Begun:
        """List the legs that can come next, and estimate the rest by them. Raises `OutOfTime`."""
        state, puzzle = begun.state, self.rules.instance.puzzle
        legs = []
        if puzzle.is_solved(state.puzzle):
            legs = [_Leg(ExitGoal(), self._look_up(rests, state), None)]
        else:
            for target in range(len(self.rules.instance.targets)):
                then = self.press(state.puzzle, target)
                if then == state.puzzle or then not in rests or state.touching >> target & 1:
                    continue
                problem, field = self._make_leg(state, target, then, rests[then], clock)
                rest = self._shut.get_cost(field, state)
                if rest >= 0:
                    legs.append(_Leg(problem.goal, rest, (problem._replace(state=state), field)))
        least = min((leg.rest for leg in legs), default=a_star.MOST_PRIMITIVES)
        return begun._replace(estimate=len(begun.primitives) + least, legs=tuple(legs))

    def _make_leg(self, state: RoomState, target: int, then: Hashable, onward: NDArray[np.int16], clock: Clock
                  ) -> _Search:
        """Problem and field of a leg to a press; they depend on the arm's posture, not on the base's pose."""
        key = state.joint_steps, target, then
        if key not in self._problems:
            problem = self._legs.make_problem(state, PressGoal(target), clock=clock)
            assert problem.table is not None
            problem = problem._replace(table=self._add_onward(problem.table, onward), onward=onward)
            maker = self._shut
            field = maker.make_field(Seeds(*self._legs.find_postures(problem, maker), maker.headings), clock=clock)
            self._problems[key] = problem, field
        return self._problems[key]

    def _add_onward(self, table: ReachTable, onward: NDArray[np.int16]) -> ReachTable:
        """Add the cost of the rest to the joint steps of a press."""
        maker = self._shut
        cells = maker.grid.find_numbers(table.get_centres())
        after = np.where(cells[..., None] >= 0, onward.reshape(-1, maker.headings)[cells], -1)
        costs = np.where((table.costs < 0) | (after < 0), -1, table.costs + after).astype(np.int16)
        return dataclasses.replace(table, costs=costs)

    def _list_ends(self, begun: _Begun, leg: _Leg, most: int, beam: Beam, clock: Clock) -> Iterator[SearchResult]:
        """Ways to carry out a leg, the most promising first."""
        if leg.search is None:
            result = self._legs.search(begun.state, leg.goal, method="fields", clock=clock)
            if result.is_reached:
                yield result
            return
        problem, field = leg.search
        run = SearchRun(problem, self.rules, self._shut, field, motions=self._legs.motions, avoiding=True,
                        reacher=self._legs.reacher, frontiers=self._legs.frontiers)
        run.restart(offset=beam.offset)
        seen: set[Hashable] = set()
        spent = 0
        for _ in range(ENDS_TRIED * beam.ends):
            result = run.advance(NODES_A_PRESS)
            if not isinstance(result, SearchResult) or len(begun.primitives) + len(result.primitives) >= most:
                return
            key = self._describe(result.states[-1], beam)
            if key not in seen:
                seen.add(key)
                yield dataclasses.replace(result, expansions=run.expansions - spent)
                spent = run.expansions
            if len(seen) >= beam.ends or clock.is_up():
                return

    def _describe(self, state: RoomState, beam: Beam) -> Hashable:
        """Key of an end: ends of a leg with the same key count as one."""
        sector = int(state.heading_steps * self.rules.turn_step / beam.sector)
        column, row = math.floor(state.x / beam.place), math.floor(state.y / beam.place)
        return state.puzzle, column, row, sector, state.joint_steps

    def _look_up(self, rests: Fields, state: RoomState) -> int:
        """Estimate by the fields of the primitives that are left; -1 without a way out."""
        field = rests.get(state.puzzle)
        return -1 if field is None else self._shut.get_cost(field, state)
