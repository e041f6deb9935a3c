"""An instance as bodies in a Bullet world: places, masses and collision groups, for rigid-body physics.

It builds; it moves nothing, shows nothing and knows no rules. The robot stands on a planar carriage of three joints
(x, y, yaw) that motors drive. Metres, radians, the room frame.
"""

from __future__ import annotations

import math
import os
import sys
from dataclasses import dataclass
from xml.etree import ElementTree

import pybullet

from hrl_escape.env.config import RobotConfig
from hrl_escape.env.drawing import palette
from hrl_escape.env.geometry import Solid
from hrl_escape.env.instance import PlacedProp, Rectangle, RoomInstance, Target
from hrl_escape.env.robot import BASE_LINK, Robot
from hrl_escape.errors import UnsupportedError
from hrl_escape.files import temporary_folder

DRIVE_JOINTS = tuple(f"{BASE_LINK}-{axis}" for axis in ("x", "y", "yaw"))
HINGE_LIMIT = math.radians(120)
"""A door opens this far either way; beyond a quarter turn it stands clear of the doorway."""

_FREE, _FIXED, _GROUND = 1, 2, 4  # collision groups


def connect(window: bool = False) -> int:
    """Open a physics client; returns pybullet's number of it.

    Raises:
        UnsupportedError: a window without a display, or too many clients in this process.
    """
    if window and sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        raise UnsupportedError("Bullet's window needs a display (DISPLAY is not set); use pictures (rgb_array) instead")
    client = pybullet.connect(pybullet.GUI if window else pybullet.DIRECT)
    if client < 0:
        raise UnsupportedError("Bullet gives no further physics client; close rooms that are no longer used")
    return client


def disconnect(client: int) -> None:
    """Free a physics client, if it is there yet."""
    if pybullet.isConnected(client):
        pybullet.disconnect(client)


@dataclass(frozen=True)
class SceneBodies:
    """PyBullet body and joint ids of a room."""

    robot: int  # body of the robot
    base_link: int  # link of the robot that is its base
    hand_link: int  # link with the hand at its origin
    drives: tuple[int, ...]  # joints x, y, yaw of the carriage
    joints: tuple[int, ...]  # the joints that primitives move, in the order of the action space
    rest_joints: tuple[tuple[int, float], ...]  # the other moving joints and the angles they keep
    solids: tuple[int, ...]  # walls and obstacles, in the instance's order
    door: int | None  # the door's body, or None
    targets: tuple[int, ...]  # in the puzzle's order
    blocks: tuple[tuple[int, int], ...]  # body of each block, and its number among the props
    floors: tuple[int, ...]  # the room's floor, and that of the alcove behind a door


def build_scene(client: int, instance: RoomInstance, robot: Robot) -> SceneBodies:
    """Build the room in an empty Bullet world, everything in its first place."""
    # 0: two bodies collide only if both masks allow it; by Bullet's default one mask is enough
    pybullet.setPhysicsEngineParameter(collisionFilterMode=0, physicsClientId=client)
    floors = tuple(_add_floor(client, area) for area in palette.compute_floors(instance))
    solids = tuple(_add_solid(client, solid) for solid in instance.solids)
    door = instance.door and _add_door(client, instance.door)
    targets = tuple(_add_target(client, target) for target in instance.targets)
    blocks = tuple((_add_block(client, placed), number) for number, placed in enumerate(instance.props)
                   if placed.prop.kind == "block")
    return SceneBodies(**_add_robot(client, instance, robot), solids=solids, door=door, targets=targets, blocks=blocks,
                       floors=floors)


def _add_box(client: int, half: tuple[float, float, float], at: tuple[float, float, float], yaw: float, group: int,
             mask: int, mass: float = 0.0) -> int:
    shape = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half, physicsClientId=client)
    return _add_body(client, shape, at, yaw, group, mask, mass)


def _add_body(client: int, shape: int, at: tuple[float, float, float], yaw: float, group: int, mask: int,
              mass: float = 0.0) -> int:
    turn = (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
    body = pybullet.createMultiBody(mass, shape, -1, at, turn, physicsClientId=client)
    pybullet.setCollisionFilterGroupMask(body, -1, group, mask, physicsClientId=client)
    # Bullet's default margin rounds the corners of boxes by up to 0.4 mm
    pybullet.changeDynamics(body, -1, collisionMargin=0.0, physicsClientId=client)
    return body


def _add_floor(client: int, area: Rectangle) -> int:
    x, y = area.centre
    half = (area.x_max - x, area.y_max - y, 0.5)
    return _add_box(client, half, (x, y, -0.5), 0.0, _GROUND, _FREE)


def _add_solid(client: int, solid: Solid) -> int:
    at = (solid.x, solid.y, solid.height / 2)
    if solid.shape == "box":
        return _add_box(client, (solid.half_x, solid.half_y, solid.height / 2), at, solid.yaw, _FIXED, _FREE)
    shape = pybullet.createCollisionShape(pybullet.GEOM_CYLINDER, radius=solid.half_x, height=solid.height,
                                          physicsClientId=client)
    return _add_body(client, shape, at, solid.yaw, _FIXED, _FREE)


def _add_door(client: int, door: Solid) -> int:
    """A leaf hinged at one end of the doorway; it swings through walls, never through the robot."""
    half, middle = (door.half_x, door.half_y, door.height / 2), (door.half_x, 0.0, 0.0)
    shape = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half, collisionFramePosition=middle,
                                          physicsClientId=client)
    cos, sin = math.cos(door.yaw), math.sin(door.yaw)
    body = pybullet.createMultiBody(
        0.0, -1, -1, (door.x - cos * door.half_x, door.y - sin * door.half_x, door.height / 2),
        (0.0, 0.0, math.sin(door.yaw / 2), math.cos(door.yaw / 2)),
        linkMasses=[20.0], linkCollisionShapeIndices=[shape], linkVisualShapeIndices=[-1],
        linkPositions=[(0.0, 0.0, 0.0)], linkOrientations=[(0.0, 0.0, 0.0, 1.0)],
        linkInertialFramePositions=[middle], linkInertialFrameOrientations=[(0.0, 0.0, 0.0, 1.0)],
        linkParentIndices=[0], linkJointTypes=[pybullet.JOINT_REVOLUTE], linkJointAxis=[(0.0, 0.0, 1.0)],
        physicsClientId=client,
    )
    pybullet.changeDynamics(body, 0, collisionMargin=0.0, jointLowerLimit=-HINGE_LIMIT, jointUpperLimit=HINGE_LIMIT,
                            physicsClientId=client)
    pybullet.setCollisionFilterGroupMask(body, 0, _FIXED, _FREE, physicsClientId=client)
    return body


