"""`pixels`: the picture of the robot's camera."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.engine import Renderer
from hrl_escape.env.kinematics import RoomState, Rules
from hrl_escape.env.observations.base import Observer, register_observation
from hrl_escape.errors import UnsupportedError

PIXELS = (84, 84)


class PixelObserver(Observer):
    """The picture of the robot's camera, uint8."""

    name = "pixels"
    doc = "84 x 84 RGB from the robot's camera"
    is_vector = False
    names = ()
    low = np.zeros((*PIXELS, 3), dtype=np.uint8)
    high = np.full((*PIXELS, 3), 255, dtype=np.uint8)

    def __init__(self, rules: Rules, renderer: Renderer | None = None) -> None:
        super().__init__(rules)
        if renderer is None:
            raise UnsupportedError("pixels need an engine's renderer: use EscapeRoomEnv, or a vector observation")
        self._renderer = renderer

    def observe(self, state: RoomState) -> NDArray[np.uint8]:
        """Return the picture of the robot's camera, uint8 (height, width, 3)."""
        return self._renderer.render(state, "robot", *PIXELS)


register_observation(PixelObserver)
