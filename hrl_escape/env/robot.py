"""The robot: a wheeled base with an arm, as one URDF text that every engine and planner loads.

The arm is generated, comes with pybullet_data, or is the user's own URDF. The kinematic chain to the hand is read from
the same text, which gives the same hand position here, in Bullet and in Pinocchio. Frame `base`: origin on the floor
below the base's axis, x ahead, z up. Lengths in metres, angles in radians.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import math
from collections.abc import Mapping, Sequence
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hrl_escape.env.bases.base import make_cylinder_link
from hrl_escape.env.config import RobotConfig
from hrl_escape.env.placements import compute_roll_pitch_yaw, make_rotation, rotate_about
from hrl_escape.env.urdf import climb, load_urdf, map_joints, parse_urdf, prepare_urdf, read_numbers
from hrl_escape.errors import RobotError

BASE_LINK = "mobile-base"
_MOUNT_JOINT = "mobile-base-mount"
_HAND = "hand"
MOVING = ("revolute", "continuous", "prismatic")
"""Types of joints that move."""
_LARGEST_LIMIT = 1000.0  # rad or m
_SHIPPED = {  # kind: (file in pybullet_data, hand link)
    "kuka-iiwa": ("kuka_iiwa/model.urdf", "lbr_iiwa_link_7"),
    "franka-panda": ("franka_panda/panda.urdf", "panda_grasptarget"),
}
_ARM_AXES = ("0 0 1", "0 -1 0", "0 -1 0", "1 0 0", "0 -1 0", "0 0 1", "0 -1 0")


@dataclasses.dataclass(frozen=True)
class _Joint:
    """A joint of the chain from the base to the hand."""

    name: str
    kind: str
    origin: NDArray[np.float64]  # (4, 4) placement in the parent link
    axis: NDArray[np.float64]  # (3,) unit
    low: float
    high: float
    speed: float
    effort: float
    mimic: tuple[str, float, float] | None = None  # the joint that it follows, multiplier and offset

    @cached_property
    def rows(self) -> tuple[tuple[float, ...], ...]:
        """Rotation and position as three rows of four numbers."""
        return tuple(tuple(row) for row in self.origin[:3].tolist())

    @cached_property
    def direction(self) -> tuple[float, ...]:
        """Axis of the joint as plain numbers."""
        return tuple(self.axis.tolist())

    def move(self, x: Any, y: Any, z: Any, value: Any) -> tuple[Any, Any, Any]:
        """Return a point after a motion of the joint by `value` rad (or m), in the joint's frame."""
        a, b, c = self.direction
        if self.kind == "prismatic":
            return x + a * value, y + b * value, z + c * value
        cos, sin = np.cos(value), np.sin(value)  # Rodrigues' rotation formula
        along = (a * x + b * y + c * z) * (1.0 - cos)
        return (x * cos + (b * z - c * y) * sin + a * along, y * cos + (c * x - a * z) * sin + b * along,
                z * cos + (a * y - b * x) * sin + c * along)


