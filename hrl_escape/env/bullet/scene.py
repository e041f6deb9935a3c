"""An instance as bodies in a Bullet world: places, colours and collision groups.

It builds and recolours; it moves nothing and knows no rules. Kinematic rooms load the robot as
a free body that is placed; physics rooms load it on a planar carriage of three joints (x, y,
yaw) that motors drive. Metres, radians, the room frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from xml.etree import ElementTree

import pybullet

from hrl_escape.env.config import RobotConfig
from hrl_escape.env.drawing import palette
from hrl_escape.env.geometry import Solid
from hrl_escape.env.instance import PlacedProp, Rectangle, RoomInstance, Target
from hrl_escape.env.robot import BASE_LINK, Robot
from hrl_escape.files import temporary_folder

DRIVE_JOINTS = tuple(f"{BASE_LINK}-{axis}" for axis in ("x", "y", "yaw"))
HINGE_LIMIT = math.radians(120)
"""A door opens this far either way; beyond a quarter turn it stands clear of the doorway."""

_FREE, _FIXED, _GROUND = 1, 2, 4  # collision groups
_MARK = 0.005  # height of paint on the floor


@dataclass(frozen=True)
class SceneBodies:
    """PyBullet body and joint ids of a room."""

    robot: int  # body of the robot
    base_link: int  # link of the robot that is its base (-1: the root)
    base_height: float  # height of that link's centre of mass above the floor, m
    hand_link: int  # link with the hand at its origin
    drives: tuple[int, ...]  # joints x, y, yaw of the carriage (physics), else empty
    joints: tuple[int, ...]  # the joints that primitives move, in the order of the action space
    rest_joints: tuple[tuple[int, float], ...]  # the other moving joints and the angles they keep
    solids: tuple[int, ...]  # walls and obstacles, in the instance's order
    door: int | None  # the door's body, or None
    targets: tuple[int, ...]  # in the puzzle's order
    props: tuple[int, ...]  # in the puzzle's order
    inner_doors: tuple[int, ...]
    exit: int  # the coloured region on the floor
    floors: tuple[int, ...]  # the room's floor, and that of the alcove behind a door


def build_scene(client: int, instance: RoomInstance, robot: Robot) -> SceneBodies:
    """Build the room in an empty Bullet world; puzzle unsolved, everything in its first place."""
    physics = instance.dynamics.kind == "physics"
    # 0: two bodies collide only if both masks allow it; by Bullet's default one mask is enough
    pybullet.setPhysicsEngineParameter(collisionFilterMode=0, physicsClientId=client)
    floors = tuple(_add_floor(client, area) for area in palette.compute_floors(instance))
    solids = tuple(_add_solid(client, solid) for solid in instance.solids)
    door = instance.door and _add_door(client, instance, instance.door)
    targets = tuple(_add_target(client, target, physics) for target in instance.targets)
    props = tuple(_add_prop(client, placed, physics) for placed in instance.props)
    inner = tuple(_add_box(client, (door.half_x, door.half_y, door.height / 2), (door.x, door.y, door.height / 2),
                           door.yaw, palette.get_inner_colour(door))
                  for door in instance.inner_doors)
    area, (x, y) = instance.exit, instance.exit.centre
    half = (area.x_max - x, area.y_max - y, _MARK / 2)
    exit_id = _add_box(client, half, (x, y, _MARK / 2), 0.0, palette.EXIT_LOCKED)
    return SceneBodies(**_add_robot(client, instance, robot), solids=solids, door=door, targets=targets, props=props,
                       inner_doors=inner, exit=exit_id, floors=floors)


# --- looks ---------------------------------------------------------------------------------


def show_lit(client: int, target: int, is_lit: bool) -> None:
    """Switch a target's light on or off."""
    _paint(client, target, -1, palette.LIT.fill if is_lit else palette.OFF.fill)


def show_exit(client: int, scene: SceneBodies, is_open: bool) -> None:
    """Colour the exit region."""
    _paint(client, scene.exit, -1, palette.EXIT_OPEN if is_open else palette.EXIT_LOCKED)


