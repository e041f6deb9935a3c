"""`ArmPlanner`: inverse kinematics and collision-free motion of one room's robot, in joint angles.

Pinocchio gives kinematics and Jacobians, coal detects collisions, OMPL finds the way. Nothing here is tied to whole
joint steps: `RoomPlanner` plans primitives, and such paths are followed only by options.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hrl_escape.clock import Clock, OutOfTime
from hrl_escape.env.floor_grid import FloorGrid
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState, check_fields
from hrl_escape.env.robot import BASE_LINK
from hrl_escape.errors import ConfigError, PlanningFailed, PlanningReason, UnknownNameError, UnsupportedError
from hrl_escape.figures import make_svg, save_figure
from hrl_escape.floor.clearance import CollisionMap
from hrl_escape.kernels import read_clock
from hrl_escape.planning.arm.model import ArmCollisions, ArmKinematics, Key
from hrl_escape.planning.arm.motion_test import BaseTest, MotionTest, split_coordinates
from hrl_escape.planning.arm.srdf import read_srdf
from hrl_escape.planning.paths.planners import OMPL_PLANNERS, find_joint_path
from hrl_escape.planning.paths.problem import CheckerBudget, MotionPath, Spent

CLEARANCE, OWN_CLEARANCE = 0.02, 0.001
"""Distances that a path keeps, m: of the robot from solids and the floor, and of its links from each other.

