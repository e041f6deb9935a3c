"""Joint steps that bring the hand to a target from a given place of the base.

Inverse kinematics rounded to whole joint steps misses many targets, so configurations are found on the joint lattice
itself (`joint_lattice.py`), and each is checked with the environment's own `touching` rule. A `ReachTable` gives the
fewest joint steps for every place of the base at once, for a search that moves base and arm together; driving is not
planned here. A `Reacher` may be pickled, but not shared between threads.
"""

from __future__ import annotations

import dataclasses
import heapq
import math
from collections.abc import Callable, Iterator, Sequence
from functools import cache, cached_property, lru_cache
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.geometry import compute_distance_many
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.errors import PlanningFailed, UnsupportedError
from hrl_escape.floor.clearance import CollisionMap
from hrl_escape.planning.arm.joint_lattice import (
    NEVER,
    UNLIMITED,
    ArmLattice,
    Halves,
    bound_costs,
    find_heights,
    find_touching,
    make_halves,
    make_lattice,
    map_hands,
    measure_gap,
)
from hrl_escape.planning.arm.model import ArmCollisions, ArmKinematics
from hrl_escape.search import find_cheapest_steps

if TYPE_CHECKING:
    from hrl_escape.planning.arm.arm_planner import ArmPlanner

QUICK = 5_000_000
"""Default budget of a table, pairs of half configurations: all of them up to six joints."""

HAND_CELL = 0.02
"""Side of the cells of hand positions in a table, m."""
BASE_CELL = 0.05
"""Side of a table's cells, m."""
POSTURE_CELL = 0.1
"""Side of the cells in which one posture is listed, m."""

_MOST_HALVES = 60_000
_CANDIDATES = 64  # configurations with equally many joint steps tested for collisions
_SKIN = 1e-9  # rounding margin of a touch, m
_PUSH = 0.01  # depth of a touch that presses by force, m
PATH_TESTS = 20_000
"""Most configurations tested for one path."""
TUBES = (1.0, 2.0)
"""Half widths of the tubes that are tried, in joint steps."""
TESTED_SHARES = (0.25, 0.5, 0.75, 1.0)
"""Fractions of a joint step at which the arm is tested for collisions."""
Posture: TypeAlias = tuple[int, ...]
"""Joint steps from home."""


@dataclasses.dataclass(frozen=True, eq=False)
class ReachTable:
    """Fewest joint steps that bring the hand to a target, by where the base stands: a lower bound.

    A cell's cost is that of the best place in it: `get_configuration` finds nothing cheaper at any place
    in the cell, and nothing where the cost is -1 (as far as `complete_to`).
    """

    target: int  # index of the target
    joint_steps: tuple[int, ...]  # the configuration from which steps are counted
    costs: NDArray[np.int16]  # shape (columns, rows, headings), int16, columns along x; -1 where out of reach
    low: NDArray[np.float64]  # corner of the grid in the room frame, shape (2,), m
    cell: float  # side of its square cells, m
    complete_to: int
    """Cost up to which the table is complete; `NEVER` if the whole lattice was searched. Otherwise costlier
    configurations may be missing, and a larger budget may find more."""

    def get_cost(self, x: float, y: float, heading_steps: int) -> int:
        """Cost of the cell that holds a place; -1 outside the grid."""
        i, j = math.floor((x - self.low[0]) / self.cell), math.floor((y - self.low[1]) / self.cell)
        inside = 0 <= i < self.costs.shape[0] and 0 <= j < self.costs.shape[1]
        return int(self.costs[i, j, heading_steps]) if inside else -1

    def get_centres(self) -> NDArray[np.float64]:
        """Centres of the cells in the room frame, shape (columns, rows, 2), m."""
        return self.low + (np.moveaxis(np.indices(self.costs.shape[:2]), 0, -1) + 0.5) * self.cell


class _Ordered(NamedTuple):
    lattice: ArmLattice
    first_steps: NDArray[np.int64]  # (first halves, joints), in the lattice's order
    last_steps: NDArray[np.int64]
    complete_to: int


