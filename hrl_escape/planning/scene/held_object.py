"""An object in the hand as one more link of the robot's URDF, which every engine and planner loads."""

from __future__ import annotations

import dataclasses
import math
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.config import RobotConfig
from hrl_escape.env.geometry import Solid
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.robot import BASE_LINK, make_robot

__all__ = ["HeldObject", "give_to_hand", "grip"]

DENSITY = 100.0
"""Mass of a held object per volume, kg / m^3: a light box."""


@dataclasses.dataclass(frozen=True, eq=False)
class HeldObject:
    """An obstacle that a hand holds.

    Attributes:
        name: its name in the scene.
        solid: the obstacle as it stood.
        placement: its centre in the frame of the hand's link, shape (4, 4).
        robot: the robot with an empty hand.
    """

    name: str
    solid: Solid
    placement: NDArray[np.float64]
    robot: RobotConfig

    def put_down(self, rules: Kinematics, state: RoomState) -> Solid:
        """The obstacle on the floor below its place in a state; rules are those of the room where it is held."""
        at = _place_hand(rules, state) @ self.placement
        return dataclasses.replace(self.solid, x=float(at[0, 3]), y=float(at[1, 3]),
                                   yaw=math.atan2(at[1, 0], at[0, 0]))


def grip(name: str, solid: Solid, rules: Kinematics, state: RoomState) -> HeldObject:
    """Describe an obstacle as held by the hand in a state."""
    at = np.eye(4)
    at[:2, :2] = [[math.cos(solid.yaw), -math.sin(solid.yaw)], [math.sin(solid.yaw), math.cos(solid.yaw)]]
    at[:3, 3] = solid.x, solid.y, solid.height / 2
    return HeldObject(name, solid, np.linalg.inv(_place_hand(rules, state)) @ at, rules.instance.robot)


def give_to_hand(robot: RobotConfig, held: HeldObject) -> RobotConfig:
    """The robot with an object fixed to its hand, as a URDF of its own."""
    made = make_robot(robot)
    whole = ElementTree.fromstring(made.urdf)
    for joint in whole.findall("joint"):
        parent = joint.find("parent")
        if parent is not None and parent.get("link") == BASE_LINK:
            whole.remove(joint)
    for link in whole.findall("link"):
        if link.get("name") == BASE_LINK:
            whole.remove(link)
    solid, name = held.solid, f"held-{held.name}"
    if solid.shape == "cylinder":
        shape, volume = f'<cylinder radius="{solid.half_x!r}" length="{solid.height!r}"/>', math.pi * solid.half_x**2
    else:
        shape = f'<box size="{2 * solid.half_x!r} {2 * solid.half_y!r} {solid.height!r}"/>'
        volume = 4 * solid.half_x * solid.half_y
    mass = DENSITY * volume * solid.height
    inertia = mass * (solid.half_x**2 + solid.half_y**2 + (solid.height / 2) ** 2) / 3
    x, y, z = held.placement[:3, 3].tolist()
    roll, pitch, yaw = _compute_angles(held.placement[:3, :3])
    whole.append(ElementTree.fromstring(
        f'<link name="{name}"><inertial><mass value="{mass!r}"/><inertia ixx="{inertia!r}" iyy="{inertia!r}" '
        f'izz="{inertia!r}" ixy="0" ixz="0" iyz="0"/></inertial><visual><geometry>{shape}</geometry></visual>'
        f"<collision><geometry>{shape}</geometry></collision></link>"))
    whole.append(ElementTree.fromstring(
        f'<joint name="{name}-grip" type="fixed"><parent link="{made.hand_link}"/><child link="{name}"/>'
        f'<origin xyz="{x!r} {y!r} {z!r}" rpy="{roll!r} {pitch!r} {yaw!r}"/></joint>'))
    text = ElementTree.tostring(whole, encoding="unicode")
    return dataclasses.replace(robot, kind="urdf", urdf=text, hand_link=made.hand_link)


def _place_hand(rules: Kinematics, state: RoomState) -> NDArray[np.float64]:
    """Placement of the hand's link in the room, shape (4, 4)."""
    from hrl_escape.planning.arm.model import ArmKinematics  # loads Pinocchio

    cos, sin = rules.get_rotation(state.heading_steps, state.heading_offset)
    base = np.eye(4)
    base[:2, :2], base[:3, 3] = [[cos, -sin], [sin, cos]], (state.x, state.y, state.z)
    return base @ ArmKinematics(rules.robot).compute_placement(rules.get_angles(state))


def _compute_angles(turn: NDArray[np.float64]) -> tuple[float, float, float]:
    """Roll, pitch and yaw of a rotation as URDF means them (turn = Rz Ry Rx), rad."""
    pitch = math.atan2(-turn[2, 0], math.hypot(turn[0, 0], turn[1, 0]))
    if math.cos(pitch) < 1e-9:
        return 0.0, pitch, math.atan2(-turn[0, 1], turn[1, 1])
    return math.atan2(turn[2, 1], turn[2, 2]), pitch, math.atan2(turn[1, 0], turn[0, 0])