def show_inner_door(client: int, body: int, door: Solid, is_shut: bool) -> None:
    """Show an inner door or thing in its place, or move it out of sight."""
    height = door.height / 2 if is_shut else -door.height
    pybullet.resetBasePositionAndOrientation(
        body, (door.x, door.y, height), (0.0, 0.0, math.sin(door.yaw / 2), math.cos(door.yaw / 2)),
        physicsClientId=client)


def show_door(client: int, instance: RoomInstance, door: int, is_open: bool) -> None:
    """Shut the door's leaf, or swing it outwards so that the robot passes (kinematics)."""
    angle = math.pi / 2 * instance.door_swing if is_open else 0.0
    pybullet.resetJointState(door, 0, angle, physicsClientId=client)
    pybullet.setCollisionFilterGroupMask(door, 0, _FIXED, 0 if is_open else _FREE, physicsClientId=client)


def _paint(client: int, body: int, link: int, colour: str) -> None:
    pybullet.changeVisualShape(body, link, rgbaColor=(*palette.to_rgb(colour), 1.0), physicsClientId=client)


# --- bodies --------------------------------------------------------------------------------


def _add_box(client: int, half: tuple[float, float, float], at: tuple[float, float, float], yaw: float,
             colour: str, group: int = 0, mask: int = 0, mass: float = 0.0) -> int:
    """Add a box; without a collision group it is visible only."""
    shape = -1
    if group:
        shape = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half, physicsClientId=client)
    look = pybullet.createVisualShape(pybullet.GEOM_BOX, halfExtents=half, physicsClientId=client)
    return _add_body(client, shape, look, at, yaw, colour, group, mask, mass)


def _add_body(client: int, shape: int, look: int, at: tuple[float, float, float], yaw: float, colour: str,
              group: int, mask: int, mass: float = 0.0) -> int:
    turn = (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
    body = pybullet.createMultiBody(mass, shape, look, at, turn, physicsClientId=client)
    _paint(client, body, -1, colour)
    if group:
        pybullet.setCollisionFilterGroupMask(body, -1, group, mask, physicsClientId=client)
        # Bullet's default margin rounds the corners of boxes by up to 0.4 mm
        pybullet.changeDynamics(body, -1, collisionMargin=0.0, physicsClientId=client)
    return body


def _add_floor(client: int, area: Rectangle) -> int:
    x, y = area.centre
    half = (area.x_max - x, area.y_max - y, 0.5)
    return _add_box(client, half, (x, y, -0.5), 0.0, palette.FLOOR, _GROUND, _FREE)


def _add_solid(client: int, solid: Solid) -> int:
    colour = palette.WALL if solid.role == "wall" else palette.OBSTACLE
    at = (solid.x, solid.y, solid.height / 2)
    if solid.shape == "box":
        half = (solid.half_x, solid.half_y, solid.height / 2)
        return _add_box(client, half, at, solid.yaw, colour, _FIXED, _FREE)
    shape = pybullet.createCollisionShape(pybullet.GEOM_CYLINDER, radius=solid.half_x, height=solid.height,
                                          physicsClientId=client)
    look = pybullet.createVisualShape(pybullet.GEOM_CYLINDER, radius=solid.half_x, length=solid.height,
                                      physicsClientId=client)
    return _add_body(client, shape, look, at, solid.yaw, colour, _FIXED, _FREE)


def _add_door(client: int, instance: RoomInstance, door: Solid) -> int:
    """A leaf hinged at one end of the doorway; it swings through walls, never through the robot."""
    half, middle = (door.half_x, door.half_y, door.height / 2), (door.half_x, 0.0, 0.0)
    shape = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half, collisionFramePosition=middle,
                                          physicsClientId=client)
    look = pybullet.createVisualShape(pybullet.GEOM_BOX, halfExtents=half, visualFramePosition=middle,
                                      physicsClientId=client)
    cos, sin = math.cos(door.yaw), math.sin(door.yaw)
    body = pybullet.createMultiBody(
        0.0, -1, -1, (door.x - cos * door.half_x, door.y - sin * door.half_x, door.height / 2),
        (0.0, 0.0, math.sin(door.yaw / 2), math.cos(door.yaw / 2)),
        linkMasses=[20.0], linkCollisionShapeIndices=[shape], linkVisualShapeIndices=[look],
        linkPositions=[(0.0, 0.0, 0.0)], linkOrientations=[(0.0, 0.0, 0.0, 1.0)],
        linkInertialFramePositions=[middle], linkInertialFrameOrientations=[(0.0, 0.0, 0.0, 1.0)],
        linkParentIndices=[0], linkJointTypes=[pybullet.JOINT_REVOLUTE], linkJointAxis=[(0.0, 0.0, 1.0)],
        physicsClientId=client,
    )
    pybullet.changeDynamics(body, 0, collisionMargin=0.0, jointLowerLimit=-HINGE_LIMIT, jointUpperLimit=HINGE_LIMIT,
                            physicsClientId=client)
    pybullet.setCollisionFilterGroupMask(body, 0, _FIXED, _FREE, physicsClientId=client)
    _paint(client, body, 0, palette.DOOR)
    return body


