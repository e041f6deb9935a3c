"""`features`: all numbers scaled into [-1, 1]; the default for training."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.engine import Renderer
from hrl_escape.env.kinematics import RoomState, Rules
from hrl_escape.env.observations.base import BatchView, Observer, clip, register_observation

if TYPE_CHECKING:
    from torch import Tensor


class FeatureObserver(Observer):
    """Position over the floor's half size, sine and cosine of the heading, joint angles over their limits, the puzzle.

    The puzzle's numbers are rescaled unless they are bits.
    """

    name = "features"
    doc = "position, heading, joints and puzzle scaled into [-1, 1]"

    def __init__(self, rules: Rules, renderer: Renderer | None = None) -> None:
        super().__init__(rules)
        self.names = ("x", "y", "sin-heading", "cos-heading", *self._joint_names, *self._puzzle_names)
        self._reach = self._frame.reach_x, self._frame.reach_y
        self.high = np.ones(len(self.names), dtype=np.float32)
        self.low = -self.high

    def observe(self, state: RoomState) -> NDArray[np.float32]:
        """Return a new float32 array with one entry per name."""
        rules = self._rules
        cos, sin = rules.get_rotation(state.heading_steps, state.heading_offset)
        joints = [clip(a / m) for a, m in zip(rules.get_angles(state), self._joint_limits, strict=True)]
        x, y = clip(state.x / self._reach[0]), clip(state.y / self._reach[1])
        return np.array((x, y, sin, cos, *joints, *self._get_puzzle(state)), dtype=np.float32)

    def _scale_puzzle(self, numbers: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(value if (low, high) == (0.0, 1.0) else clip(2 * (value - low) / (high - low) - 1)
                     for value, (low, high) in zip(numbers, self._puzzle.bounds, strict=True))

    @staticmethod
    def observe_batch(rooms: BatchView) -> list[Tensor]:
        """Return parts of the vector, float32 (numbers, rooms) each; the puzzle's numbers are not scaled."""
        import torch

        half_x, half_y = rooms.half_sizes
        x, y, cos, sin = (number.to(torch.float32) for number in (rooms.x, rooms.y, *rooms.rotation))
        limits = [max(abs(low), abs(high)) for low, high in rooms.limits]
        angles = rooms.angles.to(torch.float32).unbind()
        joints = [angle / limit for angle, limit in zip(angles, limits, strict=True)]
        x, y, *joints = (number.clamp(-1.0, 1.0) for number in (x / half_x, y / half_y, *joints))
        return [*(number.unsqueeze(0) for number in (x, y, sin, cos, *joints)), rooms.puzzle]


register_observation(FeatureObserver)
