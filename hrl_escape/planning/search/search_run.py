"""One A* search with one field: the query as arrays, and candidates made into verified plans.

The compiled search proposes goal nodes, cheapest first. Each is completed by joint steps and
replayed through the room's `Kinematics`, and only a plan that reaches the goal there is returned.
`primitive_search.py` decides which searches to run, with which fields.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.clock import Clock
from hrl_escape.env.geometry import Footprint, compute_distance_many, stack_footprints
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.poses import list_touched
from hrl_escape.errors import PlanningReason
from hrl_escape.floor.cost_to_go import FieldMaker
from hrl_escape.floor.sweeps import make_presser
from hrl_escape.planning.areas import Area, get_presser
from hrl_escape.planning.goals import ExitGoal, Goal, PressGoal, is_reached
from hrl_escape.planning.search import a_star

if TYPE_CHECKING:
    from hrl_escape.planning.arm.reacher import Reacher, ReachTable

_SLICE = 5_000  # nodes between two checks of the clock
_NODES = 1 << 11
MOST_PATHS = 4
"""Paths of the arm round solids that one search plans: each takes a tenth of a second or two."""
_ROUNDING = 1e-9  # margin of candidates, m; the replay decides


@dataclasses.dataclass(frozen=True)
class SearchResult:
    """Result of a search."""

    status: PlanningReason | Literal["reached"]  # `"reached"`, or the `PlanningReason` of the failure
    primitives: tuple[int, ...]  # actions, in order
    states: tuple[RoomState, ...]
    """The states they lead to by the room's own kinematics without noise and slip, one more than primitives; the first
    is the start."""
    also_pressed: tuple[int, ...] = ()  # other targets that are pressed on the way because this could not be avoided
    method: str = "fields"  # `fields`, or the path planner round whose path it was found
    expansions: int = 0  # nodes expanded
    seconds: float = 0.0  # wall time without compilation
    timed_out: bool = False  # the clock cut the search short; without it the result may be better
    nearest: tuple[float, float] | None = None  # visited place (x, y) nearest to a goal that was not reached, m

    @property
    def is_reached(self) -> bool:
        """True if the primitives reach the goal."""
        return self.status == "reached"


class SearchProblem(NamedTuple):
    """Problem that several search runs share."""

    state: RoomState  # first state
    goal: Goal  # the goal
    area: Area  # area of the body's axis that reaches it; for a press by hand, a superset of that area
    facing: NDArray[np.bool_] | None  # headings that reach it, shape (headings,); None if any will do
    table: ReachTable | None  # joint steps of a press by hand from each pose
    keep_out: tuple[Footprint, ...]  # footprints that the body must not meet
    clock: Clock  # time limit
    seed: int = 0  # of the path planner
    effort: int = 0  # further searches for a shorter plan; -1 for none at all
    onward: NDArray[np.int16] | None = None
    """Cost-to-go after a press by hand, shape (cells * headings,), int16, -1 where there is none; the table holds it,
    too."""


class HeadingTable(NamedTuple):
    """Directions and moves at every heading of the lattice, shared by all searches with one heading offset."""

    turns: NDArray[np.float64]  # cosine and sine, shape (headings, 2)
    moves: NDArray[np.float64]  # displacement of each translation, shape (headings, translations, 2), m
    reaches: NDArray[np.float64]  # floor distance at which the base touches each target, or -1, shape (targets,), m
    pressers: NDArray[np.bool_]  # whether the outline of the base must touch each target, bool, shape (targets,)

    @classmethod
    def make(cls, rules: Kinematics, heading_offset: float) -> HeadingTable:
        """Compute the table for headings that are offset from the lattice, rad."""
        turns = np.array([rules.get_rotation(n, heading_offset) for n in range(rules.headings)])
        instance = rules.instance
        pressers = np.array([get_presser(PressGoal(i), instance).kind >= 0 for i in range(len(instance.targets))],
                            dtype=np.bool_)
        return cls(turns, rules.actions.compute_moves(*turns.T),
                   _compute_reaches(instance, 0.0), pressers)


class SearchRun:
    """One search with one field; `restart` begins it and `advance` continues it.

    Attributes:
        expansions: nodes expanded so far.
    """

    def __init__(self, problem: SearchProblem, kinematics: Kinematics, maker: FieldMaker, field: NDArray[np.int16], *,
                 headings: HeadingTable, avoiding: bool, reacher: Reacher | None,
                 frontiers: a_star.FrontierPool) -> None:
        """State the query.

        Args:
            problem: the problem.
            kinematics: the room's kinematics without noise and slip.
            maker: the grid of the field.
            field: cost-to-go over the grid's cells.
            headings: of the state's heading offset.
            avoiding: forbid touching other targets and entering an open exit.
            reacher: the arm, for a press by hand.
            frontiers: memory that searches share.
        """
        self.problem, self.kinematics, self._maker, self._avoiding = problem, kinematics, maker, avoiding
        self._reacher = reacher
        self._query = self._make_query(field, headings)
        self._frontiers = frontiers
        self._frontier: a_star.Frontier | None = None
        self._nodes = _NODES
        self._completed: dict[int, tuple[int, ...]] = {}
        self._paths_left = MOST_PATHS

    def restart(self, *, offset: int = 0, weight: float = 1.0, most: int = a_star.MOST_PRIMITIVES) -> None:
        """Start with a heuristic; start again with another for a shorter plan, or for any plan with fewer nodes.

        Args:
            offset: primitives subtracted from the cost-to-go, against overestimates of the grid; negative to add
                some, against underestimates.
            weight: factor of the cost-to-go: plans may be longer by this factor, and are found sooner.
            most: plans of this many primitives or more are discarded.
        """
        self._query = self._query._replace(offset=offset, weight=weight)
        self.end()
        self._frontier = self._frontiers.take(self._nodes, most)
        self._completed.clear()

    def end(self) -> None:
        """Return the frontier to the pool; only `restart` may follow."""
        if self._frontier is not None:
            self._frontiers.give_back(self._frontier)
        self._frontier = None

    @property
    def frontier(self) -> a_star.Frontier:
        """Nodes of the search, between `restart` and `end`."""
        assert self._frontier is not None
        return self._frontier

    @property
    def expansions(self) -> int:
        """Nodes expanded so far."""
        return int(self.frontier.counts[2])

    def advance(self, budget: int) -> SearchResult | PlanningReason:
        """Search until the goal is reached, the frontier is empty, or time or budget are spent.

        Args:
            budget: nodes that may be expanded.
        """
        while True:
            limit = min(budget, self.expansions + _SLICE)
            node = a_star.expand_until_goal(self._maker.scene, self._query, self.frontier, limit)
            if node >= 0:
                result = self._finish(int(node))
                if result is not None:
                    return result
            elif node == a_star.GROW:
                self._frontier = self._frontiers.enlarge(self.frontier)
                self._nodes = len(self._frontier.links)
            elif node == a_star.EXHAUSTED:
                return PlanningReason.UNREACHABLE_AT_RESOLUTION
            elif self.expansions >= budget:
                return PlanningReason.BUDGET_EXHAUSTED
            if self.problem.clock.is_up():
                return self.problem.clock.reason

    def find_nearest(self) -> tuple[float, float]:
        """Visited place nearest to the goal, m."""
        places = self.frontier.places[: self.frontier.counts[0]]
        if not len(places):
            return self.problem.state.x, self.problem.state.y
        x, y = places[compute_distance_many(places, stack_footprints([self.problem.area.footprint])).argmin()].tolist()
        return x, y

    # --- the query as arrays -----------------------------------------------------------

    def _make_query(self, field: NDArray[np.int16], headings: HeadingTable) -> a_star.SearchQuery:
        problem, rules, maker = self.problem, self.kinematics, self._maker
        state, goal, instance = problem.state, problem.goal, rules.instance
        target = goal.target if isinstance(goal, PressGoal) else -1
        others = sum(1 << i for i in range(len(instance.targets)) if i != target)
        by_hand = instance.dynamics.press_with == "hand"
        turns, reaches, presser = headings.turns, headings.reaches, np.zeros_like(headings.turns)
        if by_hand:
            hand = rules.get_hand_in_base(state.joint_steps, state.joint_offsets)
            reaches = _compute_reaches(instance, hand[2])
            presser = np.stack([turns @ (hand[0], -hand[1]), turns @ (hand[1], hand[0])], axis=1)
        shun_exit = self._avoiding and not isinstance(goal, ExitGoal) and instance.puzzle.is_solved(state.puzzle)
        area = instance.exit
        closed = (area.x_min, area.x_max, area.y_min, area.y_max) if shun_exit else (1.0, 0.0, 1.0, 0.0)
        table, table_low, table_size = _NO_TABLE, np.zeros(2), 1.0
        if problem.table is not None:
            table, table_low, table_size = problem.table.costs, problem.table.low, problem.table.cell
        bin_headings = maker.classes if problem.facing is None and not by_hand else rules.headings
        facing = np.ones(rules.headings, dtype=bool) if problem.facing is None else problem.facing
        layers = len(field) // len(maker.points)
        return a_star.SearchQuery(
            x=state.x, y=state.y, heading=state.heading_steps, touched=np.uint64(state.touching),
            turns=turns, turn_step=rules.turn_step, moves=headings.moves, lengths=rules.actions.lengths,
            turn_steps=rules.actions.turn_steps, stays=instance.dynamics.blocked == "stay", presser=presser,
            targets=maker.targets, reaches=reaches, pressers=headings.pressers, base=make_presser(instance.robot.base),
            forbidden=np.uint64(others if self._avoiding else 0), keep_out=stack_footprints(problem.keep_out),
            closed=np.array(closed), target=target, goal=stack_footprints([problem.area.footprint])[0],
            goal_reach=problem.area.reach + _ROUNDING, goal_headings=facing, field=field,
            layers=layers, shift=round(state.heading_offset / rules.turn_step) % layers, low=maker.low,
            size=maker.size, rows=maker.shape[1], offset=0, weight=1.0, table=table,
            table_low=table_low, table_size=table_size, bin_size=maker.bin_size, bin_headings=bin_headings,
        )

    # --- candidates --------------------------------------------------------------------

    def _finish(self, node: int) -> SearchResult | None:
        """Complete and replay a goal node; None if it is dropped, or put back at its true, higher cost."""
        primitives = self._completed.pop(node, None)
        if primitives is None:
            primitives = self._complete(node)
            if primitives is None:
                return None
            onward = self.get_onward(node)
            if onward < 0:
                return None
            cost = len(primitives) + onward
            if cost > int(self.frontier.facts[node, 1]):
                self._completed[node] = primitives
                a_star.put_back(self.frontier, node, cost)
                return None
        return self._replay(primitives)

    def get_onward(self, node: int) -> int:
        """Cost-to-go after the press at a goal node; 0 where only the press counts."""
        if self.problem.onward is None:
            return 0
        cell = self._maker.grid.find_number(*self.frontier.places[node].tolist())
        return int(self.problem.onward[cell * self._maker.headings + int(self.frontier.facts[node, 0])])

    def _complete(self, node: int) -> tuple[int, ...] | None:
        """Primitives to a goal node, with the joint steps of a press by hand."""
        facts, problem = self.frontier.facts, self.problem
        by_table = facts[node, 3] < 0
        last = int(facts[node, 2]) if by_table else node
        moves = self.frontier.list_actions(last)
        if self._reacher is None:
            return tuple(moves)
        assert isinstance(problem.goal, PressGoal)
        state, target = problem.state, problem.goal.target
        if not by_table:
            may_jam = self._reacher.collide and not self._reacher.is_push(state, moves, target)
            return None if may_jam else tuple(moves)
        x, y = self.frontier.places[last].tolist()
        joints = self._reacher.get_configuration(x, y, int(facts[last, 0]), state.joint_steps, target,
                                                 joint_offsets=state.joint_offsets, heading_offset=state.heading_offset)
        if joints is None:
            return None
        if not (self._avoiding or self._reacher.collide):
            return (*moves, *self._list_joint_steps(state.joint_steps, joints))
        steps = self._reacher.order_steps(state, moves, joints, target, avoiding=self._avoiding)
        return steps if steps is not None or not self._reacher.collide else self._plan_round(moves, joints, target)

    def _plan_round(self, moves: Sequence[int], joints: tuple[int, ...], target: int) -> tuple[int, ...] | None:
        """Primitives to a press by moves, then joint steps round solids; at most `MOST_PATHS` paths are planned."""
        assert self._reacher is not None
        others = ~(1 << target) if self._avoiding else 0
        end = self._reacher.move_base(self.problem.state, moves, others) if self._paths_left else None
        if end is None:
            return None
        self._paths_left -= 1
        steps = self._reacher.plan_steps(end, joints, others)
        return None if steps is None else (*moves, *steps)

    def _list_joint_steps(self, begin: tuple[int, ...], end: tuple[int, ...]) -> list[int]:
        """Primitives that take the joints from one configuration to another, joint by joint."""
        actions: list[int] = []
        for pair, low, high in zip(self.kinematics.actions.joints, begin, end, strict=True):
            actions += [pair.decrement if high < low else pair.increment] * abs(high - low)
        return actions

    def _replay(self, primitives: Sequence[int]) -> SearchResult | None:
        """Replay a plan by the room's kinematics, cut where the goal is first reached; None if it never is."""
        goal, rules = self.problem.goal, self.kinematics
        states, pressed = [self.problem.state], 0
        for count, primitive in enumerate(primitives, 1):
            before = states[-1]
            after, _, terminated, _, _ = rules.step(before, primitive)
            states.append(after)
            pressed |= after.touching & ~before.touching
            if is_reached(goal, before, after, rules):
                others = pressed & ~(1 << goal.target) if isinstance(goal, PressGoal) else pressed
                if others and self._avoiding:
                    return None
                also = list_touched(others)
                return SearchResult("reached", tuple(primitives[:count]), tuple(states), also)
            if terminated:
                return None
        return None


_NO_TABLE = np.zeros((0, 0, 1), dtype=np.int16)


def _compute_reaches(instance: RoomInstance, hand_z: float) -> NDArray[np.float64]:
    return np.array([instance.compute_press_reach(target, hand_z) for target in instance.targets], dtype=float)
