"""Fewest primitives to a goal: A* over primitives on exact poses, with a cost-to-go field as heuristic.

Poses are exactly the poses of the room's kinematics. Blocked moves end at the wall, so a body gets within a press
margin. Poses within a bin count as one. Every plan is replayed through `Kinematics`, without noise and slip. The
method `corridor` restricts the field to a corridor round an OMPL path. The arm's part of a press by hand comes from
`reacher.py`.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections import Counter
from collections.abc import Hashable, Iterator, Sequence
from functools import cached_property, partial
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hrl_escape.clock import NO_LIMIT, Clock, OutOfTime
from hrl_escape.env.config import CONTACT_SKIN
from hrl_escape.env.geometry import Footprint, compute_distance_many, stack_footprints
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.poses import list_touched
from hrl_escape.errors import PlanningReason, UnknownNameError
from hrl_escape.floor.clearance import CollisionMap
from hrl_escape.floor.cost_to_go import FieldMaker, Seeds, make_collision
from hrl_escape.floor.sweeps import make_presser, turns_anywhere
from hrl_escape.planning.areas import Area, compute_goal_area, find_headings, get_presser
from hrl_escape.planning.arm.joint_lattice import NEVER, UNLIMITED
from hrl_escape.planning.goals import ExitGoal, Goal, PoseGoal, PressGoal, RegionGoal, is_reached
from hrl_escape.planning.paths.problem import DEFAULT_PLANNER
from hrl_escape.planning.route import EFFORTS
from hrl_escape.planning.search import a_star

if TYPE_CHECKING:
    from hrl_escape.planning.arm.reacher import Reacher, ReachTable
    from hrl_escape.planning.paths.navigator import Navigator

METHODS = ("auto", "fields", "corridor")
LARGE = 3_000.0
"""Floor area beyond which the grid of a room's fields is dearer than the first few places asked for by corridors, m^2.

On 20 x 20 m a first query in a corridor takes 0.6 to 1.1 of the time along fields, later ones 1.8 times the time or
more; for places on 60 x 60 m the first one takes 0.7, on 200 x 200 m 0.6 of it (`python -m benchmarks.planners`)."""
EXPANSIONS = 300_000
SCHEDULE = ((0, 1.0, 3_000), (-1, 1.05, 6_000), (-2, 1.1, 20_000), (-4, 1.5, EXPANSIONS))
"""Weighted-A* schedule: (heuristic offset, weight, node budget), from the fewest primitives to any plan at all."""
IMPROVEMENT = 2_000
"""Node budget of another search with a lower heuristic, after a plan found at the first weight."""
SHORT = 8
"""Longest plan that is searched again without the field, where the field's error can be as large as the plan."""
CORRIDORS = (3.0, 6.0)
"""Half widths of corridors, in moves."""
MOST_REFINED_STATES = 6_000_000
MOST_PARTS = 100
"""Most pairs of a target and offsets of heading and joints whose parts of the floor are remembered."""
_PENETRATION = 0.02 + CONTACT_SKIN  # beyond it, m, a body that contacts pushed into a wall cannot drive off again

Field: TypeAlias = NDArray[np.int16]


# --- one search with one field ------------------------------------------------------------

_SLICE = 5_000  # nodes between two checks of the clock
_NODES = 1 << 11
MOST_PATHS = 4
"""Paths of the arm round solids that one search plans: each takes a tenth of a second or two."""
_ROUNDING = 1e-9  # margin of candidates, m; the replay decides
_GRAIN = 1e-6  # margin of a proof, m
_NO_TABLE = np.zeros((0, 0, 1), dtype=np.int16)


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
    timed_out: bool = False  # the clock cut the search short; without it the result can be better
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
    facing: NDArray[np.bool_] | None  # headings that reach it, shape (headings,), or None if any will do
    table: ReachTable | None  # joint steps of a press by hand from each pose
    keep_out: tuple[Footprint, ...]  # footprints that the body must not meet
    clock: Clock  # time limit
    seed: int = 0  # of the path planner
    effort: int = 0  # further searches for a shorter plan; -1 for none at all
    onward: NDArray[np.int16] | None = None
    """Cost-to-go after a press by hand, shape (cells * headings,), int16, -1 where there is none; the table holds it,
    too."""


