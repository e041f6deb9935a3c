"""The Bullet engine: one room in its own physics client, under kinematic or physics dynamics.

Kinematic rooms are moved by `Kinematics`, and Bullet's world is placed accordingly after each
primitive, so that rendering and queries always see the state. Physics rooms are moved by
`bullet_physics.py`. It knows no Gymnasium, no observations and no cameras.
"""

from __future__ import annotations

import math
import os
import sys
import time
import weakref

import pybullet

from hrl_escape.env.bullet_physics import PhysicsDynamics
from hrl_escape.env.bullet_scene import Scene, build_scene, show_door, show_exit, show_lit
from hrl_escape.env.instance import RoomInstance, Start
from hrl_escape.env.kinematics import Kinematics, RoomState, Rules, Transition
from hrl_escape.errors import ClosedError, StateError, UnsupportedError

__all__ = ["BulletRoom"]


class BulletRoom:
    """One room that moves. Rooms are independent; each owns a physics client until `close`.

    Attributes:
        instance: what is simulated.
        rules: the room's rules (`Kinematics`, or `Rules` under physics).
        client: pybullet's number of the physics client, -1 once closed; its world always shows
            `state`.
        scene: pybullet's numbers of the bodies in it.
        state: the state now. It is immutable, so to keep it is to save it.
    """

    def __init__(self, instance: RoomInstance, gui: bool = False) -> None:
        """Build the room and begin an episode at its first start.

        Args:
            instance: what to simulate.
            gui: open Bullet's window (needs a display).

        Raises:
            UnsupportedError: a window without a display, or too many rooms open in this process.
        """
        self.instance = instance
        self.client = _connect(gui)
        self._release = weakref.finalize(self, _disconnect, self.client)
        physics = instance.dynamics.kind == "physics"
        self.rules: Rules = Rules(instance) if physics else Kinematics(instance)
        self.scene: Scene = build_scene(self.client, instance, self.rules.robot)
        if gui:
            pybullet.configureDebugVisualizer(pybullet.COV_ENABLE_RENDERING, 1, physicsClientId=self.client)
        dynamics = PhysicsDynamics if physics else _KinematicDynamics
        self._dynamics = dynamics(self.client, self.scene, self.rules)
        self._looks = _Looks(self.client, instance, self.scene)
        self._next_frame = 0.0
        self.state = self.reset(instance.starts[0])

    # --- the episode ---------------------------------------------------------------------

    def reset(self, start: Start, noise_key: int = 0) -> RoomState:
        """Begin an episode.

        Args:
            start: where the robot stands; the arm is at home, the puzzle at its start.
            noise_key: 64-bit key of the episode's noise and slip.
        """
        self._require_open()
        self._enter(self._dynamics.make_state(start, noise_key))
        return self.state

    def set_state(self, state: RoomState) -> None:
        """Continue from a state; stepping from it is identical to stepping from the original.

        States are plain values: they may come from another room of the same instance, or another
        process. Under physics, one without `physics` (a planner's, say) is at rest at its pose
        with props and door where they begin.

        Raises:
            StateError: a state of another robot, or with other props.
        """
        self._require_open()
        if len(state.joint_steps) != self.instance.robot.joints:
            raise StateError(f"the state has {len(state.joint_steps)} joints, this room's robot "
                             f"has {self.instance.robot.joints}")
        if not 0 <= state.heading_steps < self.rules.headings:
            raise StateError(f"heading_steps = {state.heading_steps} is not one of 0 to {self.rules.headings - 1}")
        if state.physics is not None and len(state.physics.props) != len(self.instance.props):
            raise StateError(f"the state has {len(state.physics.props)} props, this room "
                             f"has {len(self.instance.props)}")
        self._enter(state)

    def step(self, action: int) -> Transition:
        """Apply one primitive.

        Args:
            action: index into `rules.primitives`, not checked here.

        Raises:
            ClosedError: the room was closed, or its window.
        """
        if self.client < 0:
            self._require_open()
        try:
            transition = self._dynamics.step(self.state, action)
            self._enter(transition.state)
        except pybullet.error:
            self._require_open()
            raise
        return transition

    def _enter(self, state: RoomState) -> None:
        self._dynamics.place(state)
        self._looks.show(state)
        self.state = state

    def show(self, rate: float) -> None:
        """Keep Bullet's window watchable: wait until 1 / `rate` seconds after the last call."""
        self._require_open()
        now = time.monotonic()
        time.sleep(min(max(self._next_frame - now, 0.0), 1.0 / rate))
        self._next_frame = max(self._next_frame, now) + 1.0 / rate

    # --- queries -------------------------------------------------------------------------

    def compute_clearance(self) -> float:
        """Distance in metres from the body to the nearest wall, obstacle or shut door, asked of Bullet.

        Negative where they overlap. Bullet's answer is within 2e-6 m of the exact distance at
        the contact skin; it is independent of the rules that moved the body.
        """
        self._require_open()
        instance, best = self.instance, math.inf
        furthest = 3.0 * (instance.reach_x + instance.reach_y)
        bodies = [(solid, -1) for solid in self.scene.solids]
        if self.scene.door is not None and self._dynamics.door_is_solid:
            bodies.append((self.scene.door, 0))
        for body, link in bodies:
            points = pybullet.getClosestPoints(self.scene.robot, body, furthest, self.scene.base_link, link,
                                               physicsClientId=self.client)
            best = min(best, min(point[8] for point in points))
        return best

    # --- its end -------------------------------------------------------------------------

    def close(self) -> None:
        """Free the physics client; again is no error. Forgetting the room frees it too."""
        self._release()
        self.client = -1

    def _require_open(self) -> None:
        if self.client < 0:
            raise ClosedError("this room is closed; make a new one")
        if not pybullet.isConnected(self.client):
            self.close()
            raise ClosedError("this room's window was closed; make a new one")


