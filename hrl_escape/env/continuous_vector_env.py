"""Thousands of Escape Rooms with velocities as actions as one Gymnasium `VectorEnv` over the batched engine."""

from __future__ import annotations

import dataclasses
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor

from hrl_escape.env.batched.engine import RoomInfo
from hrl_escape.env.presets import ConfigForm
from hrl_escape.env.vector_env import EscapeRoomVectorEnv
from hrl_escape.env.velocities import Velocities


class EscapeRoomContinuousVectorEnv(EscapeRoomVectorEnv):
    """The rooms of `EscapeRoomVectorEnv` with the velocities of `EscapeRoomContinuousEnv` as actions.

    Actions are floats (num_envs, numbers), clipped to the bounds of the action space: a list, an array, or a tensor on
    the device. `infos` has `seconds` since each episode began, float64, and `time_step`, instead of `primitives`.

    ## Arguments
    Args:
        num_envs: number of rooms.
        config: preset name, `RoomConfig`, or the dict form of one; kinematic dynamics only.
        time_step: duration of a step, s.
        speed: largest speed of the base along each of its axes, m/s.
        turn_speed: largest turn speed of the base, rad/s.
        joint_speed: largest speed of each joint, rad/s.
        time_limit: s, or None for as many seconds as the room's horizon has primitives.
        settings: all other arguments of `EscapeRoomVectorEnv`.

    Attributes:
        velocities: bounds, time step and time limit.
    """

    velocities: Velocities

    def __init__(self, num_envs: int = 1, config: ConfigForm = "paper-two-button", *, time_step: float = 0.1,
                 speed: float = 1.0, turn_speed: float = 1.5, joint_speed: float = 1.0, time_limit: float | None = None,
                 **settings: Any) -> None:
        self.velocities = Velocities(time_step, speed, turn_speed, joint_speed, time_limit)
        super().__init__(num_envs, config, **settings)

    def _make_action_space(self) -> spaces.Space:
        top = np.array(self.velocities.list_bounds(self.room.layout.robot), dtype=np.float32)
        return spaces.Box(-top, top)

    def make_single_env(self) -> gymnasium.Env:
        """Make an `EscapeRoomContinuousEnv` with the same rooms, observation and velocities."""
        from hrl_escape.env.continuous import EscapeRoomContinuousEnv  # brings Bullet in

        return self._limit(
            EscapeRoomContinuousEnv(**self.rooms.list_single_arguments(), **dataclasses.asdict(self.velocities)))

    def describe(self) -> dict[str, Any]:
        """Return the description of `EscapeRoomVectorEnv` with velocities and times added."""
        return super().describe() | dataclasses.asdict(self.velocities)

    def _tell_time(self, info: RoomInfo) -> dict[str, Tensor]:
        seconds = info.primitives.to(torch.float64) * self.velocities.time_step
        return {"seconds": seconds, "time_step": torch.full_like(seconds, self.velocities.time_step)}
