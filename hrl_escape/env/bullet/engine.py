"""The Bullet engine: one room that moves, under kinematic or physics dynamics, and its window.

Kinematic rooms are moved by `Kinematics` and have no physics client; physics rooms are moved by `physics.py` in one of
their own. A window shows a `Stage`. It knows no Gymnasium, no observations and no cameras.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import pybullet

from hrl_escape.env.bullet.cameras import Stage
from hrl_escape.env.bullet.physics import PhysicsDynamics
from hrl_escape.env.instance import RoomInstance, Start
from hrl_escape.env.kinematics import Glide, Kinematics, RoomState, Rules, Transition, check_state
from hrl_escape.errors import ClosedError


class BulletRoom:
    """One room that moves. Rooms are independent; under physics, or with a window, one owns a client until `close`.

    Attributes:
        instance: the room.
        rules: the room's rules (`Kinematics`, or `Rules` under physics).
        physics: what moves the room under physics, with its world; else None.
        state: the state now. It is immutable, so to keep it is to save it.
    """

    def __init__(self, instance: RoomInstance, window: bool = False) -> None:
        """Build the room, and open Bullet's window if one is wanted; it begins an episode at its first start.

        Raises:
            UnsupportedError: a window without a display; under physics, a gripper, or too many rooms open in this
                process.
        """
        self.instance, self._is_closed, self._next_frame = instance, False, 0.0
        is_kinematic = instance.dynamics.kind == "kinematic"
        self.rules: Rules = Kinematics(instance) if is_kinematic else Rules(instance)
        self._window = Stage(instance, window=True) if window else None
        self.physics = None if is_kinematic else PhysicsDynamics(self.rules)
        self._mover: Any = self.physics or self.rules
        self.state = self.reset(instance.starts[0])

    # --- the episode ---------------------------------------------------------------------

    def reset(self, start: Start, noise_key: int = 0) -> RoomState:
        """Begin an episode at a pose: arm at home, puzzle at its start; the key decides noise and slip."""
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
        if self.physics is not None:
            self.physics.check_state(state)
        self._enter(state)

    def step(self, action: int) -> Transition:
        """Apply one primitive, a number of `rules.actions`, which is not checked.

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
        self.state = state
        if self._window is not None:
            self._require_open()
            self._window.follow(state)

    def show(self, rate: float) -> None:
        """Keep Bullet's window watchable: wait until 1 / `rate` seconds after the last call."""
        self._require_open()
        now = time.monotonic()
        time.sleep(min(max(self._next_frame - now, 0.0), 1.0 / rate))
        self._next_frame = max(self._next_frame, now) + 1.0 / rate

    # --- its end -------------------------------------------------------------------------

    @property
    def is_open(self) -> bool:
        """False once the room, or its window, was closed."""
        clients = [owner.client for owner in (self.physics, self._window) if owner is not None]
        return not self._is_closed and all(map(pybullet.isConnected, clients))

    def close(self) -> None:
        """Free the physics clients; safe to call twice. Deleting the room frees them too."""
        self._is_closed = True
        for owner in (self.physics, self._window):
            if owner is not None:
                owner.close()

    def _require_open(self) -> None:
        if self._is_closed:
            raise ClosedError("this room is closed; make a new one")
        if not self.is_open:
            self.close()
            raise ClosedError("this room's window was closed; make a new one")
