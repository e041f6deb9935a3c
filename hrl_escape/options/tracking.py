"""Fewest primitives: A* over primitives on exact poses, led by a cost-to-go field.

Every pose in the search is the one that the room's kinematics would give, blocked moves
included (they end exactly at the wall, which is how a body comes within a press margin), and
poses within a bin count as one. Every plan is replayed through `Kinematics`, without noise and
slip, before it is returned. Where an OMPL path restricts the field to a corridor round it,
the method is called `corridor`. Presses by hand take the arm's share from `reaching.py`. The first
search after an installation compiles its kernels, which takes some seconds once.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import time
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.geometry import Footprint, compute_distance_many, make_footprint, stack_footprints
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.errors import PlanningReason, UnknownNameError
from hrl_escape.options.arm.joint_lattice import ALL, NEVER
from hrl_escape.options.goals import ExitGoal, Goal, PressGoal, is_reached
from hrl_escape.options.lattice.areas import Area, compute_area, find_headings
from hrl_escape.options.lattice.attempt import Attempt, Job, SearchResult
from hrl_escape.options.lattice.fields import FieldMaker
from hrl_escape.options.paths import TIME_LIMIT

if TYPE_CHECKING:
    from hrl_escape.options.navigation import Navigator
    from hrl_escape.options.reaching import Reacher

__all__ = ["METHODS", "PrimitiveSearch", "SearchResult"]

METHODS = ("fields", "corridor")
EXPANSIONS = 300_000
LADDER = ((0, 1.0, 3_000), (-1, 1.05, 6_000), (-2, 1.1, 20_000), (-4, 1.5, EXPANSIONS))
"""Primitives by which a field's prices are lowered, what they are multiplied with, and the nodes after which the
next is tried: from the fewest primitives to any plan at all."""
IMPROVEMENT = 2_000
"""Nodes for another look with lower prices, after a plan that was found at the first weight."""
SHORT = 8
"""Plans of so few primitives are looked for again without the field, which may be off by as much as they are long."""
CORRIDORS = (3.0, 6.0)
"""Half widths of corridors, in moves."""
MOST_REFINED_STATES = 6_000_000
_PENETRATION = 0.02  # a body that rigid-body contacts have pushed into a wall by this much can still drive off

Field: TypeAlias = NDArray[np.int16]


class _Try(NamedTuple):
    """One way to look for a plan."""

    maker: FieldMaker
    field: Field
    avoiding: bool
    method: str


class PrimitiveSearch:
    """Finds the fewest primitives to any goal in one room; keeps fields of goals for later searches.

    Not thread-safe. Pickling keeps the room and drops what was worked out.

    Attributes:
        instance: the room.
        kinematics: its exact kinematics without noise and slip, by which plans are replayed.
    """

    def __init__(self, instance: RoomInstance, kinematics: Kinematics | None = None) -> None:
        """Prepare nothing yet.

        Args:
            instance: the room. Noise and slip are left out; physics is planned for as if kinematic.
            kinematics: its kinematics, if they exist already and know neither noise nor slip.
        """
        self.instance = instance
        dynamics = instance.dynamics
        if kinematics is None or dynamics.noise or dynamics.slip:
            still = dataclasses.replace(dynamics, noise=0.0, slip=0.0)
            kinematics = Kinematics(dataclasses.replace(instance, dynamics=still))
        self.kinematics = kinematics
        self._makers: dict[tuple[bool, int], FieldMaker] = {}

    def __reduce__(self) -> tuple[type, tuple]:
        return type(self), (self.instance,)

    @cached_property
    def navigator(self) -> Navigator:
        """Paths for corridors."""
        from hrl_escape.options.navigation import Navigator  # loads OMPL, which fields do without

        return Navigator(self.instance)

    @cached_property
    def reacher(self) -> Reacher:
        """The arm, where the hand presses."""
        from hrl_escape.options.reaching import Reacher  # loads Pinocchio, which body presses do without

        return Reacher(self.instance)

    def get_maker(self, door_shut: bool, refinement: int = 0) -> FieldMaker:
        """The grid of fields with the exit door shut or open; made when first asked for."""
        key = (door_shut and self.instance.door is not None, refinement)
        if key not in self._makers:
            self._makers[key] = FieldMaker(self.instance, self.kinematics, door_shut=key[0], refinement=refinement)
        return self._makers[key]

    def prepare(self) -> None:
        """Make the fields of all targets and the exit now, so that the first searches are as quick as later ones."""
        state = self.kinematics.make_state(self.instance.starts[0])
        for goal in (*(PressGoal(i) for i in range(len(self.instance.targets))), ExitGoal()):
            self._get_field(self._make_job(state, goal), self.get_maker(not isinstance(goal, ExitGoal)))

    # --- one question --------------------------------------------------------------------

    def search(self, state: RoomState, goal: Goal, *, method: str = "fields", planner: str | None = None,
               avoid: bool = True, refine: bool = True, keep_out: Sequence[Footprint] = (),
               budget_expansions: int = EXPANSIONS, deadline: float = math.inf) -> SearchResult:
        """Find the fewest primitives from a state to a goal.

        Args:
            state: where to begin.
            goal: what to reach; not a push.
            method: `fields`, or `corridor` to look round the path of a path planner first.
            planner: path planner for corridors, one of `navigation.list_planners()`; the default one if None.
            avoid: begin to touch no other target on the way, and do not leave by an open exit, unless
                two resolutions show no other way; `also_pressed` says so.
            refine: look on finer grids, too, before giving up.
            keep_out: footprints that the body must not meet on its way, such as blocks.
            budget_expansions: nodes that may be expanded; the same budget gives the same result anywhere.
            deadline: wall-clock guard, s.

        Raises:
            UnknownNameError: no such method or path planner.
            GoalError: there is no such target.
            UnsupportedError: the goal is a push.
        """
        if method not in METHODS:
            raise UnknownNameError("search method", method, METHODS)
        began = time.perf_counter()
        job = self._make_job(state, goal, tuple(keep_out), began + deadline)
        result = self._answer(job, method, planner, avoid, refine, budget_expansions)
        if not result.is_reached and job.table is not None and job.table.complete_to < NEVER:
            # an arm of many joints may do what its first table left out
            job = self._make_job(state, goal, tuple(keep_out), began + deadline, thorough=True)
            result = self._answer(job, method, planner, avoid, refine, budget_expansions)
        return dataclasses.replace(result, seconds=time.perf_counter() - began)

    def _answer(self, job: Job, method: str, planner: str | None, avoid: bool, refine: bool, budget: int
                ) -> SearchResult:
        tries = self._iterate_tries(job, method, planner, avoid, refine)
        return self._answer_at_once(job) or self._try_all(job, tries, budget)

    def _make_job(self, state: RoomState, goal: Goal, keep_out: tuple[Footprint, ...] = (),
                  give_up: float = math.inf, thorough: bool = False) -> Job:
        area = compute_area(goal, self.instance)
        table = None
        if isinstance(goal, PressGoal) and self.instance.dynamics.press_with == "hand":
            limits = {"budget": ALL} if thorough else {}
            table = self.reacher.make_table(goal.target, state.joint_steps, joint_offsets=state.joint_offsets,
                                            heading_offset=state.heading_offset, **limits)
            area = Area(area.footprint, math.hypot(*table.costs.shape[:2]) * table.cell / 2)
        return Job(state, goal, area, find_headings(goal, state, self.kinematics), table, keep_out, give_up)

    def _answer_at_once(self, job: Job) -> SearchResult | None:
        """Questions that need no search: a start inside a solid, a goal reached already, no posture at all."""
        state, goal = job.state, job.goal
        x, y, need = state.x, state.y, self.instance.robot.body_radius - _PENETRATION
        if not any(self.get_maker(shut).collision.is_clear(x, y, need) for shut in (True, False)):
            return SearchResult(PlanningReason.START_INVALID, (), (state,), nearest=(x, y))
        if job.table is not None and (job.table.costs < 0).all():
            return SearchResult(PlanningReason.NO_POSTURE, (), (state,), nearest=(x, y))
        escapes = isinstance(goal, ExitGoal) and self.instance.puzzle.is_solved(state.puzzle)  # takes a primitive
        if not escapes and is_reached(goal, state, state, self.kinematics):
            return SearchResult("reached", (), (state,))
        return None

    # --- attempts ------------------------------------------------------------------------

    def _try_all(self, job: Job, tries: Iterator[_Try], budget: int) -> SearchResult:
        """Attempt after attempt until one reaches the goal or the budget is spent."""
        spent, nearest = 0, (job.state.x, job.state.y)
        reason, looked_for_proof = PlanningReason.UNREACHABLE_AT_RESOLUTION, False
        for maker, field, avoiding, method in tries:
            if time.perf_counter() > job.give_up:
                reason = PlanningReason.TIMEOUT
                break
            if maker.get_cost(field, job.state) < 0:
                proof = None if looked_for_proof else maker.collision.find_proof(job.state.x, job.state.y, *job.area)
                looked_for_proof = True
                if proof is not None:
                    reason = (PlanningReason.GOAL_INVALID if proof == "solid" and job.table is None
                              else PlanningReason.UNREACHABLE_PROVEN)
                    break
                continue
            attempt = Attempt(job, self.kinematics, maker, field, avoiding=avoiding,
                              reacher=None if job.table is None else self.reacher)
            limit = (budget - spent) // 2 if avoiding else budget - spent  # leave some for doing without avoiding
            ended, nodes = self._run(attempt, limit)
            spent += nodes
            if isinstance(ended, SearchResult):
                return dataclasses.replace(ended, method=method, expansions=spent)
            nearest = attempt.find_nearest()
            if ended is PlanningReason.TIMEOUT or (ended is PlanningReason.BUDGET_EXHAUSTED and not avoiding):
                reason = ended
                break
        return SearchResult(reason, (), (job.state,), expansions=spent, nearest=nearest)

    def _run(self, attempt: Attempt, budget: int) -> tuple[SearchResult | PlanningReason, int]:
        """Search with rising weights until something is found, and look once more for less."""
        spent, ended = 0, PlanningReason.BUDGET_EXHAUSTED
        for slack, weight, nodes in LADDER:
            attempt.restart(slack=slack, weight=weight)
            ended = attempt.advance(min(nodes, budget - spent))
            spent += attempt.expansions
            if ended is not PlanningReason.BUDGET_EXHAUSTED:
                break
        if not isinstance(ended, SearchResult) or spent >= LADDER[0][2] or attempt.job.table is not None:
            return ended, spent
        for slack in (1, SHORT):
            if slack == 1 or len(ended.primitives) <= SHORT:
                attempt.restart(slack=slack, most=len(ended.primitives))
                better = attempt.advance(min(IMPROVEMENT, budget - spent))
                spent += attempt.expansions
                ended = better if isinstance(better, SearchResult) else ended
        return ended, spent

    def _iterate_tries(self, job: Job, method: str, planner: str | None, avoid: bool, refine: bool
                       ) -> Iterator[_Try]:
        """What to try, one after the other."""
        is_open = self.instance.puzzle.is_solved(job.state.puzzle)
        others = set(range(len(self.instance.targets))) - {getattr(job.goal, "target", -1)}
        avoid = avoid and bool(others or (is_open and not isinstance(job.goal, ExitGoal)))
        door_shut = not is_open
        if door_shut and not self.get_maker(True).collision.is_free(job.state.x, job.state.y):
            # in the doorway itself, where a shut door holds nobody
            door_shut = not self.get_maker(False).collision.is_free(job.state.x, job.state.y)
        if method == "corridor":
            maker = self.get_maker(door_shut)
            for allowed in self._iterate_corridors(job, maker, planner):
                yield _Try(maker, self._make_field(job, maker, allowed), avoid, method)
        for refinement, avoiding in ((0, True), (1, True), (0, False), (1, False), (2, False), (3, False)):
            states = self.get_maker(door_shut).states * 4**refinement
            is_coarse = refinement == 0 or (refine and states <= MOST_REFINED_STATES)
            if (avoid or not avoiding) and is_coarse:
                maker = self.get_maker(door_shut, refinement)
                yield _Try(maker, self._get_field(job, maker), avoiding, METHODS[0])

    def _iterate_corridors(self, job: Job, maker: FieldMaker, planner: str | None) -> Iterator[NDArray[np.bool_]]:
        """Cells round the path of a path planner, wider and wider."""
        goal = job.goal
        if job.table is not None:
            states, costs = self._find_postures(job, maker)
            goal = maker.points[states[np.argsort(costs, kind="stable")[:64]] // maker.headings]
        found = self.navigator.plan((job.state.x, job.state.y), goal, planner, door_shut=maker.door_shut,
                                    time_limit=min(job.give_up - time.perf_counter(), TIME_LIMIT))
        if found.status != "exact":
            return
        legs = np.diff(found.path, axis=0)
        middles, lengths = found.path[:-1] + legs / 2, np.hypot(*legs.T)
        shapes = stack_footprints([
            make_footprint(middle[0], middle[1], length / 2, 0.0, math.atan2(leg[1], leg[0]))
            for middle, leg, length in zip(middles.tolist(), legs.tolist(), lengths.tolist(), strict=True)
        ])
        away = compute_distance_many(maker.points, shapes)
        for width in CORRIDORS:
            yield away <= width * max(self.instance.robot.move_step, 2 * maker.size)

    # --- fields --------------------------------------------------------------------------

    def _get_field(self, job: Job, maker: FieldMaker) -> Field:
        state = job.state
        posture = None
        if job.table is not None:
            posture = state.joint_steps, state.joint_offsets, state.heading_offset, job.table.complete_to
        facing = None if job.facing is None else job.facing.tobytes()
        return maker.get((job.goal, posture, facing), lambda: self._make_field(job, maker, None))

    def _make_field(self, job: Job, maker: FieldMaker, allowed: NDArray[np.bool_] | None) -> Field:
        if job.table is None:
            return maker.make_field(*job.area, facing=job.facing, allowed=allowed)
        return maker.spread(*self._find_postures(job, maker), maker.headings, allowed)

    def _find_postures(self, job: Job, maker: FieldMaker) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """States (cell * headings + heading) from which the arm finishes the job, and its joint steps."""
        assert job.table is not None
        table, far = job.table, np.iinfo(np.int16).max
        costs = np.where(table.costs < 0, far, table.costs)
        near = np.flatnonzero(maker.standing & (compute_distance_many(
            maker.points, stack_footprints([job.area.footprint])) <= job.area.reach))
        least = np.full((len(near), costs.shape[2]), far, dtype=np.int16)
        for i, j in itertools.product((-0.5, 0.0, 0.5), repeat=2):
            shift = (i * maker.size, j * maker.size)
            at = np.floor((maker.points[near] + shift - table.low) / table.cell).astype(int)
            inside = ((at >= 0) & (at < costs.shape[:2])).all(axis=1)
            columns, rows = at[inside].T
            least[inside] = np.minimum(least[inside], costs[columns, rows])
        which, heading = np.nonzero(least < far)
        return near[which] * maker.headings + heading, least[which, heading].astype(np.int64)