@dataclasses.dataclass(frozen=True)
class Robot:
    """A robot in the form that engines and planners use. Joint arrays follow the order of the action space.

    Attributes:
        urdf: the whole robot as URDF text; its root link is `BASE_LINK`.
        joint_names: joints that primitives move.
        hand_link: link whose origin is the hand.
        home: joint angles at the start of an episode, rad: zero if the limits allow it, otherwise the middle of them.
        step: angle of one joint primitive, rad.
        step_low: fewest joint steps from home within the limits (<= 0).
        step_high: most joint steps from home within the limits (>= 0).
        limits: (low, high) of each joint, rad.
        speeds: largest speed of each joint, rad/s; infinite if the URDF states none.
        efforts: largest torque of each joint, N m; infinite if the URDF states none.
        chain: joints from the base to the hand, fixed ones included.
        rest: angles of the moving joints that no primitive moves and that follow none that one moves, by name, rad
            (or m).
        mimics: joints that follow one that primitives move: its number, multiplier and offset, rad (or m), by name.
        continuous: whether each joint turns without limits.
    """

    urdf: str
    joint_names: tuple[str, ...]
    hand_link: str
    home: tuple[float, ...]
    step: float
    step_low: tuple[int, ...]
    step_high: tuple[int, ...]
    limits: tuple[tuple[float, float], ...]
    speeds: tuple[float, ...]
    efforts: tuple[float, ...]
    chain: tuple[_Joint, ...]
    rest: dict[str, float]
    mimics: dict[str, tuple[int, float, float]]
    continuous: tuple[bool, ...]

    def compute_values(self, angles: Any) -> dict[str, Any]:
        """Positions of all moving joints by name, rad (or m), where `angles[i]` is that of joint i, rad."""
        return (self.rest | {name: angles[i] for i, name in enumerate(self.joint_names)}
                | {name: factor * angles[i] + offset for name, (i, factor, offset) in self.mimics.items()})

    def compute_angles(self, joint_steps: tuple[int, ...],
                       joint_offsets: tuple[float, ...] = ()) -> tuple[float, ...]:
        """Return joint angles in rad after whole steps from home, plus the offsets that noise added."""
        offsets = joint_offsets or (0.0,) * len(joint_steps)
        return tuple(home + n * self.step + extra
                     for home, n, extra in zip(self.home, joint_steps, offsets, strict=True))

    def compute_hand(self, angles: ArrayLike, links: int | None = None) -> NDArray[np.float64]:
        """Return the position of the hand in the base frame.

        Args:
            angles: joint angles in rad, shape (..., joints).
            links: number of links to follow; the position is the end of the last one. By default the whole chain.

        Returns:
            Positions in metres, float64, shape (..., 3).
        """
        q = np.asarray(angles, dtype=np.float64)
        x, y, z, values = 0.0, 0.0, 0.0, self.compute_values(np.moveaxis(q, -1, 0))
        for joint in reversed(self.chain[:links]):  # `x, y, z` is the hand in the frame before each joint
            if joint.kind != "fixed":
                x, y, z = joint.move(x, y, z, values[joint.name])
            (r00, r01, r02, px), (r10, r11, r12, py), (r20, r21, r22, pz) = joint.rows
            x, y, z = (r00 * x + r01 * y + r02 * z + px, r10 * x + r11 * y + r12 * z + py,
                       r20 * x + r21 * y + r22 * z + pz)
        hand = np.empty((*q.shape[:-1], 3))
        hand[..., 0], hand[..., 1], hand[..., 2] = x, y, z
        return hand

    def trace_links(self, angles: ArrayLike) -> NDArray[np.float64]:
        """Return the ends of the arm's links in the base frame, the hand last, shape (links, 3), m."""
        return np.array([self.compute_hand(angles, number + 1) for number in range(len(self.chain))])

    def compute_elbows(self, angles: tuple[float, ...]) -> NDArray[np.float64]:
        """Return the arm as a polyline: origins of the joints and the hand in the base frame, shape (n, 3), m."""
        values = self.compute_values(angles)
        at, places = np.eye(4), []
        for joint in self.chain:
            at = at @ joint.origin
            places.append(at[:3, 3].copy())
            if joint.kind == "prismatic":
                at[:3, 3] += at[:3, :3] @ joint.axis * values[joint.name]
            elif joint.kind != "fixed":
                at[:3, :3] = at[:3, :3] @ rotate_about(joint.axis, values[joint.name])
        return np.array([*places, at[:3, 3]])


def sample_hand_positions(robot: Robot, count: int) -> NDArray[np.float64]:
    """Return hand positions in the base frame, shape (configurations, 3), m.

    They cover the whole joint lattice, or `count` fixed samples if the lattice is larger. The same robot and count
    give the same positions in every process.
    """
    return robot.compute_hand(np.array(robot.home) + robot.step * sample_joint_steps(robot, count))


def sample_joint_steps(robot: Robot, count: int) -> NDArray[np.int64]:
    """Return the configurations of `sample_hand_positions` in whole steps from home, int64 (configurations, joints)."""
    low, high = np.array(robot.step_low, dtype=np.int64), np.array(robot.step_high, dtype=np.int64)
    sizes = (high - low + 1).tolist()
    total = math.prod(sizes)
    if total > count:
        return np.random.default_rng(0).integers(low, high + 1, size=(count, len(sizes)))
    indices = np.unravel_index(np.arange(total), sizes) if sizes else ()
    return low + np.stack(indices, axis=-1) if sizes else np.zeros((1, 0), dtype=np.int64)


def _find_shipped(file: str) -> Path:
    spec = importlib.util.find_spec("pybullet_data")
    if spec is None or spec.origin is None:
        raise RobotError("pybullet_data is not installed; it comes with pybullet: pip install 'hrl-escape[bullet]'")
    return Path(spec.origin).parent / file


