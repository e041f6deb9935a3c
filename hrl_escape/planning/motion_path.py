"""`MotionPath`: a path through coordinates of a robot, in straight lines."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.robot import Robot


@dataclasses.dataclass(frozen=True, eq=False)
class MotionPath:
    """Path through coordinates of a robot, in straight lines."""

    names: tuple[str, ...]  # of the coordinates: joints, or `x`, `y`, `heading` and joints
    points: NDArray[np.float64]  # places to go through, shape (n, coordinates), m and rad
    scale: NDArray[np.float64]
    """Metres by which a point of the robot moves at most for each unit of a coordinate, shape (coordinates,)."""
    margin: float  # largest deviation from the path without a collision, in metres of motion
    planner: str  # planner that found it
    checks: int = 0  # places that were tested
    seconds: float = 0.0  # wall time
    robot: Robot | None = None  # the robot, whose joints' limits of speed and effort then hold

    def interpolate(self, step: float) -> NDArray[np.float64]:
        """Points along the path at most `step` apart in every coordinate, corners included; shape (m, coordinates)."""
        points = [self.points[:1]]
        for a, b in zip(self.points, self.points[1:], strict=False):
            count = max(1, math.ceil(float(np.abs(b - a).max()) / step))
            points.append(a + (b - a) * (np.arange(1, count + 1) / count)[:, None])
        return np.concatenate(points)