def make_motions(rules: Kinematics, heading_offset: float) -> a_star.Motions:
    """Make the motions at headings that are offset from the lattice, rad, with targets as the base presses them."""
    turns, room = np.array([rules.get_rotation(n, heading_offset) for n in range(rules.headings)]), rules.instance
    pressers = [not turns_anywhere(get_presser(PressGoal(i), room).outline) for i in range(len(room.targets))]
    return a_star.Motions(
        turns=turns, turn_step=rules.turn_step, moves=rules.actions.compute_moves(*turns.T),
        lengths=rules.actions.lengths, turn_steps=rules.actions.turn_steps, stays=room.dynamics.blocked == "stay",
        presser=np.zeros_like(turns), targets=stack_footprints([target.footprint for target in room.targets]),
        reaches=_compute_reaches(room, 0.0), pressers=np.array(pressers, dtype=np.bool_),
        base=make_presser(room.robot.base))


class SearchRun:
    """One search with one field; `restart` begins it and `advance` continues it.

    The compiled search proposes goal nodes, cheapest first. Each is completed by joint steps and replayed through the
    room's `Kinematics`, and only a plan that reaches the goal there is returned.
    """

    def __init__(self, problem: SearchProblem, kinematics: Kinematics, maker: FieldMaker, field: NDArray[np.int16], *,
                 motions: a_star.Motions, avoiding: bool, reacher: Reacher | None,
                 frontiers: a_star.FrontierPool) -> None:
        """State the query; avoiding is to forbid touching other targets and entering an open exit."""
        self.problem, self.kinematics, self._maker, self._avoiding = problem, kinematics, maker, avoiding
        self._reacher = reacher
        by_hand = kinematics.instance.dynamics.press_with == "hand"
        self._query = self._make_query(field, self._press_by_hand(motions) if by_hand else motions)
        self._frontiers = frontiers
        self._frontier: a_star.Frontier | None = None
        self._nodes = _NODES
        self._completed: dict[int, tuple[int, ...]] = {}
        self._paths_left = MOST_PATHS

    def restart(self, *, offset: int = 0, weight: float = 1.0, most: int = a_star.MOST_PRIMITIVES) -> None:
        """Start with a heuristic; start again with another for a shorter plan, or for any plan with fewer nodes.

        The offset is subtracted from the cost-to-go, against overestimates of the grid, or added if negative. The
        weight multiplies it: plans are found sooner and can be longer. Plans of `most` primitives are too long.
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
        """Search until the goal is reached, the frontier is empty, or time or a budget of nodes are spent."""
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

    def _press_by_hand(self, motions: a_star.Motions) -> a_star.Motions:
        """Motions with the resting hand as the presser of targets."""
        state, turns, rules = self.problem.state, motions.turns, self.kinematics
        x, y, z = rules.get_hand_in_base(state.joint_steps, state.joint_offsets)
        presser = np.stack([turns @ (x, -y), turns @ (y, x)], axis=1)
        return motions._replace(presser=presser, reaches=_compute_reaches(rules.instance, z))

    def _make_query(self, field: NDArray[np.int16], motions: a_star.Motions) -> a_star.SearchQuery:
        problem, rules, maker = self.problem, self.kinematics, self._maker
        state, goal, instance = problem.state, problem.goal, rules.instance
        target = goal.target if isinstance(goal, PressGoal) else -1
        others = sum(1 << i for i in range(len(instance.targets)) if i != target)
        by_hand = instance.dynamics.press_with == "hand"
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
            motions=motions,
            forbidden=np.uint64(others if self._avoiding else 0), keep_out=stack_footprints(problem.keep_out),
            closed=np.array(closed), target=target, goal=stack_footprints([problem.area.footprint])[0],
            goal_reach=problem.area.reach + _ROUNDING, goal_headings=facing, field=field,
            layers=layers, shift=round(state.heading_offset / rules.turn_step) % layers, low=maker.low,
            size=maker.size, rows=maker.shape[1], offset=0, weight=1.0, table=table,
            table_low=table_low, table_size=table_size, bin_size=maker.bin_size, bin_headings=bin_headings,
        )

    # --- candidates --------------------------------------------------------------------

    def _finish(self, node: int) -> SearchResult | None:
        """Complete and replay a goal node; return None if it is dropped, or put back at its true, higher cost."""
        primitives = self._completed.pop(node, None)
        if primitives is None:
            primitives = self._complete(node)
            if primitives is None:
                return None
            onward = self._get_onward(node)
            if onward < 0:
                return None
            cost = len(primitives) + onward
            if cost > int(self.frontier.facts[node, 1]):
                self._completed[node] = primitives
                a_star.put_back(self.frontier, node, cost)
                return None
        return self._replay(primitives)

    def _get_onward(self, node: int) -> int:
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
        """Replay a plan by the room's kinematics up to the goal; return None if it misses the goal."""
        goal, rules = self.problem.goal, self.kinematics
        states, pressed = [self.problem.state], 0
        for count, primitive in enumerate(primitives, 1):
            before = states[-1]
            after, _, terminated, _, events = rules.step(before, primitive)
            states.append(after)
            pressed |= events.pressed
            if is_reached(goal, before, after, rules):
                others = pressed & ~(1 << goal.target) if isinstance(goal, PressGoal) else pressed
                if others and self._avoiding:
                    return None
                also = list_touched(others)
                return SearchResult("reached", tuple(primitives[:count]), tuple(states), also)
            if terminated:
                return None
        return None