@lru_cache(maxsize=64)
def make_robot(config: RobotConfig) -> Robot:
    """Build the robot of a room configuration. Equal configurations give the same object.

    Raises:
        EscapeError: the URDF of the arm lacks the hand link, a mesh or joints, or its meshes are too large.
    """
    if config.kind in _SHIPPED:
        file, hand = _SHIPPED[config.kind]
        arm = parse_urdf(load_urdf(_find_shipped(file)), config.kind)
        hand = config.hand_link or hand
    elif config.kind == "urdf":
        arm = parse_urdf(config.urdf or "", "robot.urdf")
        prepare_urdf(arm)
        hand = config.hand_link or arm.findall("link")[-1].get("name", "")
    else:
        arm = _make_arm(config)
        hand = config.hand_link or (_HAND if config.joints else BASE_LINK)
    return _assemble(config, _mount(config, arm), hand)


def make_fixed_robot(arm: ElementTree.Element, hand: str = "", joints: Sequence[str] | None = None,
                     home: Mapping[str, float] | None = None, placement: NDArray[np.float64] | None = None) -> Robot:
    """Build a robot that stands still, from a URDF.

    Args:
        arm: the URDF, prepared by `prepare_urdf`.
        hand: link whose origin is the hand; empty for the last link of the longest chain of joints.
        joints: names of the planned joints, anywhere in the tree; None for all independent ones that move the hand.
        home: positions of joints by name, rad or m. Joints that are not planned stay there. Others are at 0, or in
            the middle of limits that leave out 0.
        placement: of the URDF's root link in the world, (4, 4), or None for its origin.

    Returns:
        The robot; its root link `BASE_LINK` has no shape, and its frame is the world.

    Raises:
        RobotError: there is no such link or joint, no planned joint, or a position beyond the limits of its joint.
    """
    at = np.eye(4) if placement is None else placement
    xyz, rpy = (" ".join(map(repr, numbers)) for numbers in (at[:3, 3].tolist(), compute_roll_pitch_yaw(at[:3, :3])))
    whole = ElementTree.Element("robot", name=arm.get("name", "robot"))
    whole.extend(arm.findall("material"))
    ElementTree.SubElement(whole, "link", name=BASE_LINK)
    whole.append(_stand(arm, xyz, rpy))
    whole.extend([*arm.findall("link"), *arm.findall("joint")])
    hand = hand or _find_longest(whole)
    chain, everything = _find_chain(whole, hand)
    free = {joint.name: joint for joint in everything if joint.kind in MOVING and joint.mimic is None}
    names = [joint.name for joint in chain if joint.name in free] if joints is None else list(joints)
    unknown = [name for name in (*names, *(home or {})) if name not in free]
    if unknown:
        raise RobotError(f"no independent moving joint {unknown[0]!r} in the URDF; valid are {', '.join(free)}")
    if not names or len({*names}) < len(names):
        raise RobotError(f"joints must name each planned joint once, got {names}")
    for name, value in (home or {}).items():
        low, high = (-math.inf, math.inf) if free[name].kind == "continuous" else (free[name].low, free[name].high)
        if not (math.isfinite(value) and low - 1e-9 <= value <= high + 1e-9):
            raise RobotError(f"home: joint {name!r} must be from {low:g} to {high:g}, got {value!r}")
    return _make_robot(whole, hand, chain, everything, [free[name] for name in names], RobotConfig().joint_step_deg,
                       home or {})


def _find_longest(whole: ElementTree.Element) -> str:
    """Return the first link that as many independent joints move as any."""
    above = map_joints(whole)

    def count(link: str) -> int:
        return sum(joint.get("type") in MOVING and joint.find("mimic") is None for joint in climb(above, link))

    return max((link.get("name", "") for link in whole.findall("link")), key=count)


def _joint(name: str, kind: str, parent: str, child: str, xyz: str, axis: str = "",
           limit: float = 0.0, rpy: str = "0 0 0") -> ElementTree.Element:
    inside = ""
    if axis:
        limits = f'lower="{-limit!r}" upper="{limit!r}" effort="500" velocity="10"'
        inside = f'<axis xyz="{axis}"/><limit {limits}/>'
    return ElementTree.fromstring(
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/>{inside}</joint>'
    )


def _make_arm(config: RobotConfig) -> ElementTree.Element:
    """Make the generated arm: links in a row along x, with joints about the axes of `_ARM_AXES`."""
    arm = ElementTree.Element("robot", name="arm")
    if not config.joints:
        return arm
    length = config.link_length
    thickness = min(0.05, length / 4)
    limit = math.radians(config.joint_limit_deg)
    arm.append(ElementTree.fromstring('<link name="shoulder"/>'))
    parent, xyz = "shoulder", "0 0 0"
    for i in range(config.joints):
        link = f"arm-{i + 1}"
        arm.append(_joint(f"joint-{i + 1}", "revolute", parent, link, xyz, _ARM_AXES[i], limit))
        middle, lying = f"{length / 2!r} 0 0", f"0 {math.pi / 2!r} 0"
        arm.append(make_cylinder_link(link, 0.5, thickness, length, middle, lying))
        parent, xyz = link, f"{length!r} 0 0"
    arm.append(ElementTree.fromstring(f'<link name="{_HAND}"/>'))
    arm.append(_joint("wrist", "fixed", parent, _HAND, xyz))
    return arm


