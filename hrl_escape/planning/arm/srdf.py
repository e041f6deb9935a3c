"""SRDF, MoveIt's description of an arm: pairs of links that may touch, and named postures."""

from __future__ import annotations

import itertools
import math
import warnings
from collections import Counter, deque
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from hrl_escape.env.robot import MOVING, Robot
from hrl_escape.env.urdf import LARGEST_URDF, climb, find_xacro, is_xml, map_joints, parse_xml
from hrl_escape.errors import ConfigError, FileReadError
from hrl_escape.files import read_bytes

_SLACK = 1e-3  # rad or m that a posture may be beyond a limit, from which it is brought back
_MOST_PAIRS = 100_000  # of links that are off by default, which are written out


class ArmGroup(NamedTuple):
    """Planned joints by name, and the link at their end; the joints are None for all that move that link."""

    joints: tuple[str, ...] | None
    tip: str


def read_srdf(source: str | Path, robot: Robot) -> tuple[str, dict[str, tuple[float, ...]]]:
    """Read an SRDF, its text or path.

    Args:
        source: text or path.
        robot: the robot whose planned joints the postures are for.

    Returns:
        The text, with `disable_default_collisions` written out as pairs; and joint angles, rad, of the group states
        that name a planned joint. Joints that a state leaves out are at home. A name that several groups use becomes
        `group/name`. A state with an angle that is not a number or is beyond the joint's limits is left out with
        a warning.

    Raises:
        ConfigError: there is no such file, or it is not an SRDF, or belongs to another robot, or too many pairs are off
            by default.
    """
    root, where = _parse(source)
    links = {link.get("name", "") for link in ElementTree.fromstring(robot.urdf).findall("link")}
    named = {pair.get(end, "") for pair in root.iter("disable_collisions") for end in ("link1", "link2")}
    if named and not named & links:
        raise ConfigError("srdf", where, f"the SRDF of this robot: none of its links, such as {sorted(named)[0]!r}, is "
                                         "in the URDF")
    _write_out_defaults(root, sorted(links))
    return ElementTree.tostring(root, encoding="unicode"), _read_postures(root, robot)


def find_group(source: str | Path, urdf: ElementTree.Element, name: str = "") -> ArmGroup | None:
    """Find a planning group in an SRDF: the chain to its tip, or its joints, those of its links and groups included.

    Args:
        source: text or path.
        urdf: the robot's URDF.
        name: name of the group; empty for the joints that move the link which carries the only end effector.

    Returns:
        The group; None if no name is given and there is not exactly one end effector.

    Raises:
        ConfigError: there is no such group, or it moves nothing.
    """
    root, _ = _parse(source)
    if not name:
        ends = [end.get("parent_link", "") for end in root.findall("end_effector")]
        return ArmGroup(None, ends[0]) if len(ends) == 1 else None
    groups = {group.get("name", ""): group for group in root.findall("group") if len(group)}
    if name not in groups:
        raise ConfigError("group", name, f"a group of the SRDF: {', '.join(groups)}")
    above = map_joints(urdf)
    names, tips, parts = list[str](), list[str](), deque(groups.pop(name))
    while parts:
        part = parts.popleft()
        if part.tag == "group":
            parts.extendleft(reversed(groups.pop(part.get("name", ""), ())))  # once, as groups may form a circle
        elif part.tag == "chain":
            tips.append(part.get("tip_link", ""))
            names.extend(joint.get("name", "")
                         for joint in reversed(list(climb(above, tips[-1], part.get("base_link", "")))))
        elif part.tag == "joint":
            names.append(part.get("name", ""))
        elif part.tag == "link" and part.get("name") in above:
            names.append(above[part.get("name", "")].get("name", ""))
    moving = [joint.get("name", "") for joint in urdf.findall("joint")
              if joint.get("type") in MOVING and joint.find("mimic") is None]
    joints = tuple(joint for joint in dict.fromkeys(names) if joint in moving)
    if not joints:
        raise ConfigError("group", name, "a group that has moving joints of the URDF")
    ends = {joint.get("name"): link for link, joint in above.items()}
    return ArmGroup(joints, tips[-1] if tips else ends[joints[-1]])


def _parse(source: str | Path) -> tuple[ElementTree.Element, str]:
    """Return the root of an SRDF, its text or path, and a name for messages."""
    is_text = is_xml(source)
    where = "the text given" if is_text else str(source)[:200]
    try:
        root = parse_xml(str(source) if is_text else read_bytes(source, "SRDF", LARGEST_URDF))
    except (FileReadError, ValueError, LookupError, ElementTree.ParseError) as error:
        raise ConfigError("srdf", where, f"an SRDF, its text or path: {error}") from None
    xacro = find_xacro(root)
    if xacro is not None:
        raise ConfigError("srdf", where, f"an expanded SRDF: it contains {xacro}. Run `xacro FILE > robot.srdf`")
    if root.tag != "robot":
        raise ConfigError("srdf", root.tag, "an SRDF, whose root is <robot>")
    if any(joint.find("parent") is not None for joint in root.findall("joint")):
        raise ConfigError("srdf", where, "an SRDF: this is a URDF")
    return root, where


def _write_out_defaults(root: ElementTree.Element, links: list[str]) -> None:
    """Add the pairs of links whose collisions are off by default, but for those that are enabled."""
    off = {element.get("link", "") for element in root.findall("disable_default_collisions")}
    if len(off.intersection(links)) * len(links) > _MOST_PAIRS:
        raise ConfigError("srdf", f"{len(off):,} of {len(links):,} links off by default", f"at most {_MOST_PAIRS:,} "
                          "pairs of links. Write <disable_collisions> for the pairs that may touch")
    enabled = {frozenset((pair.get("link1"), pair.get("link2"))) for pair in root.findall("enable_collisions")}
    for first, second in itertools.combinations(links, 2):
        if (first in off or second in off) and frozenset((first, second)) not in enabled:
            ElementTree.SubElement(root, "disable_collisions", link1=first, link2=second, reason="Default")


def _read_postures(root: ElementTree.Element, robot: Robot) -> dict[str, tuple[float, ...]]:
    found = list[tuple[str, str, tuple[float, ...]]]()
    for state in root.findall("group_state"):
        angles = dict(zip(robot.joint_names, robot.home, strict=True))
        planned = [joint for joint in state.findall("joint") if joint.get("name") in angles]
        read = {joint.get("name", ""): _read_angle(joint, robot) for joint in planned}
        angles |= read
        wrong = [name for name, angle in read.items() if math.isnan(angle)]
        if wrong:
            low, high = robot.limits[robot.joint_names.index(wrong[0])]
            warnings.warn(f"SRDF: the group state {state.get('name', '')!r} is left out: the angle of joint "
                          f"{wrong[0]!r} must be from {low:g} to {high:g} rad", RuntimeWarning, stacklevel=4)
        elif planned:
            found.append((state.get("group", ""), state.get("name", ""), tuple(angles.values())))
    uses = Counter(name for _, name, _ in found)
    return {name if uses[name] == 1 else f"{group}/{name}": angles for group, name, angles in found}


def _read_angle(joint: ElementTree.Element, robot: Robot) -> float:
    """Angle of a joint in a group state, or NaN if it is not a number or is beyond the limits."""
    name, text = joint.get("name", ""), joint.get("value", "")
    number = robot.joint_names.index(name)
    low, high = robot.limits[number]
    try:
        angle = float(text)
    except ValueError:
        angle = math.nan
    if robot.continuous[number] and math.isfinite(angle):
        return angle
    return min(max(angle, low), high) if low - _SLACK <= angle <= high + _SLACK else math.nan
