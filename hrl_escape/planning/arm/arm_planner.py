"""`ArmPlanner`: inverse kinematics and collision-free motion of one room's robot, in joint angles.

Pinocchio gives kinematics and Jacobians, coal detects collisions, OMPL finds the way. Nothing here is tied to whole
joint steps: `RoomPlanner` plans primitives, and such paths are followed only by options.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hrl_escape.env.floor_grid import FloorGrid
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState, check_fields
from hrl_escape.env.robot import BASE_LINK
from hrl_escape.errors import ConfigError, UnsupportedError
from hrl_escape.figures import make_svg, save_figure
from hrl_escape.floor.clearance import CollisionMap
from hrl_escape.planning.arm.inverse import ArmPosture, find_postures, make_halton, read_target
from hrl_escape.planning.arm.model import ArmCollisions, ArmKinematics, PairRules
from hrl_escape.planning.arm.motion_search import BaseMotion, MotionSearch, SearchLimits
from hrl_escape.planning.arm.srdf import read_srdf
from hrl_escape.planning.paths.problem import MotionPath

CONFIGURATIONS = 200_000
"""Configurations whose hand positions enter a reach map: points of a Halton sequence between the joint limits."""


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
    def _search(self) -> MotionSearch:
        return MotionSearch(ArmCollisions(self.rules.robot, self.instance.robot.hand_radius, self.instance.all_solids,
                                          rules=PairRules(self._srdf)))

    def _get_collisions(self, margin: float) -> ArmCollisions:
        return self._search.get_collisions(margin)

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
            target: in the room frame: position of the hand (3,), m; or placement of its link: position, roll, pitch
                and yaw (6,), m and rad, or a matrix (4, 4).
            state: where the base stands.
            seeds: searches.
            tolerance: largest distance from the target, m; for a pose also the largest rotation from it, rad.
            only_free: leave out postures in collision.

        Raises:
            StateError: no such state in this room.
            ConfigError: the target is neither a position nor a pose.
        """
        check_fields(self.rules, state)
        cos, sin = self.rules.get_rotation(state.heading_steps, state.heading_offset)
        base = np.eye(4)
        base[:2, :2], base[:3, 3] = [[cos, -sin], [sin, cos]], (state.x, state.y, state.z)
        return find_postures(self.kinematics, read_target(target, base), np.array(self.rules.get_angles(state)), seeds,
                             tolerance, lambda angles: self.is_free(state, angles), only_free)

    def map_reach(self, point: Sequence[float], *, cell: float = 0.1, tolerance: float = 0.05) -> ReachMap:
        """Map the places of the base from which the hand reaches a point, collisions of the arm ignored.

        Args:
            point: x, y and z in the room, m.
            cell: side of the map's cells, m; a place counts if the hand gets to the point from somewhere in its cell.
            tolerance: largest difference in height that counts as reached, m.
        """
        x, y, z = (float(number) for number in point)
        low, high = self._limits
        samples = make_halton(CONFIGURATIONS, len(low))
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
        goals = self._search.read_angles(goal, "goal")
        start = np.array(self.rules.get_angles(state))
        pose = (state.x, state.y, self.rules.get_heading(state))
        return self._search.find_path(pose, start, goals, SearchLimits(planner, seed, budget, time_limit))

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
        goals = np.concatenate([end, self._search.read_angles(goal, "goal")[0]])[None]
        floor = np.array([self.instance.reach_x, self.instance.reach_y])
        if (np.abs(end[:2]) > floor).any():
            raise ConfigError("place", place, f"x and y on the floor, at most {floor.tolist()}")

        def does_base_fit(at: NDArray[np.float64], margin: float) -> bool:
            x, y, turn = at[:3].tolist()
            return self._floor.does_fit(x, y, (math.cos(turn), math.sin(turn)), margin)

        base = BaseMotion(np.append(-floor, heading - 1.5 * math.pi), np.append(floor, heading + 1.5 * math.pi),
                          does_base_fit)
        return self._search.find_path((state.x, state.y, heading), start, goals,
                                      SearchLimits(planner, seed, budget, time_limit), base)


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