def _mount(config: RobotConfig, arm: ElementTree.Element) -> ElementTree.Element:
    whole = ElementTree.Element("robot", name="escape-robot")
    for material in arm.findall("material"):
        whole.append(material)
    whole.append(config.base.make_link(BASE_LINK, 50.0, config.body_height))
    if arm.find("link") is not None:
        whole.append(_stand(arm, f"{config.mount_forward!r} 0 {config.body_height!r}"))
        whole.extend([*arm.findall("link"), *arm.findall("joint")])
    return whole


def _stand(arm: ElementTree.Element, xyz: str, rpy: str = "0 0 0") -> ElementTree.Element:
    """Make the joint by which an arm stands on the base."""
    links = {link.get("name", "") for link in arm.findall("link")}
    children = {child.get("link") for child in arm.iterfind("joint/child")}
    roots = sorted(links - children)
    if len(roots) != 1:
        raise RobotError(f"the arm's URDF must have one root link, got {roots or 'a circle of joints'}")
    taken = [name for name in (BASE_LINK, _MOUNT_JOINT) if arm.find(f"*[@name='{name}']") is not None]
    if taken:
        raise RobotError(f"the arm's URDF uses the name {taken[0]!r}, which the mobile base uses. Rename it")
    return _joint(_MOUNT_JOINT, "fixed", BASE_LINK, roots[0], xyz, rpy=rpy)


def _read_joint(element: ElementTree.Element) -> tuple[str, _Joint]:
    """Return a joint and the name of its parent link."""
    name, kind = element.get("name", ""), element.get("type", "fixed")
    if kind not in ("fixed", *MOVING):
        raise RobotError(f"joint {name!r} of the URDF is {kind!r}; valid are fixed, {', '.join(MOVING)}")
    placement = np.eye(4)
    placement[:3, :3] = make_rotation(*_read_vector(element, "origin", "rpy", "0 0 0").tolist())
    placement[:3, 3] = _read_vector(element, "origin", "xyz", "0 0 0")
    axis = _read_vector(element, "axis", "xyz", "1 0 0")
    if kind != "fixed":
        length = float(np.linalg.norm(axis))
        if length == 0.0:
            raise RobotError(f"joint {name!r} of the URDF has the axis 0 0 0; give it a direction, such as 0 0 1")
        axis = axis / length
    low, high = -math.pi, math.pi
    limit = element.find("limit")
    if kind in ("revolute", "prismatic"):
        if limit is None:
            raise RobotError(f"joint {name!r} of the URDF is {kind} and has no <limit>. Add one"
                             + (', or make it type="continuous"' if kind == "revolute" else ""))
        low, high = (_read_limit(name, limit, side) for side in ("lower", "upper"))
        if not low <= high:
            raise RobotError(f"joint {name!r} of the URDF: lower limit {low:g} is above upper {high:g}")
    speed, effort = (math.inf if limit is None else _read_limit(name, limit, what) or math.inf
                     for what in ("velocity", "effort"))
    if min(speed, effort) < 0.0:
        raise RobotError(f"joint {name!r} of the URDF: limits of velocity and effort are numbers from 0 (none) up")
    parent = element.find("parent")
    above = parent.get("link", "") if parent is not None else ""
    return above, _Joint(name, kind, placement, axis, low, high, speed, effort, _read_mimic(element))


def _read_mimic(element: ElementTree.Element) -> tuple[str, float, float] | None:
    mimic = element.find("mimic")
    if mimic is None or element.get("type", "fixed") not in MOVING:
        return None
    name = element.get("name", "")
    factor, offset = (_read_numbers(name, mimic.get(key, default), 1)[0]
                      for key, default in (("multiplier", "1"), ("offset", "0")))
    return mimic.get("joint", ""), factor, offset


def _read_limit(joint: str, limit: ElementTree.Element, side: str) -> float:
    value = _read_numbers(joint, limit.get(side, "0"), 1, f"`{side}` of <limit>")[0]
    if side in ("lower", "upper") and abs(value) > _LARGEST_LIMIT:
        raise RobotError(f"joint {joint!r} of the URDF: `{side}` of <limit> must be within +-{_LARGEST_LIMIT:g}, got "
                         f'{value:g}. Set a finite limit, or make a joint that turns freely type="continuous"')
    return value