Where a link is nearer to a solid at start or goal, it keeps nine tenths of that distance from it; the base keeps the
first of `BASE_CLEARANCES` that start and goal allow. Less than `OWN_CLEARANCE` at start or goal is refused.
"""
BASE_CLEARANCES = (0.02, 0.005, 0.001)  # m
DISTINCT = 0.05
"""Postures nearer to each other than this in every joint are one, rad."""
_CORNER_CLEARANCES = (0.02, 0.01, 0.005, 0.002)  # m, tried for a path with corners
CONFIGURATIONS = 200_000
"""Configurations whose hand positions enter a reach map: points of a Halton sequence between the joint limits."""


@dataclasses.dataclass(frozen=True, eq=False)
class ArmPosture:
    """Configuration of the arm that brings the hand to a target."""

    angles: NDArray[np.float64]  # joint angles, shape (joints,), rad
    margin: float  # least distance of a joint from its limits, rad; at most pi, as continuous joints have none
    manipulability: float
    """Yoshikawa's measure, sqrt(det(J J^T)), of the hand's translation, and of its rotation too if the target was a
    pose (Yoshikawa 1985); of J^T J for arms with fewer joints than rows."""
    is_free: bool  # no link meets a solid, the shut door or another link


class ArmPlanner:
    """Arm of one room's robot. Not thread-safe.

    Attributes:
        instance: the room; its exit door counts as shut.
        kinematics: the arm's, from Pinocchio.
        postures: joint angles of the SRDF's group states by name, rad; `group/name` where groups share a name.
    """

    def __init__(self, instance: RoomInstance, srdf: str | Path | None = None) -> None:
        """Store the room; models are loaded on first use.

        Args:
            instance: the room.
            srdf: MoveIt's description of the arm, its text or path: pairs of links that may touch, and named postures.
                None lets those pairs touch that do with all joints at home.

        Raises:
            UnsupportedError: the robot has no arm.
            ConfigError: the SRDF is none.
        """
        if instance.robot.joints == 0:
            raise UnsupportedError("this room's robot has no arm: an ArmPlanner is for robot.joints of at least 1")
        self.instance = instance
        self.rules = Kinematics(instance, is_still=True)
        self._collisions: dict[float, ArmCollisions] = {}
        self._srdf: str | None = None
        self.postures: dict[str, tuple[float, ...]] = {}
        if srdf is not None:
            self._srdf, self.postures = read_srdf(srdf, self.rules.robot)

    @cached_property
    def kinematics(self) -> ArmKinematics:
        """Kinematics of the arm."""
        return ArmKinematics(self.rules.robot)

    @cached_property
    def _floor(self) -> CollisionMap:
        return CollisionMap(self.instance, door_shut=True)

    @cached_property
    def _limits(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        low, high = np.array(self.rules.robot.limits).T
        return low, high

    @cached_property
    def _touching(self) -> ArmCollisions:
        return ArmCollisions(self.rules.robot, self.instance.robot.hand_radius, self.instance.all_solids,
                             srdf=self._srdf)

    def _get_collisions(self, margin: float) -> ArmCollisions:
        if margin not in self._collisions:
            self._collisions[margin] = self._touching.with_margins(margin, {})
        return self._collisions[margin]

    def is_free(self, state: RoomState, angles: Sequence[float], margin: float = 0.0) -> bool:
        """Return whether the arm is clear of solids, the shut door and the robot itself.

        Args:
            state: says where the base stands.
            angles: joint angles, rad.
            margin: distance that counts as a collision already, m.
        """
        return self._get_collisions(margin).is_free(state.x, state.y, self.rules.get_heading(state), angles)

    def to_srdf(self) -> str:
        """Describe the arm as MoveIt reads it, beside the URDF that `instance.robot` stands for.

        The group `arm` goes from the base to the hand's link, which is the end effector `hand`. Named states are
        `postures`, and `home` where none has that name; pairs of links that may touch are those that are not tested
        here. `ArmPlanner(instance, srdf=...)` reads it back.
        """
        robot = self.rules.robot
        urdf = ElementTree.fromstring(robot.urdf)
        ends = [{end.tag: end.get("link", "") for end in joint} for joint in urdf.findall("joint")]
        before = {each["child"]: each["parent"] for each in ends}
        root = ElementTree.Element("robot", name=urdf.get("name", "robot"))
        ElementTree.SubElement(ElementTree.SubElement(root, "group", name="arm"), "chain",
                               base_link=BASE_LINK, tip_link=robot.hand_link)
        ElementTree.SubElement(ElementTree.SubElement(root, "group", name="hand"), "link", name=robot.hand_link)
        ElementTree.SubElement(root, "end_effector", name="hand", parent_link=before[robot.hand_link], group="hand")
        for name, angles in ({"home": robot.home} | self.postures).items():
            state = ElementTree.SubElement(root, "group_state", name=name, group="arm")
            for joint, angle in zip(robot.joint_names, angles, strict=True):
                ElementTree.SubElement(state, "joint", name=joint, value=repr(float(angle)))
        for first, second, reason in self._get_collisions(0.0).list_allowed():
            ElementTree.SubElement(root, "disable_collisions", link1=first, link2=second, reason=reason)
        ElementTree.indent(root)
        return ElementTree.tostring(root, encoding="unicode") + "\n"

    # --- inverse kinematics --------------------------------------------------------------

    def solve_ik(self, target: ArrayLike, state: RoomState, *, seeds: int = 64, tolerance: float = 1e-4,
                 only_free: bool = True) -> list[ArmPosture]:
        """Find the postures that bring the hand to a target, those farthest from joint limits first.

        Levenberg-Marquardt searches begin at the arm's present posture and at points of a Halton sequence between the
        joint limits; postures that coincide count once. An arm with as many joints as the target has coordinates has
        finitely many, which enough seeds find; one with more has infinitely many, of which these are a sample.

        Args:
            target: in the room frame: position of the hand (3,), m, or placement of its link (4, 4).
            state: where the base stands.
            seeds: searches.
            tolerance: largest distance from the target, m; for a pose also the largest rotation from it, rad.
            only_free: leave out postures in collision.

        Raises:
            StateError: no such state in this room.
            ConfigError: the target is neither a position nor a pose.
        """
        check_fields(self.rules, state)
        goal = self._read_target(target, state)
        low, high = self._limits
        here = np.clip(self.rules.get_angles(state), low, high)
        starts = np.concatenate([here[None], low + (high - low) * _make_halton(max(0, seeds - 1), len(low))])
        found: list[NDArray[np.float64]] = []
        for seed in starts.tolist():
            angles = self.kinematics.solve_ik(goal, seed, tolerance)
            if angles is not None and all(np.abs(self._subtract(angles, other)).max() > DISTINCT for other in found):
                found.append(angles)
        rows = 3 if goal.shape == (3,) else 6
        limited = ~np.array(self.rules.robot.continuous)
        postures = [ArmPosture(angles, float(np.minimum(angles - low, high - angles).min(where=limited, initial=np.pi)),
                               self._measure_manipulability(angles, rows), self.is_free(state, angles.tolist()))
                    for angles in found]
        return sorted((p for p in postures if p.is_free or not only_free), key=lambda p: -p.margin)

    def _subtract(self, angles: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
        """Difference of configurations, rad, that of continuous joints within [-pi, pi]."""
        difference = angles - others
        turned = difference - np.round(difference / math.tau) * math.tau
        return np.where(self.rules.robot.continuous, turned, difference)

    def _read_target(self, target: ArrayLike, state: RoomState) -> NDArray[np.float64]:
        """Target in the base frame."""
        try:
            goal = np.asarray(target, dtype=np.float64)
        except (TypeError, ValueError):
            goal = np.zeros(0)
        if goal.shape not in ((3,), (4, 4)) or not np.isfinite(goal).all():
            raise ConfigError("target", target, "a position (3,) in m, or a placement (4, 4)")
        if goal.shape == (4, 4) and not (np.allclose(goal[:3, :3] @ goal[:3, :3].T, np.eye(3), atol=1e-6)
                                         and np.linalg.det(goal[:3, :3]) > 0.0):
            raise ConfigError("target", target, "a placement (4, 4) whose upper left part is a rotation")
        cos, sin = self.rules.get_rotation(state.heading_steps, state.heading_offset)
        base = np.eye(4)
        base[:2, :2], base[:3, 3] = [[cos, -sin], [sin, cos]], (state.x, state.y, state.z)
        inverse = np.linalg.inv(base)
        return inverse @ goal if goal.shape == (4, 4) else inverse[:3, :3] @ goal + inverse[:3, 3]

    def _measure_manipulability(self, angles: NDArray[np.float64], rows: int) -> float:
        jacobian = self.kinematics.compute_jacobian(angles.tolist())[:rows]
        square = jacobian @ jacobian.T if jacobian.shape[1] >= rows else jacobian.T @ jacobian
        return math.sqrt(max(0.0, float(np.linalg.det(square))))

    def map_reach(self, point: Sequence[float], *, cell: float = 0.1, tolerance: float = 0.05) -> ReachMap:
        """Map the places of the base from which the hand reaches a point, collisions of the arm ignored.

        Args:
            point: x, y and z in the room, m.
            cell: side of the map's cells, m; a place counts if the hand gets to the point from somewhere in its cell.
            tolerance: largest difference in height that counts as reached, m.
        """
        x, y, z = (float(number) for number in point)
        low, high = self._limits
        samples = _make_halton(CONFIGURATIONS, len(low))
        hands = self.rules.robot.compute_hand(low + (high - low) * samples)
        hands = hands[np.abs(hands[:, 2] - z) <= tolerance, :2]
        grid = FloorGrid.cover(self.instance.reach_x, self.instance.reach_y, cell)
        counts = np.zeros(grid.cells)
        for heading in range(self.rules.headings):
            cos, sin = self.rules.get_rotation(heading, 0.0)
            places = np.array([x, y]) - hands @ np.array([[cos, sin], [-sin, cos]])
            cells = grid.find_numbers(places)
            reached = np.zeros(grid.cells, dtype=bool)
            reached[cells[cells >= 0]] = True
            counts += reached
        share = np.where(self._floor.are_free(grid.get_centres()), counts / self.rules.headings, 0.0)
        return ReachMap(self.instance, (x, y, z), grid.low, cell, share.reshape(grid.shape))

    # --- motion --------------------------------------------------------------------------

    def plan(self, state: RoomState, goal: ArrayLike, *, planner: str = "RRTConnect", seed: int = 0,
             budget: int = 100_000, time_limit: float | None = None) -> MotionPath:
        """Plan a collision-free motion of the arm, the base at rest.

        Args:
            state: base and arm at the beginning.
            goal: joint angles (joints,), or several of which any will do (n, joints), rad. A continuous joint goes to
                its angle in the nearest turn; the path's angles go on beyond pi.
            planner: one of OMPL's, such as `RRTConnect`.
            seed: the same seed gives the same path.
            budget: places that may be tested.
            time_limit: s; None leaves the decision to the budget.

        Raises:
            PlanningFailed: there is no path; its reason says why.
            StateError: no such state in this room.
            ConfigError: the goal is no configuration within the joint limits.
        """
        check_fields(self.rules, state)
        goals = self._read_goals(goal)
        start = np.array(self.rules.get_angles(state))
        return self._search(state, self.rules.robot.joint_names, self._limits, start, goals, lambda at, margin: True,
                            planner, seed, budget, time_limit)

    def plan_whole_body(self, state: RoomState, place: Sequence[float], goal: ArrayLike, *,
                        planner: str = "RRTConnect", seed: int = 0, budget: int = 200_000,
                        time_limit: float | None = None) -> MotionPath:
        """Plan a collision-free motion of base and arm together.

        Args:
            state: base and arm at the beginning.
            place: of the base at the end: x, y, m, and heading, rad.
            goal: joint angles at the end, (joints,), rad.
            planner: as in `plan`.
            seed: as in `plan`.
            budget: as in `plan`.
            time_limit: as in `plan`.

        Raises:
            PlanningFailed: there is no path; its reason says why.
            StateError: no such state in this room.
            ConfigError: place or goal are impossible.
            UnsupportedError: the base has a differential drive, which cannot move in any direction.
        """
        check_fields(self.rules, state)
        if self.instance.robot.drive == "differential":
            raise UnsupportedError("base and arm move together only where the base strafes: plan the base's way with "
                                   "RoomPlanner and the arm's with plan")
        end = np.array([float(number) for number in place])
        if end.shape != (3,) or not np.isfinite(end).all():
            raise ConfigError("place", place, "x and y in m and a heading in rad")
        heading = self.rules.get_heading(state)
        end[2] = heading + math.remainder(end[2] - heading, math.tau)
        start = np.array([state.x, state.y, heading, *self.rules.get_angles(state)])
        goals = np.concatenate([end, self._read_goals(goal)[0]])[None]
        low, high = self._limits
        floor = np.array([self.instance.reach_x, self.instance.reach_y])
        box = (np.concatenate([-floor, [heading - 1.5 * math.pi], low]),
               np.concatenate([floor, [heading + 1.5 * math.pi], high]))
        if (np.abs(end[:2]) > floor).any():
            raise ConfigError("place", place, f"x and y on the floor, at most {floor.tolist()}")

        def does_base_fit(at: NDArray[np.float64], margin: float) -> bool:
            x, y, turn = at[:3].tolist()
            return self._floor.does_fit(x, y, (math.cos(turn), math.sin(turn)), margin)

        names = ("x", "y", "heading", *self.rules.robot.joint_names)
        return self._search(state, names, box, start, goals, does_base_fit, planner, seed, budget, time_limit)

    def _read_goals(self, goal: ArrayLike) -> NDArray[np.float64]:
        low, high = self._limits
        try:
            goals = np.atleast_2d(np.asarray(goal, dtype=np.float64))
        except (TypeError, ValueError):
            goals = np.zeros((0, 0))
        low, high = np.where(self.rules.robot.continuous, [[-np.inf], [np.inf]], (low, high))
        right = goals.ndim == 2 and len(goals) and goals.shape[1] == len(low)
        if not right or not (np.isfinite(goals).all() and (goals >= low - 1e-9).all() and (goals <= high + 1e-9).all()):
            raise ConfigError("goal", goal, f"angles of {len(low)} joints from {np.round(low, 3).tolist()} to "
                                            f"{np.round(high, 3).tolist()} rad")
        return np.clip(goals, low, high)

    def _list_turns(self, start: NDArray[np.float64], goals: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return goals with continuous joints in the nearest turn, then with one of them the other way round."""
        joints = len(self.rules.robot.joint_names)
        turning = np.flatnonzero(self.rules.robot.continuous) + len(start) - joints
        nearest = goals.copy()
        nearest[:, -joints:] = start[-joints:] + self._subtract(goals[:, -joints:], start[-joints:])
        others = []
        for column in turning:
            other = nearest.copy()
            other[:, column] -= np.where(other[:, column] >= start[column], math.tau, -math.tau)
            others.append(other)
        return np.concatenate([nearest, *others])

    def _search(self, state: RoomState, names: tuple[str, ...], box: tuple[NDArray[np.float64], NDArray[np.float64]],
                start: NDArray[np.float64], goals: NDArray[np.float64], does_base_fit: BaseTest, planner: str,
                seed: int, budget: int, time_limit: float | None) -> MotionPath:
        """Search in coordinates scaled to metres of motion, with a margin for every pair of bodies.

        Motions are tested whole, by conservative advancement: all along a path every pair keeps half of its margin.
        """
        if planner not in OMPL_PLANNERS:
            raise UnknownNameError("path planner", planner, OMPL_PLANNERS)
        began, clock, joints = read_clock(), Clock(time_limit), len(self.rules.robot.joint_names)
        pose = (state.x, state.y, self.rules.get_heading(state))
        place = None if len(start) > joints else pose

        def fail(reason: PlanningReason, nearest: str = "") -> PlanningFailed:
            return PlanningFailed(reason, "configuration", pose, read_clock() - began, (planner,), nearest=nearest)

        plain = self._get_collisions(CLEARANCE)
        near = [plain.measure_near(*split_coordinates(at, place), within=CLEARANCE) for at in (start, *goals)]
        faults = [self._find_fault(at, place, distances, does_base_fit)
                  for at, distances in zip((start, *goals), near, strict=True)]
        if faults[0]:
            raise fail(PlanningReason.START_INVALID, faults[0])
        if all(faults[1:]):
            raise fail(PlanningReason.GOAL_INVALID, faults[1])
        goals = np.array([goal for goal, fault in zip(goals, faults[1:], strict=True) if not fault])
        margins = dict.fromkeys(plain.list_own_pairs(), 0.9 * OWN_CLEARANCE)
        for distances, fault in zip(near, faults, strict=True):
            for pair, away in () if fault else distances.items():
                margins[pair] = min(margins.get(pair, CLEARANCE), 0.9 * away)
        fitting = [margin for margin in BASE_CLEARANCES if all(does_base_fit(at, margin) for at in (start, *goals))]
        if not fitting:
            raise fail(PlanningReason.UNREACHABLE_AT_RESOLUTION, "the base has less than 1 mm of room at start or goal")
        spent = CheckerBudget(budget, clock)
        test = MotionTest(plain.with_margins(CLEARANCE, margins), place, does_base_fit, fitting[0], spent)
        *far, turn = plain.sweeps.tolist()
        scale = np.maximum(far if place is not None else (1.0, 1.0, max(turn, 0.1), *far), 1e-3)
        goals = self._list_turns(start, goals)
        low, high = np.minimum(box[0], start), np.maximum(box[1], start)
        around = np.concatenate([np.zeros(len(start) - joints, dtype=bool), self.rules.robot.continuous])
        low, high = np.where(around, start - math.tau, low), np.where(around, start + math.tau, high)
        try:
            path = find_joint_path(low * scale, high * scale, start * scale, goals * scale,
                                   lambda at: test.is_free(at / scale), test.margin, spent, planner=planner, seed=seed,
                                   is_move_free=lambda begin, end: test.is_move_free(begin / scale, end / scale))
        except OutOfTime:
            raise fail(clock.reason) from None
        if path is None:
            raise fail(PlanningReason.BUDGET_EXHAUSTED if spent.calls >= budget
                       else PlanningReason.UNREACHABLE_AT_RESOLUTION)
        points = path / scale
        kept = min([test.margin, *margins.values()])
        if len(points) > 2 and kept < test.margin:  # corners are rounded within it
            kept = max(kept, _find_clearance(points, test, margins))
        return MotionPath(names, points, scale, kept / 4.0, planner, spent.calls, read_clock() - began,
                          self.rules.robot)

    def _find_fault(self, at: NDArray[np.float64], place: tuple[float, float, float] | None,
                    near: Mapping[frozenset[Key], float], does_base_fit: BaseTest) -> str:
        """Say why a path may not begin or end at coordinates, given the near pairs; empty if it may."""
        if min(near.values(), default=CLEARANCE) <= 0.0:
            meets = self._get_collisions(0.0).list_collisions(*split_coordinates(at, place))
            if meets:
                return ", ".join(meets)
        if not does_base_fit(at, 0.0):
            return "the base meets a solid"
        return ", ".join(f"nearer than {1000 * OWN_CLEARANCE:g} mm: {self._get_collisions(CLEARANCE).describe(pair)}"
                         for pair, away in near.items() if away < OWN_CLEARANCE)


