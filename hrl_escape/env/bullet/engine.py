"""The Bullet engine: one room in its own physics client, under kinematic or physics dynamics.

Kinematic rooms are moved by `Kinematics`, and Bullet's world is built and placed only when it is rendered or queried:
renderings and queries always show the state, and steps, or rooms never looked at, cost nothing for it. Physics rooms
are moved by `physics.py`. It knows no Gymnasium, no observations and no cameras.
"""

from __future__ import annotations

import math
import os
import sys
import time
import weakref
from collections.abc import Callable
from typing import Any, NamedTuple

import pybullet

from hrl_escape.env.bullet.physics import PhysicsDynamics
from hrl_escape.env.bullet.scene import SceneBodies, build_scene, show_door, show_exit, show_inner_door, show_lit
from hrl_escape.env.instance import RoomInstance, Start
from hrl_escape.env.kinematics import Glide, Kinematics, RoomState, Rules, Transition
from hrl_escape.env.puzzles.traits import Barring, get_trait
from hrl_escape.env.state_checks import check_state
from hrl_escape.errors import ClosedError, UnsupportedError


class BulletRoom:
    """One room that moves. Rooms are independent; a room that is rendered owns a physics client until `close`.

    Attributes:
        instance: the room.
        rules: the room's rules (`Kinematics`, or `Rules` under physics).
        state: the state now. It is immutable, so to keep it is to save it.
    """

    def __init__(self, instance: RoomInstance, window: bool = False) -> None:
        """Build the room and begin an episode at its first start.

        Args:
            instance: the room.
            window: open Bullet's window (needs a display).

        Raises:
            UnsupportedError: a window without a display; under physics, too many rooms open in this process.
        """
        self.instance, self._is_seen = instance, window
        kinematics = Kinematics(instance) if instance.dynamics.kind == "kinematic" else None
        self.rules: Rules = kinematics or Rules(instance)
        self._world: _World | None = None
        self._is_closed, self._is_placed = False, True
        self._next_frame = 0.0
        if window:
            self._open()
        self._mover = kinematics or self._open().get_physics()
        self.state = self.reset(instance.starts[0])

    def _open(self) -> _World:
        """Bullet's world, built when it is first needed."""
        if self._world is None:
            client = _connect(self._is_seen)
            self._release = weakref.finalize(self, _disconnect, client)
            self._world = _World.build(client, self.instance, self.rules)
            if self._is_seen:
                pybullet.configureDebugVisualizer(pybullet.COV_ENABLE_RENDERING, 1, physicsClientId=client)
        return self._world

    @property
    def scene(self) -> SceneBodies:
        """PyBullet body and joint ids of its world."""
        return self._open().scene

    # --- the episode ---------------------------------------------------------------------

    def reset(self, start: Start, noise_key: int = 0) -> RoomState:
        """Begin an episode.

        Args:
            start: pose of the robot; the arm is at home, the puzzle at its start.
            noise_key: 64-bit key of the episode's noise and slip.
        """
        self._require_open()
        self._enter(self._mover.make_state(start, noise_key))
        return self.state

    def set_state(self, state: RoomState) -> None:
        """Continue from a state; stepping from it is identical to stepping from the original.

        States are plain values: they may come from another room of the same instance, or another
        process. Under physics, one without `physics` (a planner's, say) is at rest at its pose
        with props and door at their first poses.

        Raises:
            StateError: a state that no episode in this room could be in.
        """
        self._require_open()
        check_state(self.rules, state)
        if isinstance(self._mover, PhysicsDynamics):
            self._mover.check_state(state)
        self._enter(state)

    def step(self, action: int) -> Transition:
        """Apply one primitive.

        Args:
            action: a number of `rules.actions`, not checked here.

        Raises:
            ClosedError: the room was closed, or its window.
        """
        return self._move(self._mover.step, action)

    def glide(self, motion: Glide) -> Transition:
        """Apply a short motion in continuous coordinates. Raises `ClosedError` as `step` does."""
        return self._move(self._mover.glide, motion)

    def _move(self, mover: Callable[[RoomState, Any], Transition], motion: Any) -> Transition:
        if self._is_closed:
            self._require_open()
        try:
            transition = mover(self.state, motion)
        except pybullet.error:
            self._require_open()
            raise
        self._enter(transition.state)
        return transition

    def _enter(self, state: RoomState) -> None:
        self.state, self._is_placed = state, False
        if self._is_seen:
            self._place()

    def _place(self) -> None:
        """Bring Bullet's world into the present state, if it is in another one."""
        world = self._open()
        if not self._is_placed:
            try:
                world.dynamics.place(self.state)
                world.colours.show(self.state)
            except pybullet.error:
                self._require_open()
                raise
            self._is_placed = True

    @property
    def client(self) -> int:
        """Number of pybullet's physics client, -1 once closed; its world shows `state`.

        Raises:
            UnsupportedError: too many rooms in this process have one.
        """
        if self._is_closed:
            return -1
        self._place()
        return self._open().client

    def show(self, rate: float) -> None:
        """Keep Bullet's window watchable: wait until 1 / `rate` seconds after the last call."""
        self._require_open()
        now = time.monotonic()
        time.sleep(min(max(self._next_frame - now, 0.0), 1.0 / rate))
        self._next_frame = max(self._next_frame, now) + 1.0 / rate

    # --- queries -------------------------------------------------------------------------

    def compute_clearance(self) -> float:
        """Distance in metres from the body to the nearest wall, obstacle or shut door, asked of Bullet.

        Negative if they overlap. Bullet's answer is within 2e-6 m of the exact distance at
        the contact skin; it is independent of the rules that moved the body.
        """
        self._require_open()
        instance, client, best = self.instance, self.client, math.inf
        furthest = 3.0 * (instance.reach_x + instance.reach_y)
        bodies = [(solid, -1) for solid in self.scene.solids]
        if self.scene.door is not None and self._open().dynamics.door_is_solid:
            bodies.append((self.scene.door, 0))
        for body, link in bodies:
            points = pybullet.getClosestPoints(self.scene.robot, body, furthest, self.scene.base_link, link,
                                               physicsClientId=client)
            best = min(best, min(point[8] for point in points))
        return best

    @property
    def is_open(self) -> bool:
        """False once the room, or its window, was closed."""
        return not self._is_closed and (self._world is None or bool(pybullet.isConnected(self._world.client)))

    # --- its end -------------------------------------------------------------------------

    def close(self) -> None:
        """Free the physics client; safe to call twice. Deleting the room frees it too."""
        self._is_closed = True
        if self._world is not None:
            self._release()

    def _require_open(self) -> None:
        if self._is_closed:
            raise ClosedError("this room is closed; make a new one")
        if not self.is_open:
            self.close()
            raise ClosedError("this room's window was closed; make a new one")