class Reacher:
    """Arm of one room's robot, with the configurations that press its targets by hand.

    Attributes:
        kinematics: exact ones, without noise and slip.
        collide: whether configurations must be clear of walls, obstacles and the robot itself: under physics only, as
            kinematic arms pass through everything.
        limit: largest distance from the hand's centre to a target that counts, m: a touch, or, where a press
            takes force, a push into the target.
    """

    def __init__(self, instance: RoomInstance) -> None:
        """Store the room. Raises `UnsupportedError` where targets are pressed with the body."""
        if instance.dynamics.press_with != "hand":
            raise UnsupportedError("targets of this room are pressed with the body, so no arm has to reach them: "
                                   "a Reacher is for dynamics.press_with = 'hand'")
        self.instance = instance
        self.collide = instance.dynamics.kind == "physics"
        self.kinematics = Kinematics(instance, is_still=True)
        hand = instance.robot.hand_radius
        self.limit = (max(hand - _PUSH, hand / 2) if self.collide else hand + instance.dynamics.press_margin) - _SKIN
        self._boxes = np.array([
            (t.x, t.y, t.z, t.footprint.cos, t.footprint.sin, t.half_x, t.half_y, t.half_z) for t in instance.targets
        ]).reshape(-1, 8)
        kept = 64 if instance.robot.joints <= 4 else 8  # redundant arms take megabytes for each configuration
        self._get_halves = lru_cache(2)(self._make_halves)
        self._get_ordered = lru_cache(kept)(self._make_ordered)
        self._get_hands = lru_cache(kept)(self._map_hands)
        self._get_costs = lru_cache(kept)(self._compute_costs)

    def __reduce__(self) -> tuple:
        return type(self), (self.instance,)

    @cached_property
    def arm(self) -> ArmKinematics:
        """Kinematics of the arm."""
        return ArmKinematics(self.kinematics.robot)

    @cached_property
    def planner(self) -> ArmPlanner:
        """Planner of the arm's paths round solids."""
        from hrl_escape.planning.arm.arm_planner import ArmPlanner  # loads OMPL and scipy, which few presses need

        return ArmPlanner(self.instance)

    # --- the lattice -------------------------------------------------------------------

    def _make_halves(self, joint_offsets: tuple[float, ...], around: tuple[int, ...]) -> Halves:
        tables, hand = self.arm.compute_placements(joint_offsets)
        return make_halves(tables, hand, self.arm.get_ranges(joint_offsets)[0], around, _MOST_HALVES)

    def _make_ordered(self, joint_steps: tuple[int, ...], joint_offsets: tuple[float, ...]) -> _Ordered:
        halves = self._get_halves(joint_offsets, (0,) * len(joint_steps))
        if halves.complete_to != NEVER:
            halves = self._make_halves(joint_offsets, joint_steps)
        lattice, firsts, lasts = make_lattice(halves, joint_steps)
        return _Ordered(lattice, halves.first_steps[firsts], halves.last_steps[lasts], halves.complete_to)

    def _map_hands(self, z: float, half_z: float, joint_steps: tuple[int, ...], joint_offsets: tuple[float, ...],
                   budget: int) -> tuple[NDArray[np.int16], int]:
        ordered = self._get_ordered(joint_steps, joint_offsets)
        hands, _, gone_to = self._map_lattice(ordered.lattice, z, half_z, HAND_CELL, budget)
        return hands, min(gone_to, ordered.complete_to)

    def _map_lattice(self, lattice: ArmLattice, z: float, half_z: float, cell: float, budget: int
                     ) -> tuple[NDArray[np.int16], NDArray[np.int32], int]:
        """`map_hands` at the heights of a target; with no limit where the budget leads to none of them."""
        low, high = z - half_z - self.limit, z + half_z + self.limit
        half_cells = math.ceil(_bound_reach(lattice) / cell) + 1
        found = map_hands(lattice, low, high, cell, half_cells, budget)
        if found[2] != NEVER and (found[0] == NEVER).all():
            found = map_hands(lattice, low, high, cell, half_cells, UNLIMITED)
        return found

    def _compute_costs(self, z: float, sizes: tuple[float, float, float], yaw: float, joint_steps: tuple[int, ...],
                       joint_offsets: tuple[float, ...], heading_offset: float, budget: int
                       ) -> tuple[NDArray[np.int16], int]:
        """Costs of a table; targets of the same height, shape and direction share them."""
        hands, complete_to = self._get_hands(z, sizes[2], joint_steps, joint_offsets, budget)
        headings = np.arange(self.kinematics.headings, dtype=np.float64) * self.kinematics.turn_step + heading_offset
        return bound_costs(hands, HAND_CELL, headings, yaw, sizes[0] + self.limit, sizes[1] + self.limit,
                           BASE_CELL), complete_to

    def make_table(self, target: int, joint_steps: tuple[int, ...], *, joint_offsets: tuple[float, ...] = (),
                   heading_offset: float = 0.0, budget: int = QUICK) -> ReachTable:
        """Tabulate the fewest joint steps to touch a target, for every place and heading of the base.

        Args:
            target: index of the target.
            joint_steps: present configuration of the arm.
            joint_offsets: offsets of its joints from the lattice, rad; empty for none.
            heading_offset: offset of the base's heading from its lattice, rad.
            budget: pairs of half configurations to examine, exceeded only while none reaches the target's
                height; `UNLIMITED` takes up to seconds with seven joints.
        """
        t = self.instance.targets[target]
        costs, complete_to = self._get_costs(t.z, (t.half_x, t.half_y, t.half_z), t.yaw, joint_steps, joint_offsets,
                                             heading_offset, budget)
        low = np.array([t.x, t.y]) - np.array(costs.shape[:2]) // 2 * BASE_CELL
        return ReachTable(target, joint_steps, costs, low, BASE_CELL, complete_to)

    def list_postures(self, target: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """List postures at the height of a target, the cheapest from home first; one for each place of the hand.

        One in each cell of 0.1 m is enough, as cells are smaller than the reach of a touch.

        Args:
            target: index of the target.

        Returns:
            Joint steps from home (postures, joints), and positions of the hand in the base frame (postures, 3), m.
            Empty where the hand never gets to that height.
        """
        goal, joints = self.instance.targets[target], self.instance.robot.joints
        lattice, first_steps, last_steps, _ = self._get_ordered((0,) * joints, ())
        costs, halves, _ = self._map_lattice(lattice, goal.z, goal.half_z, POSTURE_CELL, QUICK)
        cells = np.argwhere(costs < NEVER)
        cells = cells[np.argsort(costs[cells[:, 0], cells[:, 1]], kind="stable")]
        i, j = halves[cells[:, 0], cells[:, 1]].T
        steps = np.concatenate([first_steps[i], last_steps[j]], axis=1)
        steps = np.pad(steps, ((0, 0), (0, joints - steps.shape[1])))  # last joints may never move the hand
        rows = lattice.first[i].reshape(-1, 3, 4)
        return steps, np.einsum("nij,nj->ni", rows[:, :, :3], lattice.last[j]) + rows[:, :, 3]

    def explain_unreachable(self, target: int, floor: CollisionMap) -> str:
        """Say whether a target is too high, too low or too far for the hand; empty if neither is certain.

        Args:
            target: index of the target.
            floor: the room's clearances, the exit door open.
        """
        goal, home, room = self.instance.targets[target], (0,) * self.instance.robot.joints, self.instance
        lattice = self._get_ordered(home, ()).lattice
        lowest, highest = find_heights(lattice)
        low, high = goal.z - goal.half_z, goal.z + goal.half_z
        if low - self.limit > highest:
            return f"too high: {goal.name} hangs from {low:.2f} m up, the hand gets to {highest:.2f} m"
        if high + self.limit < lowest:
            return f"too low: {goal.name} hangs up to {high:.2f} m, the hand gets to {lowest:.2f} m"
        table = self.make_table(target, home, budget=UNLIMITED)
        places, slack = table.get_centres()[(table.costs >= 0).any(axis=2)], table.cell * math.sqrt(0.5) + 1e-6
        on_floor = (np.abs(places) <= np.array([room.reach_x, room.reach_y]) + slack).all(axis=1)
        fits = compute_distance_many(places, floor.solids) >= floor.inner - slack
        if table.complete_to < NEVER or (on_floor & fits).any():
            return ""
        return (f"too far: the body fits nowhere within reach of {goal.name}, the hand reaches out "
                f"{_bound_reach(lattice):.2f} m")

    # --- one configuration -------------------------------------------------------------

    def get_configuration(self, x: float, y: float, heading_steps: int, joint_steps: tuple[int, ...], target: int, *,
                          joint_offsets: tuple[float, ...] = (), heading_offset: float = 0.0
                          ) -> tuple[int, ...] | None:
        """Find the configuration with the fewest joint steps that touches a target from an exact place.

        Configurations that touch no other target come first.

        Args:
            x: the base's axis, m.
            y: the base's axis, m.
            heading_steps: the base's heading.
            joint_steps: present configuration of the arm.
            target: index of the target.
            joint_offsets: offsets of its joints from the lattice, rad; empty for none.
            heading_offset: offset of the base's heading from its lattice, rad.

        Returns:
            Joint steps from home, as in `RoomState.joint_steps`; None where the hand cannot touch the target.
        """
        ordered = self._get_ordered(joint_steps, joint_offsets)
        pose = (x, y, *self.kinematics.get_rotation(heading_steps, heading_offset))
        here = RoomState(x, y, heading_steps, heading_offset, joint_steps, joint_offsets, None, 0, 0, 0)
        for avoid in (True, False) if len(self._boxes) > 1 else (False,):
            least = 0
            while least < NEVER:
                found, least = find_touching(ordered.lattice, pose, self._boxes, target, self.limit, avoid, least,
                                             _CANDIDATES if self.collide else 1)
                for i, j in found.tolist():
                    steps = (*ordered.first_steps[i].tolist(), *ordered.last_steps[j].tolist())
                    steps += joint_steps[len(steps) :]
                    if self._is_good(here, steps, target):
                        return steps
                least += 1
        return None

    def _is_good(self, here: RoomState, joint_steps: tuple[int, ...], target: int) -> bool:
        there = here._replace(joint_steps=joint_steps)
        touching = self.kinematics.compute_touching(*there.pose)
        return bool(touching >> target & 1) and not (self.collide and self.collides(there))

    # --- joint steps in order ----------------------------------------------------------

    def order_steps(self, state: RoomState, moves: Sequence[int], joint_steps: tuple[int, ...], target: int,
                    avoiding: bool = True) -> tuple[int, ...] | None:
        """Interleave joint steps with given moves of the base so that no other target is pressed on the way.

        Args:
            state: first state.
            moves: primitives of the base, kept in their order.
            joint_steps: last configuration.
            target: index of the target to touch; the primitives end with the touch.
            avoiding: other targets may not be pressed on the way.

        Returns:
            Primitives, verified by the room's kinematics: as many as moves and joint steps if possible, else
            with the fewest more that take the arm round; None if no order was found.
        """
        orders = (self._search_order(state, moves, joint_steps, target, detours, avoiding) for detours in (False, True))
        return next((order for order in orders if order is not None), None)

    def _search_order(self, begin: RoomState, moves: Sequence[int], joint_steps: tuple[int, ...], target: int,
                      detours: bool, avoiding: bool) -> tuple[int, ...] | None:
        """A* over (moves made, joint steps); a primitive is simulated when it is taken from the queue, moves first."""
        others, table = ~(1 << target) if avoiding else 0, self.kinematics.actions
        known: set[tuple[int, tuple[int, ...]]] = set()
        queue: list[tuple] = [(0, 0, 0, begin, None, 0, (), False, self.collide and self.collides(begin))]
        queued, tried = 0, 0
        most = 250 if self.collide else 1_000  # states to try: a test for collisions takes long
        while queue and tried <= most:
            _, _, _, state, action, made, actions, is_pressed, is_stuck = heapq.heappop(queue)
            if action is not None:
                before, state = state, self.kinematics.step(state, action).state
                tried += 1
                begun = state.touching & ~before.touching
                at_limit = action not in table.base and state.joint_steps == before.joint_steps
                collides = self.collide and self.collides(state)
                if at_limit or begun & others or (collides and not is_stuck):
                    continue
                is_stuck = collides  # an arm pushed into something may need several steps to come out
                made, actions, is_pressed = made + (action in table.base), (*actions, action), bool(is_pressed or begun)
            wanted = [b - a for a, b in zip(state.joint_steps, joint_steps, strict=True)]
            left = len(moves) - made + sum(map(abs, wanted))
            if is_pressed and (left == 0 or not self.collide):  # pushing by force goes on to the end
                return actions
            if (made, state.joint_steps) in known:
                continue
            known.add((made, state.joint_steps))
            choices = [(moves[made], -1)] if made < len(moves) else []
            for joint, steps in enumerate(wanted):
                pair = table.joints[joint]
                for action, nearer in ((pair.increment, steps > 0), (pair.decrement, steps < 0)):
                    if nearer or detours:
                        choices.append((action, -1 if nearer else 1))
            for choice, change in choices:
                queued += 1
                estimate = len(actions) + 1 + left + change
                heapq.heappush(queue, (estimate, -len(actions), queued, state, choice, made, actions, is_pressed,
                                       is_stuck))
        return None

    def is_push(self, state: RoomState, moves: Sequence[int], target: int) -> bool:
        """Return whether moves of the base alone press a target by force, the arm clear of walls and obstacles.

        Args:
            state: first state; an arm in collision there may take several moves to come out.
            moves: primitives, the last of which ends with the hand at the target.
            target: index of the target.
        """
        end = self.move_base(state, moves)
        if end is None:
            return False
        pose = (end.x, end.y, *self.kinematics.get_rotation(end.heading_steps, end.heading_offset))
        hand = self.kinematics.get_hand_in_base(end.joint_steps, end.joint_offsets)
        return measure_gap(pose, hand, self._boxes[target]) <= self.limit

    def move_base(self, state: RoomState, moves: Sequence[int], others: int = 0) -> RoomState | None:
        """State after moves of the base, the arm at rest; None where the arm meets a solid or begins to touch `others`.

        Args:
            state: first state; an arm in collision there may take several moves to come out.
            moves: primitives of the base.
            others: bits of targets that may not be pressed on the way.
        """
        is_stuck = self.collides(state)
        for move in moves:
            before, state = state, self.kinematics.step(state, move).state
            collides = self.collides(state)
            if state.touching & ~before.touching & others or (collides and not is_stuck):
                return None
            is_stuck = collides
        return state

    # --- joint steps round solids ------------------------------------------------------

    def plan_steps(self, state: RoomState, joint_steps: Posture, others: int = 0) -> tuple[int, ...] | None:
        """Plan joint steps round solids, along a path through the space of joint angles, the base at rest.

        The fewest joint steps may lead through solids where a path of joint angles leads round them. Rounding the path
        to whole steps may touch what it clears, so the lattice is searched near it, and every step is tested in
        between as well.

        Args:
            state: base and arm at the beginning.
            joint_steps: last posture, from home.
            others: bits of targets that may not be pressed on the way.

        Returns:
            Primitives; None where no path is found, or no joint steps along it.
        """
        rules, robot, heading = self.kinematics, self.kinematics.robot, self.kinematics.get_heading(state)
        home = np.array(robot.compute_angles((0,) * len(joint_steps), state.joint_offsets))
        goal = home + robot.step * np.array(joint_steps)
        try:
            path = self.planner.plan(state, goal, budget=PATH_TESTS).interpolate(robot.step / 4)
        except PlanningFailed:
            return None

        @cache
        def get_touching(posture: Posture) -> int:
            return rules.compute_touching(*state._replace(joint_steps=posture).pose)

        @cache
        def can_step(a: Posture, b: Posture) -> bool:
            if any(not low <= n <= high for low, n, high in zip(robot.step_low, b, robot.step_high, strict=True)):
                return False
            if get_touching(b) & ~get_touching(a) & others:
                return False
            places = (home + robot.step * (np.array(a) + share * np.subtract(b, a)) for share in TESTED_SHARES)
            return all(self.is_collision_free(state.x, state.y, heading, place.tolist()) for place in places)

        steps = follow_path((path - home) / robot.step, state.joint_steps, joint_steps, can_step)
        if steps is None:
            return None
        pairs, changes = rules.actions.joints, np.diff([state.joint_steps, *steps], axis=0)
        return tuple(pairs[joint].increment if change[joint] > 0 else pairs[joint].decrement
                     for change in changes.tolist() for joint in range(len(change)) if change[joint])

    # --- collisions --------------------------------------------------------------------

    @cached_property
    def _collisions(self) -> ArmCollisions:
        return ArmCollisions(self.kinematics.robot, self.instance.robot.hand_radius, self.instance.all_solids)

    def collides(self, state: RoomState) -> bool:
        """Return whether the arm meets a wall, an obstacle, the shut exit door or the robot itself."""
        heading = self.kinematics.get_heading(state)
        return not self.is_collision_free(state.x, state.y, heading, self.kinematics.get_angles(state))

    def is_collision_free(self, x: float, y: float, heading: float, joints: Sequence[float]) -> bool:
        """Return whether the arm is clear of walls, obstacles, the shut exit door and the robot itself.

        Targets do not count: they are meant to be touched.

        Args:
            x: the base's axis, m.
            y: the base's axis, m.
            heading: rad.
            joints: joint angles, rad.
        """
        return self._collisions.is_free(x, y, heading, joints)


def _bound_reach(lattice: ArmLattice) -> float:
    return float(np.hypot(lattice.first[:, 3], lattice.first[:, 7]).max()) + lattice.longest


def follow_path(path: NDArray[np.float64], begin: Posture, end: Posture, can_step: Callable[[Posture, Posture], bool]
                ) -> tuple[Posture, ...] | None:
    """Find the fewest joint steps from one posture to another near a path.

    Args:
        path: places along it, at most a fraction of a step apart, shape (n, joints), in joint steps from home.
        begin: first posture, in joint steps from home.
        end: last posture.
        can_step: (posture, a neighbouring one) -> the arm may go from one to the other.

    Returns:
        Postures after each step; None where no tube holds a way.
    """
    found = (_search_tube(path, begin, end, can_step, wide) for wide in TUBES)
    return next((postures for postures in found if postures is not None), None)


def _search_tube(path: NDArray[np.float64], begin: Posture, end: Posture, can_step: Callable[[Posture, Posture], bool],
                 wide: float) -> tuple[Posture, ...] | None:
    def list_steps(here: Posture) -> Iterator[tuple[Posture, int, Posture]]:
        for there in _list_neighbours(here):
            is_near = there == end or float(np.abs(path - there).max(axis=1).min()) <= wide
            if is_near and can_step(here, there):
                yield there, 1, there

    return find_cheapest_steps(begin, end.__eq__, list_steps,
                               lambda posture: sum(abs(i - j) for i, j in zip(posture, end, strict=True)))


def _list_neighbours(posture: Posture) -> Iterator[Posture]:
    for joint in range(len(posture)):
        for change in (-1, 1):
            yield (*posture[:joint], posture[joint] + change, *posture[joint + 1 :])
