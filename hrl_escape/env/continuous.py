"""The Escape Room with velocities for actions: the same rooms and rules, a step of time in place of a primitive."""

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
    """The rooms of `EscapeRoomEnv` for agents that choose velocities.

    ## Action space
    `Box`, float32, in this order; numbers beyond the bounds are clipped:

    | number | unit | bound |
    |---|---|---|
    | velocity forward | m/s | `speed` |
    | velocity to the left, where the base strafes | m/s | `speed` |
    | turn, counter-clockwise | rad/s | `turn_speed` |
    | each joint | rad/s | `joint_speed`, or the URDF's where that is less |
    | gripper, where the robot has one: above 1/2 it grips, below -1/2 it releases | | 1 |
    | use, where the robot has it: above 1/2 it uses, unless the gripper acts | | 1 |

    In a step the base goes straight, along its heading in the middle of the turn, until its first contact, which is
    exact; then it turns on the spot. Joints stop at their limits. Under physics all of it moves at once in Bullet.
    A touch counts if it is there at the end of a step. Then the hand acts, as the primitive of that name would from
    there; a level that is held asks anew in each step. A thing in the way of the base is pushed, where things can be,
    as a move from the place of contact to the nearest of the map's four sides would push it; if that does not let the
    base through, nothing moves.

    ## Rewards
    A second costs what a primitive does (`reward.step`, -1 by default), so a step costs `time_step` of it. Puzzles and
    the exit pay what they pay there, an act of the hand each time; where the exit's reward replaces the step's, it is
    more by what a primitive costs beyond a step.

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
        time_limit: s; None for as many seconds as the room's horizon has primitives. Those of rooms from cell to cell
            are moves of 2 m or more: raise the one or `speed`.

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
        """As in `EscapeRoomEnv`, and the numbers of this one."""
        return super().describe() | dataclasses.asdict(self.velocities)

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
        rates = np.clip(rates, -self._top, self._top).tolist()
        done = room.glide(self.velocities.make_glide(self.rules, state, rates))
        return self._finish(*self.velocities.judge(done, self.instance))

    def _inform(self, events: Events) -> dict[str, Any]:
        info, time_step = super()._inform(events), self.velocities.time_step
        return info | {"seconds": info.pop("primitives") * time_step, "time_step": time_step}