def _read_vector(joint: ElementTree.Element, tag: str, key: str, default: str) -> NDArray[np.float64]:
    element = joint.find(tag)
    text = default if element is None else element.get(key, default)
    return np.array(_read_numbers(joint.get("name", ""), text, 3, f"`{key}` of <{tag}>"))


def _read_numbers(joint: str, text: str, count: int, what: str = "<mimic>") -> tuple[float, ...]:
    values = read_numbers(text, count)
    if values is None:
        valid = "a finite number" if count == 1 else f"{count} finite numbers"
        raise RobotError(f"joint {joint!r} of the URDF: {what} must be {valid}, got {text!r}")
    return values


def _find_chain(whole: ElementTree.Element, hand: str) -> tuple[list[_Joint], list[_Joint]]:
    """Joints from the base to the hand, and all joints."""
    links = [link.get("name", "") for link in whole.findall("link")]
    if hand not in links:
        raise RobotError(f"robot.hand_link: no link {hand!r} in the URDF; valid are {', '.join(links)}")
    above: dict[str, tuple[str, _Joint]] = {}
    for element in whole.findall("joint"):
        child = element.find("child")
        above[child.get("link", "") if child is not None else ""] = _read_joint(element)
    chain: list[_Joint] = []
    link = hand
    while link != BASE_LINK:
        if link not in above or len(chain) > len(above):
            raise RobotError(f"robot.hand_link: no joints lead from the URDF's root link to {hand!r}")
        link, joint = above[link]
        chain.insert(0, joint)
    return chain, [joint for _, joint in above.values()]


def _assemble(config: RobotConfig, whole: ElementTree.Element, hand: str) -> Robot:
    chain, joints = _find_chain(whole, hand)
    moving = [joint for joint in chain if joint.kind in MOVING and joint.mimic is None]
    if len(moving) < config.joints:
        raise RobotError(f"robot.joints = {config.joints}: only {len(moving)} independent joints move {hand!r}")
    return _make_robot(whole, hand, chain, joints, moving[: config.joints], config.joint_step_deg, {})


def _make_robot(whole: ElementTree.Element, hand: str, chain: list[_Joint], joints: list[_Joint], used: list[_Joint],
                step_deg: float, start: Mapping[str, float]) -> Robot:
    """Make the robot of a URDF whose root is `BASE_LINK`; `start` gives positions of joints that differ from 0."""
    step = math.radians(step_deg)
    rest = {j.name: start.get(j.name, 0.0 if j.low <= 0.0 <= j.high else (j.low + j.high) / 2)
            for j in joints if j.kind in MOVING and j.mimic is None}
    home = tuple(rest.pop(joint.name) for joint in used)
    mimics = dict[str, tuple[int, float, float]]()
    for joint in joints:
        if joint.mimic is not None:
            source, factor, offset = _trace_mimic(joint, {j.name: j for j in joints})
            if source in rest:
                rest[joint.name] = factor * rest[source] + offset
            else:
                mimics[joint.name] = [j.name for j in used].index(source), factor, offset
    slack = 1e-9  # a limit that is a whole number of steps away stays reachable despite rounding
    return Robot(
        urdf=ElementTree.tostring(whole, encoding="unicode"),
        joint_names=tuple(joint.name for joint in used),
        hand_link=hand,
        home=home,
        step=step,
        step_low=tuple(math.ceil((j.low - at - slack) / step) for j, at in zip(used, home, strict=True)),
        step_high=tuple(math.floor((j.high - at + slack) / step) for j, at in zip(used, home, strict=True)),
        limits=tuple((j.low, j.high) for j in used),
        speeds=tuple(j.speed for j in used),
        efforts=tuple(j.effort for j in used),
        chain=tuple(chain),
        rest=rest,
        mimics=mimics,
        continuous=tuple(j.kind == "continuous" for j in used),
    )


def _trace_mimic(joint: _Joint, joints: dict[str, _Joint]) -> tuple[str, float, float]:
    """Return the joint that one follows in the end, multiplier and offset."""
    name, factor, offset = joint.name, 1.0, 0.0
    for _ in joints:
        mimic = joints[name].mimic
        if mimic is None:
            return name, factor, offset
        name, factor, offset = mimic[0], factor * mimic[1], factor * mimic[2] + offset
        if name not in joints or joints[name].kind not in MOVING:
            raise RobotError(f"joint {joint.name!r} of the URDF mimics {name!r}, which is no moving joint of it")
    raise RobotError(f"joint {joint.name!r} of the URDF mimics itself: its <mimic> elements form a circle")
