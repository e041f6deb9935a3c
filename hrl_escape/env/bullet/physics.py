"""Physics dynamics: primitives executed by Bullet's rigid bodies, in sub-steps of 1/240 s.

The base is on a planar carriage (it does not tip) whose velocities follow a trapezoid profile. Position motors move the
joints. Walls, panels, blocks, the door and the arm are solid. A primitive lasts as long as its motion takes at 1 m/s or
90 degrees per second, at least 0.25 s, and 0.1 s more to settle. A push into a solid stops or slides along it, and
displacements are therefore only approximately nominal. A base that wedges itself deeper into something in the sub-steps
of one motion stops. A target counts as touched once the presser pushes against it with `PRESS_FORCE`, until the presser
leaves the press margin. `Rules` provides puzzle, reward and exit.

At the end of a primitive, everything that Bullet carries to the next is written out as numbers (`PhysicsState`). At the
beginning of the next it is written back, without cached contacts. A transition is therefore a pure function of
instance, state and action: states can be stored, compared, and continued bit for bit in any room of the same instance,
in any process. Metres, radians, the room frame.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

from hrl_escape.env.bullet import connect, disconnect, pybullet
from hrl_escape.env.config import RobotConfig
from hrl_escape.env.geometry import Solid
from hrl_escape.env.instance import PlacedProp, Rectangle, RoomInstance, Start, compute_floors
from hrl_escape.env.kinematics import Glide, RoomState, Rules, Transition
from hrl_escape.env.mesh_files import write_meshes
from hrl_escape.env.noise import compute_noise
from hrl_escape.env.poses import get_planar_pose
from hrl_escape.env.primitives import Primitive
from hrl_escape.env.robot import BASE_LINK, Robot
from hrl_escape.env.urdf import drop_shapes
from hrl_escape.errors import StateError, UnsupportedError, show_value
from hrl_escape.files import temporary_folder

RATE = 240
"""Sub-steps of Bullet per second of simulated time."""
PRESS_FORCE = 5.0
"""A target is pressed when the presser pushes against it with this normal force, N."""
DRIVE_JOINTS = tuple(f"{BASE_LINK}-{axis}" for axis in ("x", "y", "yaw"))
HINGE_LIMIT = math.radians(120)
"""Largest angle of a door either way. Beyond a quarter turn the door is clear of the doorway."""

_SPEED, _TURN_SPEED = 1.0, math.pi / 2  # mean speed of the base, m/s, and of turns and joints, rad/s
_SHORTEST, _SETTLE = 0.25, 0.1  # shortest motion, and the time to come to rest after it, s
_RAMP = 0.2  # fraction of a motion for acceleration, and again for deceleration
_ACCELERATION = 20.0  # largest push of the carriage per robot mass, m/s^2; turning torques assume a lever of 1 m
_LIMIT_SLACK = 1e-3  # largest offset of a joint from its lattice at its limit, rad
_JOINT_EFFORT = 500.0  # N m, if the URDF states none
_HINGE_FRICTION, _HINGE_CLOSER, _HINGE_LOCK = 2.0, 200.0, 1e4  # N m
_CLOSING_SPEED = 0.5  # rad/s
_LOCKED_WITHIN = math.radians(2)
_WEDGED = 5e-3  # m
_FRICTION = 0.8  # of blocks and floor
_POSITION_GAIN = 0.3  # fraction of a joint's error that its motor corrects in one sub-step
_AT_REST = 0.01  # m/s and rad/s; a slower block without contacts stays in place
_AWAY = 1000.0  # m; far from every contact
_FREE, _FIXED, _GROUND = 1, 2, 4  # collision groups
_UPRIGHT = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class SceneBodies:
    """PyBullet ids of the bodies and joints of a room."""

    robot: int  # body of the robot
    base_link: int  # base link of the robot
    hand_link: int  # link whose origin is the hand
    drives: tuple[int, ...]  # joints x, y, yaw of the carriage
    joints: tuple[int, ...]  # joints that primitives move, in the order of the action space
    rest_joints: tuple[tuple[int, float], ...]  # other moving joints with their constant angles
    mimics: tuple[tuple[int, int, float, float], ...]  # joints that follow one of `joints`: its number, factor, offset
    solids: tuple[int, ...]  # walls and obstacles, in the instance's order
    door: int | None  # exit door, or None
    targets: tuple[int, ...]  # targets, in the puzzle's order
    blocks: tuple[tuple[int, int], ...]  # body of each block, and its index among the props
    floors: tuple[int, ...]  # floors of the room and of the alcove behind a door


class PhysicsState(NamedTuple):
    """Bullet's part of a state, in addition to the pose in `RoomState`: plain hashable numbers."""

    drive_velocities: tuple[float, float, float]  # velocity of the base along x and y, m/s, and about z, rad/s
    joint_velocities: tuple[float, ...]  # velocities of the joints that primitives move, rad/s
    door: tuple[float, ...]  # angle of the hinge, rad, and its velocity, rad/s; empty without a door
    props: tuple[tuple[float, ...], ...]
    """Position (3), quaternion x y z w (4), velocity (3) and angular velocity (3) of each prop, in the room frame."""


