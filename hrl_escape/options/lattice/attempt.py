"""One A* attempt at one question: from a goal and a field to arrays, from candidates to verified plans.

The compiled search proposes goal nodes, cheapest first; each is completed (joint steps), and
replayed through the room's `Kinematics`, and only what truly reaches the goal is returned.
Which attempts to make, and with which fields, is decided in `tracking.py`.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.geometry import Footprint, compute_distance_many, stack_footprints
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.errors import PlanningReason
from hrl_escape.options.goals import ExitGoal, Goal, PressGoal, is_reached
from hrl_escape.options.lattice import search
from hrl_escape.options.lattice.areas import Area
from hrl_escape.options.lattice.fields import FieldMaker

if TYPE_CHECKING:
    from hrl_escape.options.reaching import Reacher, ReachTable

__all__ = ["Attempt", "Job", "SearchResult"]

_SLICE = 20_000  # nodes between two looks at the clock
_NODES = 1 << 11
_ROUNDING = 1e-9  # candidates this far outside are looked at; the replay decides


@dataclasses.dataclass(frozen=True)
class SearchResult:
    """What a search found.

    Attributes:
        status: `"reached"`, or the `PlanningReason` why not.
        primitives: actions, in order.
        states: the states they lead to by the room's own kinematics without noise and slip, one
            more than primitives; the first is where the search began.
        also_pressed: other targets whose touching begins on the way because it could not be avoided.
        method: how it was found: `fields`, or `corridor` where the corridor round a path was enough.
        expansions: nodes expanded.
        seconds: wall time.
        nearest: place (x, y) looked at that is nearest to the goal, where it was not reached, m.
    """

    status: PlanningReason | Literal["reached"]
    primitives: tuple[int, ...]
    states: tuple[RoomState, ...]
    also_pressed: tuple[int, ...] = ()
    method: str = "fields"
    expansions: int = 0
    seconds: float = 0.0
    nearest: tuple[float, float] | None = None

    @property
    def is_reached(self) -> bool:
        """Whether the primitives reach the goal."""
        return self.status == "reached"


class Job(NamedTuple):
    """One question, as all attempts at it share it.

    Attributes:
        state: where to begin.
        goal: what to reach.
        area: where the body's axis is when it is reached; for a press by hand, no more than that.
        facing: headings at which it is reached, shape (headings,); None where any will do.
        table: joint steps that a press by hand still takes from each pose.
        keep_out: footprints that the body must not meet.
        give_up: when to stop, by `time.perf_counter`.
    """

    state: RoomState
    goal: Goal
    area: Area
    facing: NDArray[np.bool_] | None
    table: ReachTable | None
    keep_out: tuple[Footprint, ...]
    give_up: float


class Attempt:
    """One search with one field; `advance` runs it.

    Attributes:
        expansions: nodes expanded so far.
    """

    def __init__(self, job: Job, kinematics: Kinematics, maker: FieldMaker, field: NDArray[np.int16], *,
                 avoiding: bool, reacher: Reacher | None) -> None:
        """Set the search up; nothing is expanded yet.

        Args:
            job: the question.
            kinematics: the room's kinematics without noise and slip.
            maker: the grid of the field.
            field: cost-to-go over the maker's cells.
            avoiding: whether other targets must not be touched, nor an open exit entered.
            reacher: the arm, for a press by hand.
        """
        self.job, self.kinematics, self._maker, self._avoiding = job, kinematics, maker, avoiding
        self._reacher = reacher
        self._query = self._make_query(field)
        self._frontier = search.make_frontier(_NODES)
        self._ready: dict[int, tuple[int, ...]] = {}

    def restart(self, *, slack: int = 0, weight: float = 1.0, most: int = search.MOST_PRIMITIVES) -> None:
        """Begin anew, to look for a shorter plan or for any plan with fewer nodes.

        Args:
            slack: primitives by which the field's prices are lowered, for what its grid may overestimate; negative
                to raise them, for what it may underestimate.
            weight: what prices are multiplied with: plans may be longer by as much, and are found sooner.
            most: plans of this many primitives or more are of no use.
        """
        self._query = self._query._replace(slack=slack, weight=weight)
        self._frontier = search.make_frontier(_NODES, most)
        self._ready.clear()

    @property
    def expansions(self) -> int:
        """Nodes expanded so far."""
        return int(self._frontier.counts[2])

    def advance(self, budget: int) -> SearchResult | PlanningReason:
        """Search until the goal is reached, nothing is left, or time or budget are spent.

        Args:
            budget: nodes that may be expanded.
        """
        while True:
            limit = min(budget, self.expansions + _SLICE)
            node = search.advance(self._maker.scene, self._query, self._frontier, limit)
            if node >= 0:
                result = self._finish(int(node))
                if result is not None:
                    return result
            elif node == search.GROW:
                self._frontier = search.enlarge_frontier(self._frontier)
            elif node == search.EXHAUSTED:
                return PlanningReason.UNREACHABLE_AT_RESOLUTION
            elif self.expansions >= budget:
                return PlanningReason.BUDGET_EXHAUSTED
            if time.perf_counter() > self.job.give_up:
                return PlanningReason.TIMEOUT

    def find_nearest(self) -> tuple[float, float]:
        """Place looked at that is nearest to the goal, m."""
        places = self._frontier.places[: self._frontier.counts[0]]
        if not len(places):
            return self.job.state.x, self.job.state.y
        x, y = places[compute_distance_many(places, stack_footprints([self.job.area.footprint])).argmin()].tolist()
        return x, y

    # --- the question as arrays --------------------------------------------------------

    def _make_query(self, field: NDArray[np.int16]) -> search.Query:
        job, rules, maker = self.job, self.kinematics, self._maker
        state, goal, instance = job.state, job.goal, rules.instance
        target = goal.target if isinstance(goal, PressGoal) else -1
        others = sum(1 << i for i in range(len(instance.targets)) if i != target)
        by_hand = instance.dynamics.press_with == "hand"
        hand = rules.get_hand_in_base(state.joint_steps, state.joint_offsets) if by_hand else (0.0, 0.0, 0.0)
        turns = np.array([rules.get_rotation(n, state.heading_offset) for n in range(rules.headings)])
        reaches = np.array([instance.compute_press_reach(target, hand[2]) for target in instance.targets], dtype=float)
        presser = np.stack([turns @ (hand[0], -hand[1]), turns @ (hand[1], hand[0])], axis=1)
        shun_exit = self._avoiding and not isinstance(goal, ExitGoal) and instance.puzzle.is_solved(state.puzzle)
        area = instance.exit
        closed = (area.x_min, area.x_max, area.y_min, area.y_max) if shun_exit else (1.0, 0.0, 1.0, 0.0)
        table, table_low, table_size = _NO_TABLE, np.zeros(2), 1.0
        if job.table is not None:
            table, table_low, table_size = job.table.costs, job.table.low, job.table.cell
        bin_headings = maker.classes if job.facing is None and not by_hand else rules.headings
        facing = np.ones(rules.headings, dtype=bool) if job.facing is None else job.facing
        layers = len(field) // len(maker.points)
        return search.Query(
            x=state.x, y=state.y, heading=state.heading_steps, touched=np.uint64(state.touching),
            moves=self._compute_moves(turns), length=instance.robot.move_step, presser=presser,
            targets=maker.targets, reaches=reaches,
            forbidden=np.uint64(others if self._avoiding else 0), keep_out=stack_footprints(job.keep_out),
            closed=np.array(closed), target=target, goal=stack_footprints([job.area.footprint])[0],
            goal_reach=job.area.reach + _ROUNDING, goal_headings=facing, field=field,
            layers=layers, shift=round(state.heading_offset / rules.turn_step) % layers, low=maker.low,
            size=maker.size, rows=maker.shape[1], slack=0, weight=1.0, table=table,
            table_low=table_low, table_size=table_size, bin_size=maker.bin_size, bin_headings=bin_headings,
        )

    def _compute_moves(self, turns: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacement of each translating primitive at each heading, as `Kinematics` computes it."""
        cos, sin = turns.T
        step = self.kinematics.instance.robot.move_step
        return np.stack([
            np.stack([step * (p.forward * cos - p.left * sin), step * (p.forward * sin + p.left * cos)], axis=1)
            for p in self.kinematics.primitives[:4]
        ])

    # --- candidates --------------------------------------------------------------------

    def _finish(self, node: int) -> SearchResult | None:
        """Complete and replay a goal node; None if it is dropped, or put back because it is dearer than it looked."""
        primitives = self._ready.pop(node, None)
        if primitives is None:
            primitives = self._complete(node)
            if primitives is None:
                return None
            extra = len(primitives) - int(self._frontier.facts[node, 1])
            if extra > 0:
                self._ready[node] = primitives
                search.put_back(self._frontier, node, len(primitives))
                return None
        return self._replay(primitives)

    def _complete(self, node: int) -> tuple[int, ...] | None:
        """Primitives that lead to a goal node, with the joint steps of a press by hand."""
        facts, job = self._frontier.facts, self.job
        by_table = facts[node, 3] < 0
        last = int(facts[node, 2]) if by_table else node
        moves: list[int] = []
        at = last
        while facts[at, 2] >= 0:
            moves.append(int(facts[at, 3]))
            at = int(facts[at, 2])
        moves.reverse()
        if self._reacher is None:
            return tuple(moves)
        assert isinstance(job.goal, PressGoal)
        state, target = job.state, job.goal.target
        if not by_table:
            may_jam = self._reacher.collide and self._avoiding and not self._reacher.is_push(state, moves, target)
            return None if may_jam else tuple(moves)
        x, y = self._frontier.places[last].tolist()
        joints = self._reacher.get_configuration(
            x, y, int(facts[last, 0]), state.joint_steps, target, joint_offsets=state.joint_offsets,
            heading_offset=state.heading_offset,
        )
        if joints is None:
            return None
        if self._avoiding:
            return self._reacher.order_steps(state, moves, joints, target)
        return (*moves, *_list_joint_steps(state.joint_steps, joints))

    def _replay(self, primitives: Sequence[int]) -> SearchResult | None:
        """The room's word on a plan, which ends where the goal is first reached; None if it never is."""
        goal, rules = self.job.goal, self.kinematics
        states, pressed = [self.job.state], 0
        for count, primitive in enumerate(primitives, 1):
            before = states[-1]
            after, _, terminated, _, _ = rules.step(before, primitive)
            states.append(after)
            pressed |= after.touching & ~before.touching
            if is_reached(goal, before, after, rules):
                others = pressed & ~(1 << goal.target) if isinstance(goal, PressGoal) else pressed
                if others and self._avoiding:
                    return None
                also = tuple(i for i in range(others.bit_length()) if others >> i & 1)
                return SearchResult("reached", tuple(primitives[:count]), tuple(states), also)
            if terminated:
                return None
        return None


_NO_TABLE = np.zeros((0, 0, 1), dtype=np.int16)


def _list_joint_steps(begin: tuple[int, ...], end: tuple[int, ...]) -> list[int]:
    """Primitives that take the joints from one configuration to another, joint by joint."""
    actions: list[int] = []
    for joint, (low, high) in enumerate(zip(begin, end, strict=True)):
        actions += [6 + 2 * joint + (high < low)] * abs(high - low)
    return actions
