"""`Arm`: a robot from its URDF among obstacles at any placement, without a room.

An arm is a value: every edit returns a new one. Angles are rad, lengths m. Everything is in the frame of the world, in
which the root link of the URDF has the placement `base_pose`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import Self

from hrl_escape.env.placements import compute_roll_pitch_yaw, read_placement
from hrl_escape.env.robot import Robot, make_fixed_robot
from hrl_escape.env.urdf import PackagePaths, is_xml, load_urdf, parse_urdf, prepare_urdf
from hrl_escape.errors import ConfigError, UnknownNameError, UnsupportedError
from hrl_escape.planning.arm.inverse import ArmPosture, find_postures, read_target
from hrl_escape.planning.arm.model import ArmCollisions, ArmKinematics, PairRules
from hrl_escape.planning.arm.motion_search import MotionSearch, SearchLimits
from hrl_escape.planning.arm.obstacles import Obstacle
from hrl_escape.planning.arm.srdf import find_group, read_srdf
from hrl_escape.planning.paths.problem import MotionPath

if TYPE_CHECKING:
    from hrl_escape.planning.motion.limits import MotionLimits
    from hrl_escape.planning.motion.trajectory import TimedTrajectory

_HERE = (0.0, 0.0, 0.0)  # x, y and heading: the placement of the base is part of the URDF


@dataclasses.dataclass(frozen=True, eq=False)
class AttachedObject:
    """An obstacle that a link carries."""

    obstacle: Obstacle  # as it stood
    link: str  # link that carries it
    placement: NDArray[np.float64]  # in the frame of the link, (4, 4)


@dataclasses.dataclass(frozen=True, eq=False)
class Arm:
    """A robot among obstacles. Make one with `from_urdf`. Not thread-safe.

    Attributes:
        robot: the robot: its joints, limits and URDF.
        obstacles: obstacles.
        postures: joint angles of the SRDF's group states by name, and `home`, rad.
        attached: objects that links carry.
        rules: rules of the pairs of bodies that are tested.
    """

    robot: Robot
    obstacles: tuple[Obstacle, ...]
    postures: Mapping[str, tuple[float, ...]]
    rules: PairRules
    attached: tuple[AttachedObject, ...] = ()

    @classmethod
    def from_urdf(cls, urdf: str | Path, *, srdf: str | Path | None = None, group: str = "", hand: str = "",
                  joints: Sequence[str] | None = None, home: Mapping[str, float] | None = None,
                  base_pose: ArrayLike = (0.0, 0.0, 0.0), obstacles: Iterable[Obstacle] = (),
                  floor: float | None = None, package_paths: PackagePaths = ()) -> Self:
        """Load a robot.

        Args:
            urdf: path of the URDF, or its text with absolute paths of meshes.
            srdf: path or text of MoveIt's SRDF: pairs of links that may touch, groups and named postures. Without
                one, pairs that touch with all joints at home may touch.
            group: planning group of the SRDF, whose joints are planned.
            hand: link whose origin is the hand. By default the tip of the group, the link that carries the SRDF's only
                end effector, or the end of the longest chain of joints.
            joints: names of the planned joints, anywhere in the tree. By default the joints of the group, or all that
                move the hand.
            home: positions of joints by name, rad or m. Joints that are not planned are locked there. Other joints
                are at 0, or in the middle of limits that leave out 0.
            base_pose: placement of the URDF's root link in the world: position (3,), m; position, roll, pitch and yaw
                (6,); or a matrix (4, 4).
            obstacles: what stands in the world. Links that no planned joint moves may touch it.
            floor: height of a floor, m, or None for none.
            package_paths: folders of ROS packages, as in `load_urdf`.

        Returns:
            The arm.

        Raises:
            RobotError: the URDF cannot be read, or has no such link or joint.
            ConfigError: the SRDF, a placement or the name of an obstacle is not valid.
        """
        root = parse_urdf(str(urdf) if is_xml(urdf) else load_urdf(urdf, package_paths), "the URDF")
        prepare_urdf(root)
        found = None if srdf is None else find_group(srdf, root, group)
        if group and srdf is None:
            raise ConfigError("group", group, "a group of an SRDF. Give srdf=")
        if found is not None:
            hand = hand or found.tip
            joints = found.joints if joints is None else joints
        robot = make_fixed_robot(root, hand, joints, home, read_placement(base_pose, "base_pose"))
        text, postures = (None, {}) if srdf is None else read_srdf(srdf, robot)
        arm = cls(robot, (), {"home": robot.home, **postures}, PairRules(text, floor, stands=True))
        for obstacle in obstacles:
            arm = arm.add(obstacle)
        return arm

    def __repr__(self) -> str:
        return f"<Arm of {len(self.joint_names)} joints among {len(self.obstacles)} obstacles>"

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Return the names of the planned joints, in the order of all angles."""
        return self.robot.joint_names

    @property
    def limits(self) -> NDArray[np.float64]:
        """Return the limits of the planned joints, (joints, 2), rad; -pi and pi for continuous ones."""
        return np.array(self.robot.limits)

    @property
    def home(self) -> NDArray[np.float64]:
        """Return the angles of the home posture, (joints,), rad."""
        return np.array(self.robot.home)

    # --- obstacles -----------------------------------------------------------------------

    def add(self, obstacle: Obstacle, may_touch: Iterable[str] = ()) -> Self:
        """Add an obstacle.

        Args:
            obstacle: the obstacle.
            may_touch: names of links and attached objects that may touch it.

        Returns:
            The new arm.

        Raises:
            ConfigError: the name is taken.
        """
        if obstacle.name in self._names:
            raise ConfigError("name", obstacle.name, "a name that no other obstacle and no link has")
        return dataclasses.replace(self, obstacles=(*self.obstacles, obstacle),
                                   rules=self._allow(obstacle.name, may_touch))

    def remove(self, name: str) -> Self:
        """Remove an obstacle. Returns the new arm; raises `UnknownNameError` where there is none of this name."""
        gone = self._get(name)
        return dataclasses.replace(self, obstacles=tuple(each for each in self.obstacles if each is not gone),
                                   rules=self._forbid(name))

    def move(self, name: str, placement: ArrayLike) -> Self:
        """Move an obstacle.

        Args:
            name: its name.
            placement: its new placement, as of `base_pose` in `from_urdf`.

        Returns:
            The new arm.

        Raises:
            UnknownNameError: no obstacle has this name.
            ConfigError: the placement is none.
        """
        moved = self._get(name)
        return dataclasses.replace(self, obstacles=tuple(each.at(placement) if each is moved else each
                                                         for each in self.obstacles))

    def attach(self, name: str, angles: ArrayLike | str, *, link: str = "", may_touch: Iterable[str] = (),
               mass: float = 0.0) -> Self:
        """Attach an obstacle to a link. It then moves with that link and collides as its convex hull.

        Args:
            name: name of the obstacle, which stays the name of the object.
            angles: joint angles at the grip, (joints,), rad, or the name of a posture.
            link: link that carries it; the hand by default. It may touch links that move with that link.
            may_touch: names of other links and of obstacles that it may touch, such as the table under it.
            mass: mass of the object, kg, for limits of effort.

        Returns:
            The new arm.

        Raises:
            UnknownNameError: there is no obstacle or link of this name.
            ConfigError: the angles are not a configuration, or the mass is negative.
        """
        obstacle, link = self._get(name), link or self.robot.hand_link
        if not (isinstance(mass, (int, float)) and 0.0 <= mass < 1e6):
            raise ConfigError("mass", mass, "kilograms from 0 on")
        inside = np.linalg.inv(self.compute_placement(angles, link)) @ obstacle.placement
        urdf = ElementTree.fromstring(self.robot.urdf)
        part = ElementTree.SubElement(urdf, "link", name=name)
        if mass > 0.0:
            inertial = ElementTree.SubElement(part, "inertial")
            ElementTree.SubElement(inertial, "mass", value=repr(float(mass)))
            ElementTree.SubElement(inertial, "inertia", dict.fromkeys(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), "0"))
        for tag in ("visual", "collision"):
            ElementTree.SubElement(part, tag).append(obstacle.make_geometry())
        joint = ElementTree.SubElement(urdf, "joint", name=f"{name}-grip", type="fixed")
        ElementTree.SubElement(joint, "parent", link=link)
        ElementTree.SubElement(joint, "child", link=name)
        ElementTree.SubElement(joint, "origin", xyz=" ".join(map(repr, inside[:3, 3].tolist())),
                               rpy=" ".join(map(repr, compute_roll_pitch_yaw(inside[:3, :3]))))
        robot = dataclasses.replace(self.robot, urdf=ElementTree.tostring(urdf, encoding="unicode"))
        rules = dataclasses.replace(self._allow(name, may_touch), held=self.rules.held | {name})
        return dataclasses.replace(self, robot=robot, rules=rules, attached=(*self.attached, AttachedObject(
            obstacle, link, inside)), obstacles=tuple(each for each in self.obstacles if each is not obstacle))

    def detach(self, name: str, angles: ArrayLike | str) -> Self:
        """Detach an object, which becomes an obstacle where it is.

        Args:
            name: name of the object.
            angles: joint angles at the release, (joints,), rad, or the name of a posture.

        Returns:
            The new arm.

        Raises:
            UnknownNameError: no object of this name is attached.
            ConfigError: the angles are not a configuration.
        """
        held = next((each for each in self.attached if each.obstacle.name == name), None)
        if held is None:
            raise UnknownNameError("attached object", name, [each.obstacle.name for each in self.attached])
        placed = held.obstacle.at(self.compute_placement(angles, held.link) @ held.placement)
        urdf = ElementTree.fromstring(self.robot.urdf)
        for element in [*urdf]:
            if (element.tag, element.get("name")) in (("link", name), ("joint", f"{name}-grip")):
                urdf.remove(element)
        rules = dataclasses.replace(self._forbid(name), held=self.rules.held - {name})
        return dataclasses.replace(
            self, robot=dataclasses.replace(self.robot, urdf=ElementTree.tostring(urdf, encoding="unicode")),
            rules=rules, attached=tuple(each for each in self.attached if each is not held),
            obstacles=(*self.obstacles, placed))

    def _get(self, name: str) -> Obstacle:
        for obstacle in self.obstacles:
            if obstacle.name == name:
                return obstacle
        raise UnknownNameError("obstacle", name, [each.name for each in self.obstacles])

    def _allow(self, name: str, others: Iterable[str]) -> PairRules:
        pairs = frozenset(frozenset((name, other)) for other in others)
        for other in sorted(frozenset().union(*pairs) - self._names - {name}):
            raise UnknownNameError("link or obstacle", other, sorted(self._names))
        return dataclasses.replace(self.rules, allowed=self.rules.allowed | pairs)

    def _forbid(self, name: str) -> PairRules:
        return dataclasses.replace(self.rules,
                                   allowed=frozenset(pair for pair in self.rules.allowed if name not in pair))

    # --- kinematics and collisions --------------------------------------------------------

    @cached_property
    def _links(self) -> tuple[str, ...]:
        return tuple(link.get("name", "") for link in ElementTree.fromstring(self.robot.urdf).findall("link"))

    @cached_property
    def _names(self) -> frozenset[str]:
        """Return the names of everything that may be touched."""
        return frozenset((*self._links, *(each.name for each in self.obstacles), "floor"))

    @cached_property
    def _hands(self) -> dict[str, ArmKinematics]:
        return {}

    def _get_kinematics(self, link: str) -> ArmKinematics:
        link = link or self.robot.hand_link
        if link not in self._links:
            raise UnknownNameError("link", link, self._links)
        if link not in self._hands:
            self._hands[link] = ArmKinematics(self.robot, link)
        return self._hands[link]

    @cached_property
    def _search(self) -> MotionSearch:
        return MotionSearch(ArmCollisions(self.robot, 0.0, self.obstacles, rules=self.rules))

    def _read_angles(self, given: ArrayLike | str, name: str) -> NDArray[np.float64]:
        """Return configurations (n, joints), rad."""
        if isinstance(given, str):
            if given not in self.postures:
                raise UnknownNameError("posture", given, list(self.postures))
            given = self.postures[given]
        return self._search.read_angles(given, name)

    def compute_placement(self, angles: ArrayLike | str, link: str = "") -> NDArray[np.float64]:
        """Return the placement of a link, the hand by default, in the world, (4, 4).

        Args:
            angles: joint angles, (joints,), rad, or the name of a posture.
            link: name of the link.

        Raises:
            UnknownNameError: there is no such link or posture.
            ConfigError: the angles are not a configuration within the joint limits.
        """
        return self._get_kinematics(link).compute_placement(self._read_angles(angles, "angles")[0].tolist())

    def is_free(self, angles: ArrayLike | str, margin: float = 0.0) -> bool:
        """Return whether the arm is clear of obstacles, the floor and itself.

        Args:
            angles: joint angles, (joints,), rad, or the name of a posture.
            margin: distance that counts as a collision already, m.

        Raises:
            ConfigError: the angles are not a configuration within the joint limits.
        """
        at = self._read_angles(angles, "angles")[0].tolist()
        return self._search.get_collisions(margin).is_free(*_HERE, at)

    def list_collisions(self, angles: ArrayLike | str) -> list[str]:
        """List what meets at a configuration, such as `forearm meets table`; argument as of `is_free`."""
        at = self._read_angles(angles, "angles")[0].tolist()
        return self._search.get_collisions(0.0).list_collisions(*_HERE, at)

    def solve_ik(self, target: ArrayLike, start: ArrayLike | str = "home", *, hand: str = "", seeds: int = 64,
                 tolerance: float = 1e-4, only_free: bool = True) -> list[ArmPosture]:
        """Find the postures that bring the hand to a target, those farthest from joint limits first.

        Joints that do not move the hand stay as in `start`. An arm with more joints than the target has coordinates
        has infinitely many postures, of which these are a sample.

        Args:
            target: in the world: position of the hand (3,), m; or placement of its link: position, roll, pitch and yaw
                (6,), m and rad, or a matrix (4, 4).
            start: joint angles where the first search begins, (joints,), rad, or the name of a posture.
            hand: another link that is brought to the target.
            seeds: searches.
            tolerance: largest distance from the target, m; for a placement also the largest rotation from it, rad.
            only_free: leave out postures in collision.

        Raises:
            ConfigError: the target is neither a position nor a placement, or the start is not a configuration.
            UnsupportedError: no planned joint moves the hand.
        """
        arm = self._get_kinematics(hand)
        if not arm.moves_hand.any():
            raise UnsupportedError(f"no planned joint moves {hand or self.robot.hand_link!r}. Plan one that does "
                                   "(joints=...)")
        return find_postures(arm, read_target(target, np.eye(4)), self._read_angles(start, "start")[0], seeds,
                             tolerance, self.is_free, only_free)

    # --- motion ----------------------------------------------------------------------------

    def plan(self, start: ArrayLike | str, goal: ArrayLike | str, *, planner: str = "RRTConnect", seed: int = 0,
             budget: int = 100_000, time_limit: float | None = None) -> MotionPath:
        """Plan a collision-free motion.

        The arm keeps 2 cm from obstacles and 1 mm from itself, or half the distance at start or goal where that is
        less. All along the path it keeps half of that.

        Args:
            start: joint angles, (joints,), rad, or the name of a posture.
            goal: likewise, or several configurations of which any will do, (n, joints), rad. A continuous joint goes
                to its angle in the nearest turn; the path's angles go on beyond pi.
            planner: one of OMPL's, such as `RRTConnect`.
            seed: the same seed gives the same path.
            budget: configurations that may be tested.
            time_limit: s; None leaves the decision to the budget.

        Returns:
            The path, from the start to a goal.

        Raises:
            PlanningFailed: there is no path; its reason says why, and names what is too near at start or goal.
            ConfigError: start or goal is not a configuration within the joint limits.
            UnknownNameError: there is no such posture or planner.
        """
        return self._search.find_path(_HERE, self._read_angles(start, "start")[0], self._read_angles(goal, "goal"),
                                      SearchLimits(planner, seed, budget, time_limit))

    def trajectory(self, path: MotionPath, limits: MotionLimits | None = None) -> TimedTrajectory:
        """Time a path under limits of speed, acceleration and jerk, and the efforts of the URDF.

        Args:
            path: a path of `plan`.
            limits: limits, or None for the defaults of `MotionLimits`.

        Returns:
            The trajectory.

        Raises:
            ConfigError: the efforts of the URDF do not hold the arm.
        """
        from hrl_escape.planning.motion.trajectory import make_trajectory  # loads the rooms

        return make_trajectory(dataclasses.replace(path, robot=self.robot), limits)