def _add_target(client: int, target: Target) -> int:
    half, at = (target.half_x, target.half_y, target.half_z), (target.x, target.y, target.z)
    return _add_box(client, half, at, target.yaw, _FIXED, _FREE)


def _add_block(client: int, placed: PlacedProp) -> int:
    prop = placed.prop
    half = (prop.half_size, prop.half_size, prop.height / 2)
    return _add_box(client, half, (placed.x, placed.y, prop.height / 2), placed.yaw, _FREE, _FREE | _FIXED | _GROUND,
                    prop.mass)


# --- the robot -----------------------------------------------------------------------------


def _add_robot(client: int, instance: RoomInstance, robot: Robot) -> dict:
    """Load the robot and return its fields of `SceneBodies`."""
    flags = pybullet.URDF_USE_IMPLICIT_CYLINDER | pybullet.URDF_USE_INERTIA_FROM_FILE
    with temporary_folder() as folder:
        (folder / "robot.urdf").write_text(_adapt_urdf(robot, instance.robot))
        body = pybullet.loadURDF(str(folder / "robot.urdf"), useFixedBase=True, flags=flags, physicsClientId=client)
    links, joints, moving = {}, {}, {}
    for index in range(pybullet.getNumJoints(body, physicsClientId=client)):
        info = pybullet.getJointInfo(body, index, physicsClientId=client)
        links[info[12].decode()], joints[info[1].decode()] = index, index
        if info[2] != pybullet.JOINT_FIXED:
            moving[info[1].decode()] = index
    base = links[BASE_LINK]
    pybullet.changeDynamics(body, base, collisionMargin=0.0, physicsClientId=client)
    # the arm may lean on the ground; the carriage bears the base, whose own friction would count twice
    for link in range(-1, len(joints)):
        mask = _FREE | _FIXED | (0 if link == base else _GROUND)
        pybullet.setCollisionFilterGroupMask(body, link, _FREE, mask, physicsClientId=client)
    rest = tuple((index, robot.rest[name]) for name, index in moving.items() if name in robot.rest)
    for index, angle in rest:
        pybullet.resetJointState(body, index, angle, physicsClientId=client)
    return {
        "robot": body,
        "base_link": base,
        "hand_link": links[robot.hand_link],
        "drives": tuple(joints[name] for name in DRIVE_JOINTS),
        "joints": tuple(joints[name] for name in robot.joint_names),
        "rest_joints": rest,
    }


def _adapt_urdf(robot: Robot, config: RobotConfig) -> str:
    """Make the hand solid, give massless links the small mass that Bullet needs, and add the carriage."""
    root = ElementTree.fromstring(robot.urdf)
    for link in root.findall("link"):
        if link.find("inertial") is None:
            link.append(_make_inertial(0.05, 1e-4))
    if robot.hand_link != BASE_LINK:
        hand = next(link for link in root.findall("link") if link.get("name") == robot.hand_link)
        ball = f'<geometry><sphere radius="{config.hand_radius!r}"/></geometry>'
        hand.append(ElementTree.fromstring(f"<collision>{ball}</collision>"))
    _add_carriage(root)
    return ElementTree.tostring(root, encoding="unicode")


def _add_carriage(root: ElementTree.Element) -> None:
    names = (*(f"{BASE_LINK}-carriage-{number}" for number in range(3)), BASE_LINK)
    for name in names[:3]:
        link = ElementTree.SubElement(root, "link", name=name)
        link.append(_make_inertial(1.0, 1.0))
    kinds = (("prismatic", "1 0 0"), ("prismatic", "0 1 0"), ("continuous", "0 0 1"))
    for name, (kind, axis), parent, child in zip(DRIVE_JOINTS, kinds, names, names[1:], strict=False):
        root.append(ElementTree.fromstring(
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<axis xyz="{axis}"/><limit lower="-1e6" upper="1e6" effort="1e6" velocity="1e3"/></joint>'
        ))


def _make_inertial(mass: float, inertia: float) -> ElementTree.Element:
    return ElementTree.fromstring(
        f'<inertial><mass value="{mass!r}"/>'
        f'<inertia ixx="{inertia!r}" iyy="{inertia!r}" izz="{inertia!r}" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