class _KinematicDynamics:
    """`Kinematics` decides; Bullet's bodies are put where the state says."""

    def __init__(self, client: int, scene: Scene, rules: Rules) -> None:
        assert isinstance(rules, Kinematics)
        self.step = rules.step
        self.make_state = rules.make_state
        self._client, self._rules = client, rules
        self._robot, self._joints, self._height = scene.robot, scene.joints, scene.base_height
        self._turns = tuple(_make_quaternion(n * rules.turn_step) for n in range(rules.headings))
        self._pose: tuple[float, ...] = ()
        self._angles = [math.nan] * len(scene.joints)
        self._arm: tuple = ()
        self._door = scene.door
        self.door_is_solid = True

    def place(self, state: RoomState) -> None:
        """Put the robot where the state says, as far as it is not there yet."""
        pose = state[:4]
        if pose != self._pose:
            self._pose = pose
            x, y, steps, offset = pose
            turn = self._turns[steps] if offset == 0.0 else _make_quaternion(steps * self._rules.turn_step + offset)
            pybullet.resetBasePositionAndOrientation(self._robot, (x, y, self._height), turn, self._client)
        arm = state[4:6]
        if arm != self._arm:
            self._arm = arm
            for i, angle in enumerate(self._rules.get_angles(state)):
                if angle != self._angles[i]:
                    self._angles[i] = angle
                    pybullet.resetJointState(self._robot, self._joints[i], angle, 0.0, self._client)
        if self._door is not None:
            is_shut = self._rules.is_door_shut(state.x, state.y, state.puzzle)
            if is_shut != self.door_is_solid:
                self.door_is_solid = is_shut
                show_door(self._client, self._rules.instance, self._door, not is_shut)


class _Looks:
    """What shows the puzzle: lit targets and the exit's colour."""

    def __init__(self, client: int, instance: RoomInstance, scene: Scene) -> None:
        self._client, self._instance, self._scene = client, instance, scene
        self._puzzle: object = None
        self._lit = (False,) * len(instance.targets)
        self._solved = False

    def show(self, state: RoomState) -> None:
        """Recolour what has changed."""
        if state.puzzle != self._puzzle:
            self._puzzle = state.puzzle
            puzzle = self._instance.puzzle
            lit = puzzle.get_lit(state.puzzle)
            for target, now, before in zip(self._scene.targets, lit, self._lit, strict=True):
                if now != before:
                    show_lit(self._client, target, now)
            self._lit = lit
            solved = puzzle.is_solved(state.puzzle)
            if solved != self._solved:
                self._solved = solved
                show_exit(self._client, self._scene, solved)


def _make_quaternion(heading: float) -> tuple[float, float, float, float]:
    return 0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2)


# --- physics clients -----------------------------------------------------------------------


def _connect(gui: bool) -> int:
    if gui and sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        raise UnsupportedError("Bullet's window needs a display (DISPLAY is not set); use pictures (rgb_array) instead")
    client = pybullet.connect(pybullet.GUI if gui else pybullet.DIRECT)
    if client < 0:
        raise UnsupportedError("Bullet gives no further physics client; close rooms that are no longer used")
    if gui:
        for flag in (pybullet.COV_ENABLE_GUI, pybullet.COV_ENABLE_RENDERING):
            pybullet.configureDebugVisualizer(flag, 0, physicsClientId=client)
    return client


def _disconnect(client: int) -> None:
    if pybullet.isConnected(client):
        pybullet.disconnect(client)
