"""`state`: the paper's state vector (section 4.1) in natural units, m and rad."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.engine import Renderer
from hrl_escape.env.kinematics import RoomState, Rules
from hrl_escape.env.observations.base import BatchView, Observer, register_observation

if TYPE_CHECKING:
    from torch import Tensor


class StateObserver(Observer):
    """Position, heading, pitch and roll, the puzzle's numbers, and joint angles."""

    name = "state"
    doc = "the paper's state vector: pose, puzzle and joints in natural units"

    def __init__(self, rules: Rules, renderer: Renderer | None = None) -> None:
        super().__init__(rules)
        instance = self._instance
        self.names = ("x", "y", "z", "heading", "pitch", "roll", *self._puzzle_names, *self._joint_names)
        frame, top = self._frame, self._frame.wall_height + instance.robot.body_height
        limits = [(-frame.reach_x, frame.reach_x), (-frame.reach_y, frame.reach_y), (-1.0, top),
                  *[(-math.pi, math.pi)] * 3, *frame.bounds, *rules.robot.limits]
        self.low, self.high = np.array(limits, dtype=np.float32).T.copy()

    def observe(self, state: RoomState) -> NDArray[np.float32]:
        """Return a new float32 array with one entry per name."""
        rules = self._rules
        return np.array((state.x, state.y, state.z, rules.get_heading(state), state.pitch, state.roll,
                         *self._get_puzzle(state), *rules.get_angles(state)), dtype=np.float32)

    @staticmethod
    def observe_batch(rooms: BatchView) -> list[Tensor]:
        """Return parts of the vector, float32 (numbers, rooms) each."""
        import torch

        x, y, heading = (number.to(torch.float32) for number in (rooms.x, rooms.y, rooms.heading))
        nought = torch.zeros_like(x)
        pose = torch.stack([x, y, nought, heading, nought, nought])
        return [pose, rooms.puzzle, rooms.angles.to(torch.float32)]


register_observation(StateObserver)