class _World(NamedTuple):
    """Bullet's world of a room."""

    client: int  # pybullet's number of the physics client
    scene: SceneBodies  # PyBullet body and joint ids
    dynamics: PhysicsDynamics | _KinematicPlacement  # places the bodies by a state; under physics it also moves them
    colours: _PuzzleColours  # show the puzzle

    @classmethod
    def build(cls, client: int, instance: RoomInstance, rules: Rules) -> _World:
        scene = build_scene(client, instance, rules.robot)
        dynamics = (_KinematicPlacement(client, scene, rules) if isinstance(rules, Kinematics)
                    else PhysicsDynamics(client, scene, rules))
        return cls(client, scene, dynamics, _PuzzleColours(client, instance, scene))

    def get_physics(self) -> PhysicsDynamics:
        """Dynamics that move the room."""
        assert isinstance(self.dynamics, PhysicsDynamics)
        return self.dynamics


class _KinematicPlacement:
    """`Kinematics` decides; Bullet's bodies are placed accordingly."""

    def __init__(self, client: int, scene: SceneBodies, rules: Kinematics) -> None:
        self._client, self._rules = client, rules
        self._robot, self._joints, self._height = scene.robot, scene.joints, scene.base_height
        self._turns = tuple(_make_quaternion(n * rules.turn_step) for n in range(rules.headings))
        self._pose: tuple[float, ...] = ()
        self._angles = [math.nan] * len(scene.joints)
        self._arm: tuple = ()
        self._door = scene.door
        self.door_is_solid = True

    def place(self, state: RoomState) -> None:
        """Move the parts of the robot whose pose differs from the state's."""
        pose = state.x, state.y, state.heading_steps, state.heading_offset
        if pose != self._pose:
            self._pose = pose
            x, y, steps, offset = pose
            turn = self._turns[steps] if offset == 0.0 else _make_quaternion(steps * self._rules.turn_step + offset)
            pybullet.resetBasePositionAndOrientation(self._robot, (x, y, self._height), turn, self._client)
        arm = state.joint_steps, state.joint_offsets
        if arm != self._arm:
            self._arm = arm
            for i, angle in enumerate(self._rules.get_angles(state)):
                if angle != self._angles[i]:
                    self._angles[i] = angle
                    pybullet.resetJointState(self._robot, self._joints[i], angle, 0.0, self._client)
        if self._door is not None:
            is_shut = self._rules.is_door_shut(state.x, state.y, state.puzzle, self._rules.get_rotation(
                state.heading_steps, state.heading_offset))
            if is_shut != self.door_is_solid:
                self.door_is_solid = is_shut
                show_door(self._client, self._rules.instance, self._door, not is_shut)