def _find_clearance(points: NDArray[np.float64], test: MotionTest, margins: Mapping[frozenset[Key], float]) -> float:
    """Return the first of `_CORNER_CLEARANCES` that all pairs keep half of along a path, m; 0 if they keep none."""
    tests = CheckerBudget(10 * test.budget.most + 10_000, test.budget.clock)
    for clearance in _CORNER_CLEARANCES:
        wider = test.collisions.with_margins(CLEARANCE, {pair: max(kept, clearance) for pair, kept in margins.items()})
        wide = dataclasses.replace(test, collisions=wider, budget=tests)
        try:
            if all(wide.is_move_free(begin, end) for begin, end in itertools.pairwise(points)):
                return min(test.margin, clearance)
        except Spent:
            break
    return 0.0


@dataclasses.dataclass(frozen=True, eq=False)
class ReachMap:
    """Share of the base's headings from which the hand reaches a point, by place of the base."""

    instance: RoomInstance  # the room
    point: tuple[float, float, float]  # the point, (x, y, z), m
    low: NDArray[np.float64]  # corner of the grid, shape (2,), m
    cell: float  # side of its square cells, m
    share: NDArray[np.float64]  # of the headings, shape (columns, rows), columns along x; 0 where the base does not fit

    def __repr__(self) -> str:
        return f"<ReachMap of {self.point}: {self.share.max():.0%} of headings at best, from {self.get_best()}>"

    def _repr_svg_(self) -> str:
        return make_svg(self.draw())

    def get_best(self) -> tuple[float, float]:
        """Place with the largest share, m."""
        i, j = np.unravel_index(int(self.share.argmax()), self.share.shape)
        x, y = (self.low + (np.array([i, j]) + 0.5) * self.cell).tolist()
        return x, y

    def draw(self, path: str | Path | None = None) -> Any:
        """Draw the map over the room's; PNG, SVG or PDF if a path is given. Returns the matplotlib figure."""
        from hrl_escape.env.pictures.maps import make_map  # loads matplotlib

        figure = make_map(self.instance)
        axes = figure.axes[0]
        (x, y), (columns, rows) = self.low.tolist(), self.share.shape
        shown = np.ma.masked_equal(self.share.T, 0.0)
        image = axes.imshow(shown, extent=(x, x + columns * self.cell, y, y + rows * self.cell), origin="lower",
                            cmap="viridis", vmin=0.0, vmax=max(float(self.share.max()), 1e-9), alpha=0.75,
                            zorder=1.5, interpolation="nearest")
        axes.plot(self.point[0], self.point[1], "x", color="black", markersize=9, markeredgewidth=2, zorder=5)
        bar = figure.colorbar(image, cax=axes.inset_axes((0.3, 0.965, 0.4, 0.012)), orientation="horizontal")
        bar.set_label(f"share of headings from which the hand gets to the cross, {self.point[2]:.2g} m up", fontsize=7)
        bar.ax.tick_params(labelsize=6)
        if path is not None:
            save_figure(path, figure)
        return figure


def _make_halton(count: int, dimensions: int) -> NDArray[np.float64]:
    """First points of the Halton sequence in the unit cube, shape (count, dimensions)."""
    from scipy.stats import qmc  # takes half a second to load

    return qmc.Halton(dimensions, scramble=False).fast_forward(1).random(count)