class PhysicsDynamics:
    """Rigid-body dynamics of one room in its own world: pybullet's `client`, and the ids of its `scene`.

    Raises:
        UnsupportedError: the robot has a gripper, or too many rooms in this process have a client.
    """

    def __init__(self, rules: Rules) -> None:
        if rules.instance.robot.gripper:
            raise UnsupportedError(f"{rules.instance.name!r} needs a gripper, which dynamics.kind = 'physics' does not "
                                   "support. Set dynamics.kind = 'kinematic'")
        self.client = client = connect()
        self.close = weakref.finalize(self, disconnect, client)
        self.scene = scene = build_scene(client, rules.instance, rules.robot)
        self._rules, self._instance = rules, rules.instance
        self._reach = rules.instance.reach_x, rules.instance.reach_y
        self._targets = {body: number for number, body in enumerate(scene.targets)}
        if scene.door is not None:
            self._door_pose = pybullet.getBasePositionAndOrientation(scene.door, physicsClientId=client)
        self._by_hand = self._instance.dynamics.press_with == "hand"
        self._hand_reach = self._instance.robot.hand_radius + self._instance.dynamics.press_margin
        self._touches: set[tuple[int, int]] = set()
        self._configure()

    def _configure(self) -> None:
        client, scene = self.client, self.scene
        pybullet.setGravity(0.0, 0.0, -9.81, physicsClientId=client)
        # Sorted pairs make contacts independent of history. Without inner iterations Bullet solves the motors only
        # once as soon as there is a contact, and a loaded arm sags by degrees.
        pybullet.setPhysicsEngineParameter(fixedTimeStep=1 / RATE, deterministicOverlappingPairs=1,
                                           numNonContactInnerIterations=5, physicsClientId=client)
        mass = 0.0
        for link in range(-1, pybullet.getNumJoints(scene.robot, physicsClientId=client)):
            pybullet.changeDynamics(scene.robot, link, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0,
                                    physicsClientId=client)
            mass += pybullet.getDynamicsInfo(scene.robot, link, physicsClientId=client)[0]
        force = mass * _ACCELERATION
        self._drive_forces = (force, force, force)
        efforts = (pybullet.getJointInfo(scene.robot, joint, physicsClientId=client)[10] for joint in scene.joints)
        self._efforts = tuple(effort or _JOINT_EFFORT for effort in efforts)
        for body in (*(body for body, _ in self.scene.blocks), *scene.floors):
            pybullet.changeDynamics(body, -1, lateralFriction=_FRICTION, physicsClientId=client)
        for joint, angle in scene.rest_joints:
            pybullet.setJointMotorControl2(scene.robot, joint, pybullet.POSITION_CONTROL, targetPosition=angle,
                                           force=_JOINT_EFFORT, physicsClientId=client)

    # --- states ----------------------------------------------------------------------------

    def make_state(self, start: Start, noise_key: int = 0) -> RoomState:
        """Return the state at the beginning of an episode: everything at rest in its initial pose."""
        return self._rules.make_state(start, noise_key)._replace(physics=self._make_rest())

    def _make_rest(self) -> PhysicsState:
        door = (0.0, 0.0) if self.scene.door is not None else ()
        props = tuple(
            (p.x, p.y, p.prop.height / 2 if p.prop.kind == "block" else 0.0,
             0.0, 0.0, math.sin(p.yaw / 2), math.cos(p.yaw / 2), *(0.0,) * 6)
            for p in self._instance.props
        )
        return PhysicsState((0.0, 0.0, 0.0), (0.0,) * len(self.scene.joints), door, props)

    def check_state(self, state: RoomState) -> None:
        """Raise `StateError` unless the `physics` of a state fits this room.

        Raises:
            StateError: it has other parts, or numbers that are not finite.
        """
        if state.physics is None:
            return
        rest = self._make_rest()
        try:
            physics = PhysicsState(*state.physics)
            pairs = [(physics.drive_velocities, rest.drive_velocities),
                     (physics.joint_velocities, rest.joint_velocities), (physics.door, rest.door),
                     *zip(physics.props, rest.props, strict=True)]
            fits = all(len(mine) == len(theirs) and all(abs(number) < _AWAY for number in mine)
                       for mine, theirs in pairs)
        except (TypeError, ValueError):
            fits = False
        if not fits:
            raise StateError(f"physics = {show_value(state.physics)} is not possible: finite numbers for "
                             f"{len(self.scene.joints)} joints, {len(rest.door) // 2} doors and {len(rest.props)} "
                             "props")

    def write(self, state: RoomState) -> None:
        """Set the world to a state. Without `physics` it is at rest, with props in their initial poses."""
        client, scene = self.client, self.scene
        physics: PhysicsState = state.physics or self._make_rest()
        self._forget_contacts()
        drives = (state.x, state.y, self._rules.get_heading(state))
        angles = self._rules.get_angles(state)
        joints = (*zip(scene.drives, drives, physics.drive_velocities, strict=True),
                  *zip(scene.joints, angles, physics.joint_velocities, strict=True),
                  *((joint, angle, 0.0) for joint, angle in scene.rest_joints),
                  *((joint, factor * angles[i] + offset, factor * physics.joint_velocities[i])
                    for joint, i, factor, offset in scene.mimics))
        for joint, position, velocity in joints:
            pybullet.resetJointState(scene.robot, joint, position, velocity, client)
        if scene.door is not None:
            pybullet.resetJointState(scene.door, 0, *physics.door, client)
        for body, numbers in self.scene.blocks:
            pose = physics.props[numbers]
            pybullet.resetBasePositionAndOrientation(body, pose[:3], pose[3:7], client)
            pybullet.resetBaseVelocity(body, pose[7:10], pose[10:], client)

    def _forget_contacts(self) -> None:
        """Move all movable bodies apart and back, which makes Bullet drop its cached contacts and pairs."""
        client, scene = self.client, self.scene
        bodies = (scene.robot, *(body for body, _ in self.scene.blocks))
        for number, body in enumerate(bodies):
            pybullet.resetBasePositionAndOrientation(body, (0.0, 0.0, _AWAY * (number + 1)), _UPRIGHT, client)
        if scene.door is not None:
            pybullet.resetBasePositionAndOrientation(scene.door, (0.0, 0.0, -_AWAY), self._door_pose[1], client)
        pybullet.performCollisionDetection(client)
        pybullet.resetBasePositionAndOrientation(scene.robot, (0.0, 0.0, 0.0), _UPRIGHT, client)
        if scene.door is not None:
            pybullet.resetBasePositionAndOrientation(scene.door, *self._door_pose, client)

    def _read(self, before: RoomState, pressed: int) -> RoomState:
        """State after the motion, before presses are judged."""
        client, scene, rules = self.client, self.scene, self._rules
        drives = pybullet.getJointStates(scene.robot, scene.drives, client)
        x, y, heading = (drive[0] for drive in drives)
        reach_x, reach_y = self._reach  # contact with the alcove's far wall yields by a millimetre beyond the exit
        x, y = min(max(x, -reach_x), reach_x), min(max(y, -reach_y), reach_y)
        steps, offset = rules.split_heading(heading)
        joints = pybullet.getJointStates(scene.robot, scene.joints, client) if scene.joints else ()
        joint_steps, joint_offsets = rules.split_angles(joint[0] for joint in joints)
        door = ()
        if scene.door is not None:
            door = pybullet.getJointState(scene.door, 0, client)[:2]
        props = list((before.physics or self._make_rest()).props)
        moved = self._find_moved(tuple(props))
        for body, number in self.scene.blocks:
            if body not in moved:  # resting contacts drift by micrometres in every primitive
                props[number] = (*props[number][:7], *(0.0,) * 6)
                continue
            position, turn = pybullet.getBasePositionAndOrientation(body, client)
            velocity, spin = pybullet.getBaseVelocity(body, client)
            props[number] = (*position, *turn, *velocity, *spin)
        physics = PhysicsState(tuple(drive[1] for drive in drives), tuple(joint[1] for joint in joints), door,
                               tuple(props))
        # A pressed panel counts as touched until the presser leaves it.
        near = rules.compute_touching(x, y, steps, offset, joint_steps, joint_offsets)
        return before._replace(x=x, y=y, heading_steps=steps, heading_offset=offset, joint_steps=joint_steps,
                               joint_offsets=joint_offsets, touching=pressed | before.touching & near, physics=physics)

    # --- motion ----------------------------------------------------------------------------

    def step(self, state: RoomState, action: int) -> Transition:
        """Run one primitive. The result is pure; as a side effect, Bullet's world is left in the returned state."""
        primitive, scale = self._rules.actions.primitives[action], 1.0
        dynamics = self._instance.dynamics
        if dynamics.noise or dynamics.slip:
            normal, uniform = compute_noise(state.noise_key, state.primitives)
            scale = 0.0 if uniform < dynamics.slip else 1.0 + dynamics.noise * normal
        self.write(state)
        self._hold(state)
        if primitive.joint >= 0:
            pressed = self._move_joint(state, primitive, scale)
        else:
            pressed = self._drive(state, primitive, scale)
        return self._judge(state, pressed)

    def glide(self, state: RoomState, motion: Glide) -> Transition:
        """Run a short motion at a constant rate instead of a primitive, without noise and slips; as pure as `step`."""
        self.write(state)
        self._hold(state)
        count = max(1, round(motion.seconds * RATE))
        pairs = zip(self._rules.get_angles(state), motion.joints, self._rules.robot.limits, strict=True)
        joints = [(joint, angle, min(max(angle + change, low), high) - angle)
                  for joint, (angle, change, (low, high)) in enumerate(pairs)]
        pressed = self._run([RATE / count] * count, (motion.dx, motion.dy, motion.turn), joints)
        return self._judge(state, pressed)

    def _judge(self, state: RoomState, pressed: int) -> Transition:
        """Transition to the state of Bullet's world after the motion."""
        moved = self._read(state, pressed)
        poses = tuple(get_planar_pose(numbers) for numbers in moved.physics.props)
        return self._rules.judge(state, moved, poses)

    def _hold(self, state: RoomState) -> None:
        """Hold the joints with motors; lock the door's hinge, or free it once the puzzle is solved."""
        client, scene = self.client, self.scene
        angles = self._rules.get_angles(state)
        held = (*zip(scene.joints, angles, self._efforts, strict=True),
                *((joint, factor * angles[i] + offset, _JOINT_EFFORT) for joint, i, factor, offset in scene.mimics))
        for joint, angle, effort in held:
            pybullet.setJointMotorControl2(scene.robot, joint, pybullet.POSITION_CONTROL, angle, 0.0, effort,
                                           _POSITION_GAIN, 1.0, physicsClientId=client)
        if scene.door is not None:
            angle = pybullet.getJointState(scene.door, 0, client)[0]
            if self._instance.puzzle.is_solved(state.puzzle):
                pybullet.setJointMotorControl2(scene.door, 0, pybullet.VELOCITY_CONTROL, targetVelocity=0.0,
                                               force=_HINGE_FRICTION, physicsClientId=client)
            else:
                force = _HINGE_LOCK if abs(angle) < _LOCKED_WITHIN else _HINGE_CLOSER
                pybullet.setJointMotorControl2(scene.door, 0, pybullet.POSITION_CONTROL, 0.0, 0.0, force,
                                               0.1, 1.0, _CLOSING_SPEED, physicsClientId=client)

    def _drive(self, state: RoomState, primitive: Primitive, scale: float) -> int:
        cos, sin = self._rules.get_rotation(state.heading_steps, state.heading_offset)
        turn = scale * primitive.turn * self._rules.turn_step
        way = (*primitive.compute_move(cos, sin, scale), turn)
        seconds = max(math.hypot(way[0], way[1]) / _SPEED, abs(turn) / _TURN_SPEED)
        return self._run(_make_profile(seconds), way)

    def _move_joint(self, state: RoomState, primitive: Primitive, scale: float) -> int:
        joint, rules = primitive.joint, self._rules
        change = scale * primitive.joint_change * rules.robot.step
        angle = rules.get_angles(state)[joint]
        low, high = rules.robot.limits[joint]
        if not low - _LIMIT_SLACK <= angle + change <= high + _LIMIT_SLACK:
            change = 0.0
        change = min(max(angle + change, low), high) - angle
        profile = _make_profile(abs(change) / _TURN_SPEED)
        return self._run(profile, (0.0, 0.0, 0.0), ((joint, angle, change),))

    def _run(self, profile: Sequence[float], way: tuple[float, float, float],
             joints: Sequence[tuple[int, float, float]] = ()) -> int:
        """Simulate one sub-step for each rate of a profile, in 1/s; return the bits of the targets that were pressed.

        `way` is the displacement of the base along x and y, m, and about z, rad. `joints` has index, angle and
        displacement, rad, of each moving joint. The base stops if it is pressed ever deeper into something, by
        `_WEDGED` or more.
        """
        client, scene, pressed, done = self.client, self.scene, 0, 0.0
        depth, is_wedged = math.inf, False
        self._touches = set()
        for rate in profile:
            drive = 0.0 if is_wedged else rate
            pybullet.setJointMotorControlArray(scene.robot, scene.drives, pybullet.VELOCITY_CONTROL,
                                               targetVelocities=[drive * part for part in way],
                                               forces=self._drive_forces, physicsClientId=client)
            for joint, angle, change in joints:
                pybullet.setJointMotorControl2(scene.robot, scene.joints[joint], pybullet.POSITION_CONTROL,
                                               angle + done * change, rate * change, self._efforts[joint],
                                               _POSITION_GAIN, 1.0, physicsClientId=client)
                for follower, i, factor, offset in scene.mimics:
                    if i == joint:
                        pybullet.setJointMotorControl2(
                            scene.robot, follower, pybullet.POSITION_CONTROL, factor * (angle + done * change) + offset,
                            factor * rate * change, _JOINT_EFFORT, _POSITION_GAIN, 1.0, physicsClientId=client)
            done += rate / RATE
            pybullet.stepSimulation(client)
            points = pybullet.getContactPoints(scene.robot, physicsClientId=client)
            pressed |= self._find_pressed(points)
            before, depth = depth, max((-point[8] for point in points if point[3] == scene.base_link), default=0.0)
            is_wedged |= depth > max(_WEDGED, before)
            for body, _ in self.scene.blocks:
                self._touches |= {(body, point[2]) for point in pybullet.getContactPoints(body, physicsClientId=client)
                                  if point[9] > 0.0}
        return pressed

    def _find_moved(self, props: tuple[tuple[float, ...], ...]) -> set[int]:
        """Bodies of the blocks that moved since these poses and velocities, or that something moving touched."""
        movers = {self.scene.robot, self.scene.door}
        moved = {body for body, number in self.scene.blocks if max(map(abs, props[number][7:])) > _AT_REST}
        while True:
            more = {body for body, other in self._touches if other in movers or other in moved} - moved
            if not more:
                return moved
            moved |= more

    def _find_pressed(self, points: Sequence[tuple[Any, ...]]) -> int:
        """Bits of the targets that the presser pushes against, from the robot's contact points."""
        pressed = 0
        for point in points:
            target = self._targets.get(point[2])
            if target is not None and point[9] >= PRESS_FORCE and self._is_presser(point[3], point[5]):
                pressed |= 1 << target
        return pressed

    def _is_presser(self, link: int, at: tuple[float, float, float]) -> bool:
        if not self._by_hand:
            return link == self.scene.base_link
        hand = pybullet.getLinkState(self.scene.robot, self.scene.hand_link, computeForwardKinematics=1,
                                     physicsClientId=self.client)[4]
        return link != self.scene.base_link and math.dist(hand, at) <= self._hand_reach