def _add_target(client: int, target: Target, physics: bool) -> int:
    """A panel: solid under physics; in kinematic rooms it collides with nothing but can be queried."""
    half = (target.half_x, target.half_y, target.half_z)
    at = (target.x, target.y, target.z)
    return _add_box(client, half, at, target.yaw, palette.OFF.fill, _FIXED, _FREE if physics else 0)


def _add_prop(client: int, placed: PlacedProp, physics: bool) -> int:
    prop = placed.prop
    if prop.kind == "plate":
        half = (prop.half_size, prop.half_size, _MARK / 2)
        return _add_box(client, half, (placed.x, placed.y, _MARK / 2), placed.yaw, palette.PLATE)
    half = (prop.half_size, prop.half_size, prop.height / 2)
    return _add_box(client, half, (placed.x, placed.y, prop.height / 2), placed.yaw, palette.PROP, _FREE,
                    _FREE | _FIXED | _GROUND if physics else 0, prop.mass if physics else 0.0)


# --- the robot -----------------------------------------------------------------------------


def _add_robot(client: int, instance: RoomInstance, robot: Robot) -> dict:
    """Load the robot and return its fields of `SceneBodies`."""
    physics = instance.dynamics.kind == "physics"
    text = _adapt_urdf(robot, instance.robot, physics)
    flags = pybullet.URDF_USE_IMPLICIT_CYLINDER | pybullet.URDF_USE_INERTIA_FROM_FILE
    with temporary_folder() as folder:
        (folder / "robot.urdf").write_text(text)
        body = pybullet.loadURDF(str(folder / "robot.urdf"), useFixedBase=physics, flags=flags, physicsClientId=client)
    links, joints, moving = {}, {}, {}
    for index in range(pybullet.getNumJoints(body, physicsClientId=client)):
        info = pybullet.getJointInfo(body, index, physicsClientId=client)
        links[info[12].decode()], joints[info[1].decode()] = index, index
        if info[2] != pybullet.JOINT_FIXED:
            moving[info[1].decode()] = index
    base, hand = links.get(BASE_LINK, -1), links.get(robot.hand_link, -1)
    if instance.robot.kind == "arm":
        for link in range(-1, len(joints)):
            _paint(client, body, link, palette.ARM)
        _paint(client, body, hand, palette.HAND)
    _paint(client, body, base, palette.BODY)
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
        "base_height": pybullet.getDynamicsInfo(body, base, physicsClientId=client)[3][2],
        "hand_link": hand,
        "drives": tuple(joints[name] for name in DRIVE_JOINTS) if physics else (),
        "joints": tuple(joints[name] for name in robot.joint_names),
        "rest_joints": rest,
    }


def _adapt_urdf(robot: Robot, config: RobotConfig, physics: bool) -> str:
    """Make the hand visible and give massless links the small mass that Bullet needs; physics adds a carriage."""
    root = ElementTree.fromstring(robot.urdf)
    for link in root.findall("link"):
        if link.find("inertial") is None:
            link.append(_make_inertial(0.05, 1e-4))
    if robot.hand_link != BASE_LINK:
        hand = next(link for link in root.findall("link") if link.get("name") == robot.hand_link)
        ball = f'<geometry><sphere radius="{config.hand_radius!r}"/></geometry>'
        hand.append(ElementTree.fromstring(f"<visual>{ball}</visual>"))
        hand.append(ElementTree.fromstring(f"<collision>{ball}</collision>"))
    if physics:
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
