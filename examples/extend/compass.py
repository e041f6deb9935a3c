"""An observation: the heading of the robot, in one room and in a batch."""

import numpy as np

from hrl_escape.env.observations.base import Observer


class Compass(Observer):
    """Sine and cosine of the heading."""

    name, doc = "compass", "sine and cosine of the heading"
    names = ("sin-heading", "cos-heading")
    low, high = -np.ones(2, np.float32), np.ones(2, np.float32)

    def observe(self, state):
        """Return the observation of a state, shape (2,)."""
        heading = self._rules.get_heading(state)
        return np.array((np.sin(heading), np.cos(heading)), np.float32)

    @staticmethod
    def observe_batch(rooms):
        """Return the observations of all rooms, as parts of shape (n, 2)."""
        import torch

        cos, sin = rooms.rotation
        return [torch.stack([sin, cos]).to(torch.float32)]
