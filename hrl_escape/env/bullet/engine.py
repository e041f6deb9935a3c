"""The Bullet engine: one room that moves, under kinematic or physics dynamics, and its window.

`Kinematics` moves kinematic rooms, which have no physics client; `physics.py` moves physics rooms in their own client.
A window shows a `Stage`. The engine is independent of Gymnasium, observations and cameras.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from hrl_escape.env.bullet import is_connected
from hrl_escape.env.instance import RoomInstance, Start
from hrl_escape.env.kinematics import Glide, Kinematics, RoomState, Rules, Transition, check_state
from hrl_escape.errors import ClosedError


class BulletRoom:
    """One room that moves. Rooms are independent. Under physics, or with a window, a room has a client until `close`.

    Attributes:
        instance: the room.
        rules: the room's rules (`Kinematics`, or `Rules` under physics).
        physics: dynamics of the room under physics, with its world; otherwise None.
        state: current state, immutable; keeping a reference saves it.
    """

    def __init__(self, instance: RoomInstance, window: bool = False) -> None:
        """Build the room and begin an episode at its first start. If `window`, open Bullet's window.

        Raises:
            UnsupportedError: a window without a display; under physics, a gripper, or too many rooms open in this
                process.
            MissingExtraError: physics or a window without pybullet.
        """
        self.instance, self._is_closed, self._next_frame = instance, False, 0.0
        is_kinematic = instance.dynamics.kind == "kinematic"
        self.rules: Rules = Kinematics(instance) if is_kinematic else Rules(instance)
        self._window = self.physics = None
        if window:
            from hrl_escape.env.bullet.cameras import Stage  # loads pybullet

            self._window = Stage(instance, window=True)
        if not is_kinematic:
            from hrl_escape.env.bullet.physics import PhysicsDynamics  # loads pybullet

            self.physics = PhysicsDynamics(self.rules)
        self._mover: Any = self.physics or self.rules
        self.state = self.reset(instance.starts[0])

    # --- the episode ---------------------------------------------------------------------

    def reset(self, start: Start, noise_key: int = 0) -> RoomState:
        """Begin an episode at a start: arm at home, initial puzzle state. The key determines noise and slips."""
        self._require_open()
        self._enter(self._mover.make_state(start, noise_key))
        return self.state

    def set_state(self, state: RoomState) -> None:
        """Continue from a state, exactly as the room that returned it.

        States are plain values: they can come from another room of the same instance, or another process. Under
        physics, a state without `physics` (from a planner, for example) is at rest at its pose, with props and door in
        their initial poses.

        Raises:
            StateError: the state is impossible in this room.
        """
        self._require_open()
        check_state(self.rules, state)
        if self.physics is not None:
            self.physics.check_state(state)
        self._enter(state)

    def step(self, action: int) -> Transition:
        """Apply one primitive, an index of `rules.actions` that is not checked.

        Raises:
            ClosedError: the room or its window is closed.
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
        except Exception:  # Bullet raises errors of its own once its client is gone
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
        """Limit the window to `rate` frames a second: wait until 1 / `rate` seconds after the last call."""
        self._require_open()
        now = time.monotonic()
        time.sleep(min(max(self._next_frame - now, 0.0), 1.0 / rate))
        self._next_frame = max(self._next_frame, now) + 1.0 / rate

    # --- its end -------------------------------------------------------------------------

    @property
    def is_open(self) -> bool:
        """True until the room or its window is closed."""
        clients = [owner.client for owner in (self.physics, self._window) if owner is not None]
        return not self._is_closed and all(map(is_connected, clients))

    def close(self) -> None:
        """Free the physics clients; further calls have no effect. Deleting the room frees them too."""
        self._is_closed = True
        for owner in (self.physics, self._window):
            if owner is not None:
                owner.close()

    def _require_open(self) -> None:
        if self._is_closed:
            raise ClosedError("this room is closed. Make a new one")
        if not self.is_open:
            self.close()
            raise ClosedError("this room's window is closed. Make a new one")