class _PuzzleColours:
    """Colours that show the puzzle: lit targets and the exit."""

    def __init__(self, client: int, instance: RoomInstance, scene: SceneBodies) -> None:
        self._client, self._instance, self._scene = client, instance, scene
        self._puzzle: object = None
        self._lit = (False,) * len(instance.targets)
        self._shut = (1 << len(instance.inner_doors)) - 1
        self._solved = False

    def show(self, state: RoomState) -> None:
        """Recolour targets and exit if they changed."""
        if state.puzzle != self._puzzle:
            self._puzzle = state.puzzle
            puzzle = self._instance.puzzle
            lit = puzzle.get_lit(state.puzzle)
            for target, now, before in zip(self._scene.targets, lit, self._lit, strict=True):
                if now != before:
                    show_lit(self._client, target, now)
            self._lit = lit
            shut = get_trait(puzzle, Barring).get_shut(state.puzzle)
            for number, door in enumerate(self._instance.inner_doors):
                if (shut ^ self._shut) >> number & 1:
                    show_inner_door(self._client, self._scene.inner_doors[number], door, bool(shut >> number & 1))
            self._shut = shut
            solved = puzzle.is_solved(state.puzzle)
            if solved != self._solved:
                self._solved = solved
                show_exit(self._client, self._scene, solved)


def _make_quaternion(heading: float) -> tuple[float, float, float, float]:
    return 0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2)


# --- physics clients -----------------------------------------------------------------------


def _connect(window: bool) -> int:
    if window and sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        raise UnsupportedError("Bullet's window needs a display (DISPLAY is not set); use pictures (rgb_array) instead")
    client = pybullet.connect(pybullet.GUI if window else pybullet.DIRECT)
    if client < 0:
        raise UnsupportedError("Bullet gives no further physics client; close rooms that are no longer used")
    if window:
        for flag in (pybullet.COV_ENABLE_GUI, pybullet.COV_ENABLE_RENDERING):
            pybullet.configureDebugVisualizer(flag, 0, physicsClientId=client)
    return client


def _disconnect(client: int) -> None:
    if pybullet.isConnected(client):
        pybullet.disconnect(client)
