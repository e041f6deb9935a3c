"""The Escape Room with velocities as actions: the same rooms and rules, with time steps instead of primitives."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.presets import ConfigForm
from hrl_escape.env.rewards import Events
from hrl_escape.env.velocities import Velocities
from hrl_escape.errors import ConfigError


class EscapeRoomContinuousEnv(EscapeRoomEnv):
    """The rooms of `EscapeRoomEnv` with velocities as actions.

    ## Action space
    `Box`, float32, in this order. Values beyond the bounds are clipped:

    | number | unit | bound |
    |---|---|---|
    | velocity forward | m/s | `speed` |
    | velocity to the left, where the base strafes | m/s | `speed` |
    | turn, counter-clockwise | rad/s | `turn_speed` |
    | each joint | rad/s | `joint_speed`, or the URDF's where that is less |
    | gripper, where the robot has one: above 1/2 it grips, below -1/2 it releases | | 1 |
    | use, where the robot has it: above 1/2 it uses, unless the gripper acts | | 1 |

    In one step the base moves straight until its first contact, in the direction of its heading half-way through the
    turn, and then turns on the spot. Joints stop at their limits. Under physics, Bullet moves everything at once. A
    touch counts if it exists at the end of the step. The hand acts last, with the effect of the primitive of that name;
    a value that is held acts again in each step. If things can be pushed, the base pushes a thing in its way
    like a move in the nearest of the map's four directions. If that does not free the way, nothing moves.

    ## Rewards
    The cost of a primitive (`reward.step`, -1 by default) is charged per second: a step costs `time_step` of it.
    Puzzles and the exit pay the same amounts as in `EscapeRoomEnv`, and an act of the hand its full amount. If the
    reward of the exit replaces that of the step, the difference in cost between a primitive and a step is added.

    ## Episode end
    As in `EscapeRoomEnv`; `truncated` after `time_limit` seconds.

    ## Information
    `info` has `seconds` since the episode began and `time_step`, instead of `primitives`.

    ## Arguments
    Args:
        config: as in `EscapeRoomEnv`, as are all arguments after `time_limit`.
        time_step: duration of a step, s; under physics a multiple of 1/240 s.
        speed: largest speed of the base along each of its axes, m/s.
        turn_speed: largest turn speed of the base, rad/s.
        joint_speed: largest speed of each joint, rad/s.
        time_limit: s, or None for as many seconds as the horizon has primitives. In grid worlds a move covers 2 m or
            more: raise `time_limit` or `speed` there.

    Attributes:
        velocities: bounds, time step and time limit.
    """

    def __init__(self, config: ConfigForm = "paper-two-button", *, time_step: float = 0.1, speed: float = 1.0,
                 turn_speed: float = 1.5, joint_speed: float = 1.0, time_limit: float | None = None, **settings: Any
                 ) -> None:
        self.velocities = Velocities(time_step, speed, turn_speed, joint_speed, time_limit)
        super().__init__(config, **settings)
        EzPickle.__init__(self, config, **dataclasses.asdict(self.velocities), **settings)

    def _make_action_space(self) -> spaces.Space[Any]:
        self._top = np.array(self.velocities.list_bounds(self.instance.robot))
        return spaces.Box(-self._top.astype(np.float32), self._top.astype(np.float32))

    def _count_steps(self) -> int:
        return self.velocities.count_steps(self.instance.horizon)

    def describe(self) -> dict[str, Any]:
        """Return the description of `EscapeRoomEnv` with velocities and times added."""
        return super().describe() | dataclasses.asdict(self.velocities)

    def step(self, action: NDArray[Any]) -> tuple[NDArray[Any], float, bool, bool, dict[str, Any]]:  # type: ignore[override]
        """Move for one time step. Returns (observation, reward, terminated, truncated, info).

        Raises:
            ConfigError: the action has the wrong shape, or a number that is not finite.
        """
        state, room = self._require_episode()
        try:
            rates = np.asarray(action, dtype=np.float64)
        except (TypeError, ValueError):
            rates = np.zeros(0)
        if rates.shape != self._top.shape or not np.isfinite(rates).all():
            raise ConfigError("action", action, f"{len(self._top)} finite numbers")
        rates = np.clip(rates, -self._top, self._top).tolist()
        done = room.glide(self.velocities.make_glide(self.rules, state, rates))
        return self._finish(*self.velocities.judge(done, self.instance))

    def _inform(self, events: Events) -> dict[str, Any]:
        info, time_step = super()._inform(events), self.velocities.time_step
        return info | {"seconds": info.pop("primitives") * time_step, "time_step": time_step}