@lru_cache(maxsize=256)
def _make_profile(seconds: float) -> tuple[float, ...]:
    """Rates in 1/s, one per sub-step, with sum RATE: a motion accelerates, cruises, decelerates and settles."""
    count = max(round(max(seconds, _SHORTEST) * RATE), 2)
    ramp = _RAMP * count
    rates = [min(1.0, (i + 0.5) / ramp, (count - i - 0.5) / ramp) for i in range(count)]
    unit = RATE / math.fsum(rates)
    return (*(rate * unit for rate in rates), *(0.0,) * round(_SETTLE * RATE))


# --- bodies of a room ----------------------------------------------------------------------


def build_scene(client: int, instance: RoomInstance, robot: Robot) -> SceneBodies:
    """Build the room in an empty Bullet world, everything in its initial pose."""
    # Mode 0: two bodies collide only if both masks allow it. By default one mask is enough.
    pybullet.setPhysicsEngineParameter(collisionFilterMode=0, physicsClientId=client)
    floors = tuple(_add_floor(client, area) for area in compute_floors(instance))
    solids = tuple(_add_solid(client, solid) for solid in instance.solids)
    door = instance.door and _add_door(client, instance.door)
    targets = tuple(_add_box(client, (t.half_x, t.half_y, t.half_z), (t.x, t.y, t.z), t.yaw, _FIXED, _FREE)
                    for t in instance.targets)
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
    # Bullet's default margin rounds the corners of boxes by up to 0.4 mm.
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
    """A leaf hinged at one end of the doorway. It swings through walls, but not through the robot."""
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
        (folder / "robot.urdf").write_text(_adapt_urdf(robot, instance.robot, folder))
        body = pybullet.loadURDF(str(folder / "robot.urdf"), useFixedBase=True, flags=flags, physicsClientId=client)
    links, joints, moving = {}, {}, {}
    for index in range(pybullet.getNumJoints(body, physicsClientId=client)):
        info = pybullet.getJointInfo(body, index, physicsClientId=client)
        links[info[12].decode()], joints[info[1].decode()] = index, index
        if info[2] != pybullet.JOINT_FIXED:
            moving[info[1].decode()] = index
    base = links[BASE_LINK]
    pybullet.changeDynamics(body, base, collisionMargin=0.0, physicsClientId=client)
    # The arm may lean on the ground. The carriage carries the base, whose own friction would count twice.
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
        "mimics": tuple((moving[name], *follows) for name, follows in robot.mimics.items()),
    }


def _adapt_urdf(robot: Robot, config: RobotConfig, folder: Path) -> str:
    """Make the hand solid, give massless links the small mass that Bullet needs, and add the carriage."""
    root = ElementTree.fromstring(robot.urdf)
    if config.kind == "urdf":
        drop_shapes(root, "visual")
        write_meshes(root, folder)
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
