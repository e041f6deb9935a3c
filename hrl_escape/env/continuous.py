"""The Escape Room with velocities for actions: the same rooms and rules, a step of time in place of a primitive."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Glide
from hrl_escape.env.puzzles.traits import Pushing
from hrl_escape.env.sampling.sources import SchematicForm
from hrl_escape.errors import ConfigError, UnsupportedError


class EscapeRoomContinuousEnv(EscapeRoomEnv):
    """The rooms of `EscapeRoomEnv` for agents that choose velocities.

    ## Action space
    `Box`, float32, in this order; numbers beyond the bounds are clipped:

    | number | unit | bound |
    |---|---|---|
    | velocity forward | m/s | `speed` |
    | velocity to the left, where the base strafes | m/s | `speed` |
    | turn, counter-clockwise | rad/s | `turn_speed` |
    | each joint | rad/s | `joint_speed`, or the URDF's where that is less |

    In a step the base goes straight, along its heading in the middle of the turn, until its first contact, which is
    exact; then it turns on the spot. Joints stop at their limits. Under physics all of it moves at once in Bullet.
    A touch counts if it is there at the end of a step.

    ## Rewards
    -1 a second, so -`time_step` a step. Puzzles and the exit pay what they pay there.

    ## Episode end
    As in `EscapeRoomEnv`; `truncated` after `time_limit` seconds.

    ## Information
    `info` has `seconds` since the episode began and `time_step`, in place of `primitives`.

    ## Arguments
    Args:
        config: as in `EscapeRoomEnv`, as are all that follow `time_limit`.
        time_step: s; under physics in whole sub-steps of 1/240 s.
        speed: largest speed of the base along each of its axes, m/s.
        turn_speed: rad/s.
        joint_speed: rad/s.
        time_limit: s; None for as many seconds as the room's horizon has primitives.

    Attributes:
        speeds: `speed`, `turn_speed` and `joint_speed`.
        time_step: s.
    """

    def __init__(self, config: SchematicForm = "paper-two-button", *, time_step: float = 0.1, speed: float = 1.0,
                 turn_speed: float = 1.5, joint_speed: float = 1.0, time_limit: float | None = None, **settings: Any
                 ) -> None:
        self.speeds = {"speed": speed, "turn_speed": turn_speed, "joint_speed": joint_speed}
        self.time_step, self._time_limit = time_step, time_limit
        for name, value in (self.speeds | {"time_step": time_step, "time_limit": time_limit}).items():
            is_number = isinstance(value, (int, float)) and not isinstance(value, bool) and 0.0 < value < math.inf
            if not is_number and (name != "time_limit" or value is not None):
                raise ConfigError(name, value, "a finite number above 0")
        super().__init__(config, **settings)
        EzPickle.__init__(self, config, **self.speeds, time_step=time_step, time_limit=time_limit, **settings)

    def _enter(self, instance: RoomInstance) -> None:
        if instance.robot.actions.gripper or (isinstance(instance.puzzle, Pushing)
                                              and instance.dynamics.kind == "kinematic"):
            raise UnsupportedError(f"{instance.name!r} is a room of things to grip or push from cell to cell, which "
                                   "takes primitives: hrl_escape/EscapeRoom-v1")
        super()._enter(instance)
        speed, turn_speed, joint_speed = self.speeds.values()
        self._strafes = instance.robot.drive == "strafing"
        self._seconds = self._time_limit or instance.horizon
        joints = [min(joint_speed, top) for top in self.rules.robot.speeds]
        self._top = np.array([*[speed] * (1 + self._strafes), turn_speed, *joints], dtype=np.float64)
        self.action_space = spaces.Box(-self._top.astype(np.float32), self._top.astype(np.float32))  # type: ignore[assignment]

    def describe(self) -> dict[str, Any]:
        """As in `EscapeRoomEnv`, and the numbers of this one."""
        return super().describe() | self.speeds | {"time_step": self.time_step, "time_limit": self._time_limit}

    def step(self, action: NDArray[Any]) -> tuple[NDArray[Any], float, bool, bool, dict[str, Any]]:  # type: ignore[override]
        """Move for one step of time; returns Gymnasium's five values.

        Raises:
            ConfigError: the action is not as many finite numbers as the action space has.
        """
        state, room = self._require_episode()
        try:
            rates = np.asarray(action, dtype=np.float64)
        except (TypeError, ValueError):
            rates = np.zeros(0)
        if rates.shape != self._top.shape or not np.isfinite(rates).all():
            raise ConfigError("action", action, f"{len(self._top)} finite numbers")
        forward, *others = (np.clip(rates, -self._top, self._top) * self.time_step).tolist()
        left = others.pop(0) if self._strafes else 0.0
        turn, *joints = others
        cos, sin = self.rules.get_rotation(state.heading_steps, state.heading_offset)
        if turn:
            middle = self.rules.get_heading(state) + turn / 2.0
            cos, sin = math.cos(middle), math.sin(middle)
        motion = Glide(forward * cos - left * sin, forward * sin + left * cos, turn, tuple(joints), self.time_step)
        moved, reward, terminated, _, pressed = room.glide(motion)
        reward -= self.instance.reward.step * (1.0 - self.time_step)
        is_late = moved.primitives * self.time_step >= self._seconds - 1e-9
        return self._finish(moved, reward, terminated, is_late and not terminated, pressed)

    def _inform(self, pressed: tuple[int, ...], success: bool) -> dict[str, Any]:
        info = super()._inform(pressed, success)
        return info | {"seconds": info.pop("primitives") * self.time_step, "time_step": self.time_step}