def _compute_reaches(instance: RoomInstance, hand_z: float) -> NDArray[np.float64]:
    return np.array([instance.compute_press_reach(target, hand_z) for target in instance.targets], dtype=float)


# --- all searches for one goal -------------------------------------------------------------


class _Variant(NamedTuple):
    """Variant of the search for one problem: grid, field, whether other targets are avoided, and method.

    The field is None if it is known to be -1 at the start.
    """

    maker: FieldMaker
    field: Field | None
    avoiding: bool
    method: str


class PrimitiveSearch:
    """Search for the fewest primitives to any goal in one room; fields of goals are kept for later searches.

    Noise and slip are ignored; physics is planned as if kinematic. Everything is computed on first use. Not
    thread-safe. Pickling keeps the room and drops the fields.
    """

    def __init__(self, instance: RoomInstance, kinematics: Kinematics | None = None) -> None:
        self.instance = instance
        self.kinematics = kinematics or Kinematics(instance, is_still=True)
        operators = instance.symbolic_model.operators
        names = {operator.target for operator in operators if operator.action == "press"}
        self._pressed = {i for i, target in enumerate(instance.targets) if target.name in names}
        self._makers: dict[tuple[bool, int], FieldMaker] = {}
        self._maps: dict[bool, CollisionMap] = {}
        self._parts: dict[Hashable, frozenset[int]] = {}
        self.frontiers = a_star.FrontierPool()

    def __reduce__(self) -> tuple[type, tuple]:
        return type(self), (self.instance,)

    @cached_property
    def navigator(self) -> Navigator:
        """Path planner for corridors."""
        from hrl_escape.planning.paths.navigator import Navigator  # loads OMPL, which fields do not need

        return Navigator(self.instance, self.get_collision)

    @cached_property
    def reacher(self) -> Reacher:
        """Arm of a room whose targets are pressed by hand."""
        from hrl_escape.planning.arm.reacher import Reacher  # loads Pinocchio, which body presses do not need

        return Reacher(self.instance)

    def get_collision(self, door_shut: bool) -> CollisionMap:
        """Clearances of the room with the exit door shut or open, computed on first use."""
        shut = door_shut and self.instance.door is not None
        if shut not in self._maps:
            self._maps[shut] = make_collision(self.instance, shut)
        return self._maps[shut]

    def get_maker(self, door_shut: bool, refinement: int = 0, clock: Clock = NO_LIMIT) -> FieldMaker:
        """Grid of the fields with the exit door shut or open, made on first use."""
        key = (door_shut and self.instance.door is not None, refinement)
        if key not in self._makers:
            self._makers[key] = FieldMaker(self.instance, self.kinematics, door_shut=key[0], refinement=refinement,
                                           collision=self.get_collision(key[0]), clock=clock)
        return self._makers[key]

    def adapt(self, instance: RoomInstance, kinematics: Kinematics) -> PrimitiveSearch:
        """Return the search of an edited room, which keeps the grids and fields that the edit does not change."""
        new, old = PrimitiveSearch(instance, kinematics), self.instance
        if _get_floor(instance) != _get_floor(old) or not instance.robot.base.turns_anywhere:
            return new
        before, after = Counter(old.solids), Counter(instance.solids)
        changed = [solid.footprint for solid in (*(before - after), *(after - before))]
        same_arm = (instance.robot, instance.dynamics.press_with) == (old.robot, old.dynamics.press_with)

        def keeps(key: object) -> bool:
            goal = key[0]  # type: ignore[index]  # of `_get_field`
            if not isinstance(goal, PressGoal):
                return not isinstance(goal, ExitGoal) or instance.exit == old.exit
            return same_arm and instance.targets[goal.target : goal.target + 1] == old.targets[
                goal.target : goal.target + 1]

        new._maps = {shut: held.adapt(instance, shut, changed) for shut, held in self._maps.items()}
        new._makers = {(shut, 0): maker.adapt(instance, new._maps[shut], changed, keeps)
                       for (shut, refinement), maker in self._makers.items() if not refinement}
        return new

    def prepare(self) -> None:
        """Compute the fields of all targets and the exit now, so that the first searches are as quick as later ones."""
        state = self.kinematics.make_state(self.instance.starts[0])
        for goal in (*(PressGoal(i) for i in range(len(self.instance.targets))), ExitGoal()):
            self._get_field(self.make_problem(state, goal), self.get_maker(not isinstance(goal, ExitGoal)))

    # --- one search ----------------------------------------------------------------------

    def search(self, state: RoomState, goal: Goal, *, method: str = "auto", planner: str = DEFAULT_PLANNER,
               avoid: bool = True, refine: bool = True, keep_out: Sequence[Footprint] = (),
               budget_expansions: int = EXPANSIONS, clock: Clock | None = None, seed: int = 0, effort: int = 0
               ) -> SearchResult:
        """Find the fewest primitives from a state to a goal.

        Args:
            state: first state.
            goal: the goal; not a push.
            method: `fields`, `corridor` to search round the path of a path planner first, or `auto` to choose
                between the two by room and goal.
            planner: path planner for corridors, one of `list_planners()`.
            avoid: touch no other target on the way, and do not leave by an open exit, unless two resolutions
                show no other way; `also_pressed` lists the targets touched then.
            refine: search finer grids, too, before giving up.
            keep_out: footprints that the body must not meet on its way, such as blocks.
            budget_expansions: maximum number of expanded nodes; equal budgets give equal results on any machine.
            clock: time limit of the calling function, or None for the budget only.
            seed: of the path planner.
            effort: further searches for a shorter plan, at most `len(EFFORTS)`; -1 for the first plan found.

        Raises:
            UnknownNameError: no such method or path planner.
            GoalError: no such target.
            UnsupportedError: the goal is a push.
        """
        if method not in METHODS:
            raise UnknownNameError("search method", method, METHODS)
        clock = clock or Clock()
        if method == "auto":
            method = self.choose_method(goal, keep_out)
        result = SearchResult(PlanningReason.TIMEOUT, (), (state,), nearest=(state.x, state.y))
        try:
            for thorough in (False, True):
                problem = self.make_problem(state, goal, tuple(keep_out), clock, thorough)
                problem = problem._replace(seed=seed, effort=effort)
                result = self._check_trivial(problem) or self._search_variants(
                    problem, self._iterate_variants(problem, method, planner, avoid, refine), budget_expansions)
                if result.is_reached or problem.table is None or problem.table.complete_to == NEVER:
                    break  # otherwise the first table of an arm with many joints was incomplete
                clock.check()
        except OutOfTime:
            result = dataclasses.replace(result, status=clock.reason)
        return dataclasses.replace(result, timed_out=clock.has_stopped)

    def choose_method(self, goal: Goal, keep_out: Sequence[Footprint]) -> str:
        """Method by what a query costs: a function of room and goal, never of earlier queries.

        Targets and the exit are gone to again and again, so their fields pay on any floor. A place is asked for
        once; on a large floor its field, and the grid under it, take longer than a path and its corridor.
        """
        is_once = isinstance(goal, (PoseGoal, RegionGoal)) and not keep_out
        is_large = 4.0 * self.instance.reach_x * self.instance.reach_y > LARGE
        return "corridor" if is_once and is_large else "fields"

    def make_problem(self, state: RoomState, goal: Goal, keep_out: tuple[Footprint, ...] = (),
                     clock: Clock = NO_LIMIT, thorough: bool = False) -> SearchProblem:
        """Make the problem of a search; `thorough` tabulates every posture of an arm with many joints."""
        area = compute_goal_area(goal, self.instance)
        table = None
        if isinstance(goal, PressGoal) and self.instance.dynamics.press_with == "hand":
            limits = {"budget": UNLIMITED} if thorough else {}
            table = self.reacher.make_table(goal.target, state.joint_steps, joint_offsets=state.joint_offsets,
                                            heading_offset=state.heading_offset, **limits)
            area = Area(area.footprint, math.hypot(*table.costs.shape[:2]) * table.cell / 2)
        return SearchProblem(state, goal, area, find_headings(goal, state, self.kinematics), table, keep_out, clock)

    def _check_trivial(self, problem: SearchProblem) -> SearchResult | None:
        """Result of a problem that needs no search: start in a solid, goal reached already, or no posture at all."""
        state, goal = problem.state, problem.goal
        x, y, rotation = state.x, state.y, self.kinematics.get_rotation(state.heading_steps, state.heading_offset)
        if not any(self.get_collision(shut).does_fit(x, y, rotation, -_PENETRATION) for shut in (True, False)):
            return SearchResult(PlanningReason.START_INVALID, (), (state,), nearest=(x, y))
        if problem.table is not None and (problem.table.costs < 0).all():
            return SearchResult(PlanningReason.NO_POSTURE, (), (state,), nearest=(x, y))
        escapes = isinstance(goal, ExitGoal) and self.instance.puzzle.is_solved(state.puzzle)  # needs a primitive
        if not escapes and is_reached(goal, state, state, self.kinematics):
            return SearchResult("reached", (), (state,))
        return None

    # --- variants of the search ----------------------------------------------------------

    def _search_variants(self, problem: SearchProblem, variants: Iterator[_Variant], budget: int) -> SearchResult:
        """Search one variant after the other until one reaches the goal or the budget is spent."""
        spent, begin, offset = 0, (problem.state.x, problem.state.y), problem.state.heading_offset
        reason, has_sought_proof, nearest = PlanningReason.UNREACHABLE_AT_RESOLUTION, False, begin
        for maker, field, avoiding, method in variants:
            if problem.clock.is_up():
                reason = problem.clock.reason
                break
            is_hopeless = field is None or maker.get_cost(field, problem.state) < 0
            if not has_sought_proof and (is_hopeless or problem.table is not None):
                has_sought_proof, proof = True, self._find_proof(problem, maker)
                if proof is not None:
                    reason = proof
                    break
            if field is None or is_hopeless:
                continue
            run = SearchRun(problem, self.kinematics, maker, field, avoiding=avoiding,
                            motions=self.motions if offset == 0.0 else make_motions(self.kinematics, offset),
                            reacher=None if problem.table is None else self.reacher, frontiers=self.frontiers)
            limit = (budget - spent) // 2 if avoiding else budget - spent  # keep some for a search without avoiding
            ended, nodes = self._run_schedule(run, limit)
            spent += nodes
            if isinstance(ended, SearchResult):
                run.end()
                return dataclasses.replace(ended, method=method, expansions=spent)
            nearest = run.find_nearest()
            run.end()
            if problem.clock.has_stopped or (ended is PlanningReason.BUDGET_EXHAUSTED and not avoiding):
                reason = ended
                break
        return SearchResult(reason, (), (problem.state,), expansions=spent, nearest=nearest)

    def _find_proof(self, problem: SearchProblem, maker: FieldMaker) -> PlanningReason | None:
        """Return the reason why no way can lead to the goal, by the parts of the floor, or None without a proof.

        If joints or heading lie off their lattice, or noise or physics can move them off it, a hand can reach the goal
        from postures that are not tested. Then there is no proof.
        """
        x, y, collision = problem.state.x, problem.state.y, maker.collision
        if problem.table is None or problem.table.complete_to < NEVER:
            proof = collision.find_proof(x, y, *problem.area)
            is_solid = proof == "solid" and problem.table is None
            return PlanningReason.GOAL_INVALID if is_solid else proof and PlanningReason.UNREACHABLE_PROVEN
        here = int(collision.get_parts(np.array([[x, y]]))[0])
        is_apart = here > 0 and here not in self._find_parts(problem, maker)
        if not is_apart:
            return None
        dynamics, state = self.instance.dynamics, problem.state
        is_exact = dynamics.kind == "kinematic" and not (
            dynamics.noise or dynamics.slip or any(state.joint_offsets) or state.heading_offset)
        return PlanningReason.UNREACHABLE_PROVEN if is_exact else PlanningReason.UNREACHABLE_AT_RESOLUTION

    def _find_parts(self, problem: SearchProblem, maker: FieldMaker) -> frozenset[int]:
        """Return the parts of the floor where some posture reaches the target to be pressed by hand.

        They do not depend on the present posture, as long as its joints lie as far off their lattice.
        """
        assert isinstance(problem.goal, PressGoal) and problem.table is not None
        table, state, collision = problem.table, problem.state, maker.collision
        key = maker.door_shut, problem.goal.target, state.joint_offsets, state.heading_offset
        if key not in self._parts:
            if len(self._parts) >= MOST_PARTS:  # offsets from the lattice can have any value
                self._parts.clear()
            half = table.cell / 2 + _GRAIN
            places = table.get_centres()[(table.costs >= 0).any(axis=2)]
            away = compute_distance_many(places, collision.solids)
            places = places[away >= collision.inner - half * math.sqrt(2.0)]
            shifts = np.linspace(-half, half, 1 + math.ceil(2 * half / collision.resolution))
            corners = places[:, None] + np.stack(np.meshgrid(shifts, shifts), axis=-1).reshape(-1, 2)
            self._parts[key] = frozenset(np.unique(collision.get_parts(corners)).tolist())
        return self._parts[key]

    @cached_property
    def motions(self) -> a_star.Motions:
        """Motions at the headings of the lattice."""
        return make_motions(self.kinematics, 0.0)

    def _run_schedule(self, run: SearchRun, budget: int) -> tuple[SearchResult | PlanningReason, int]:
        """Search by the schedule until a plan is found, then once more for a shorter one."""
        spent, ended = 0, PlanningReason.BUDGET_EXHAUSTED
        for offset, weight, nodes in SCHEDULE:
            run.restart(offset=offset, weight=weight)
            ended = run.advance(min(nodes, budget - spent))
            spent += run.expansions
            if ended is not PlanningReason.BUDGET_EXHAUSTED:
                break
        if not isinstance(ended, SearchResult) or run.problem.effort < 0:
            return ended, spent
        is_quick, is_short = spent < SCHEDULE[0][2] and run.problem.table is None, len(ended.primitives) <= SHORT
        rounds = [(1, IMPROVEMENT), *([(SHORT, IMPROVEMENT)] if is_short else [])] if is_quick else []
        for offset, nodes in (*rounds, *((offset, budget) for offset in EFFORTS[: run.problem.effort])):
            run.restart(offset=offset, most=len(ended.primitives))
            better = run.advance(min(nodes, budget - spent))
            spent += run.expansions
            ended = better if isinstance(better, SearchResult) else ended
        return ended, spent

    def _iterate_variants(self, problem: SearchProblem, method: str, planner: str, avoid: bool, refine: bool
                       ) -> Iterator[_Variant]:
        is_open = self.instance.puzzle.is_solved(problem.state.puzzle)
        others = self._pressed - {getattr(problem.goal, "target", -1)}
        avoid = avoid and bool(others or (is_open and not isinstance(problem.goal, ExitGoal)))
        door_shut, state = not is_open, problem.state
        pose = state.x, state.y, self.kinematics.get_rotation(state.heading_steps, state.heading_offset)
        if door_shut and not self.get_collision(True).does_fit(*pose):  # the door lets a body in it out
            door_shut = not self.get_collision(False).does_fit(*pose)
        if method == "corridor":
            for maker in self._iterate_corridors(problem, door_shut, planner):
                yield _Variant(maker, self._make_field(problem, maker, None), avoid, planner)
        is_cut_off = False  # on the grid before: then a finer one is explored before its field is made
        for refinement, avoiding in ((0, True), (1, True), (0, False), (1, False), (2, False), (3, False)):
            states = self.get_maker(door_shut, 0, problem.clock).states * 4**refinement
            is_coarse = refinement == 0 or (refine and states <= MOST_REFINED_STATES)
            if (avoid or not avoiding) and is_coarse:
                maker = self.get_maker(door_shut, refinement, problem.clock)
                field = self._find_field(problem, maker, is_cut_off and refinement > 0)
                is_cut_off = field is None or maker.get_cost(field, state) < 0
                yield _Variant(maker, field, avoiding, "fields")

    def _iterate_corridors(self, problem: SearchProblem, door_shut: bool, planner: str) -> Iterator[FieldMaker]:
        """Grids of corridors round the path of a path planner, from narrow to wide."""
        goal = problem.goal
        if problem.table is not None:
            maker = self.get_maker(door_shut, 0, problem.clock)
            states, costs = self.find_postures(problem, maker)
            goal = maker.points[states[np.argsort(costs, kind="stable")[:64]] // maker.headings]
        found = self.navigator.plan((problem.state.x, problem.state.y), goal, planner, door_shut=door_shut,
                                    seed=problem.seed, clock=problem.clock,
                                    heading=self.kinematics.get_heading(problem.state))
        if found.status == "exact":
            for width in CORRIDORS:
                yield FieldMaker(self.instance, self.kinematics, door_shut=door_shut, path=found.path, width=width,
                                 collision=self.get_collision(door_shut), clock=problem.clock)

    # --- fields --------------------------------------------------------------------------

    def _find_field(self, problem: SearchProblem, maker: FieldMaker, explore: bool) -> Field | None:
        """Return the field of a problem's goal, or a field of its own round the footprints to keep out of.

        None where exploring the grid first shows that it would be -1 at the start.
        """
        allowed = None
        if problem.keep_out:
            away = compute_distance_many(maker.points, stack_footprints(problem.keep_out))
            allowed = away > maker.collision.radius - maker.size
        is_kept = allowed is None and maker.has_field(self._make_key(problem))
        if is_kept or not explore:
            return self._get_field(problem, maker) if allowed is None else self._make_field(problem, maker, allowed)
        seeds = self._find_seeds(problem, maker)
        if maker.is_cut_off(problem.state, seeds, allowed, problem.clock):
            return None
        return (maker.get_field(self._make_key(problem), lambda _: seeds, problem.clock) if allowed is None else
                maker.make_field(seeds, allowed, problem.clock))

    def _get_field(self, problem: SearchProblem, maker: FieldMaker) -> Field:
        return maker.get_field(self._make_key(problem), partial(self._find_seeds, problem), problem.clock)

    def _make_key(self, problem: SearchProblem) -> Hashable:
        """Return the key of a problem's field: everything about the problem, except what to keep out of."""
        state = problem.state
        posture = None
        if problem.table is not None:
            posture = state.joint_steps, state.joint_offsets, state.heading_offset, problem.table.complete_to
        return problem.goal, posture, None if problem.facing is None else problem.facing.tobytes()

    def _make_field(self, problem: SearchProblem, maker: FieldMaker, allowed: NDArray[np.bool_] | None) -> Field:
        return maker.make_field(self._find_seeds(problem, maker), allowed, problem.clock)

    def _find_seeds(self, problem: SearchProblem, maker: FieldMaker) -> Seeds:
        if problem.table is None:
            return maker.find_seeds(*problem.area, problem.facing, get_presser(problem.goal, self.instance))
        return Seeds(*self.find_postures(problem, maker), maker.headings)

    def find_postures(self, problem: SearchProblem, maker: FieldMaker) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the states (cell * headings + heading) where the arm completes the press, and its joint steps."""
        assert problem.table is not None
        table, far = problem.table, np.iinfo(np.int16).max
        costs = np.where(table.costs < 0, far, table.costs)
        near = np.flatnonzero(maker.standing & (compute_distance_many(
            maker.points, stack_footprints([problem.area.footprint])) <= problem.area.reach))
        least = np.full((len(near), costs.shape[2]), far, dtype=np.int16)
        for i, j in itertools.product((-0.5, 0.0, 0.5), repeat=2):
            shift = (i * maker.size, j * maker.size)
            at = np.floor((maker.points[near] + shift - table.low) / table.cell).astype(int)
            inside = ((at >= 0) & (at < costs.shape[:2])).all(axis=1)
            columns, rows = at[inside].T
            least[inside] = np.minimum(least[inside], costs[columns, rows])
        which, heading = np.nonzero((least < far) & maker.get_fits(near, costs.shape[2]))
        return near[which] * maker.headings + heading, least[which, heading].astype(np.int64)


def _get_floor(instance: RoomInstance) -> tuple:
    """Return everything except solids that the grids of a room depend on."""
    robot = instance.robot
    return (instance.reach_x, instance.reach_y, instance.door, robot.outer_radius, robot.body_height, robot.actions,
            robot.turn_step_deg, instance.dynamics.press_margin, instance.dynamics.press_with)
