"""`MotionPath`: a path through coordinates of a robot, and its corners rounded within the clearance that it has."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PPoly


@dataclasses.dataclass(frozen=True, eq=False)
class MotionPath:
    """Path through coordinates of a robot, in straight lines.

    Attributes:
        names: of the coordinates: joints, or `x`, `y`, `heading` and joints.
        points: places to go through, shape (n, coordinates), m and rad.
        scale: metres by which a point of the robot moves at most for each unit of a coordinate, shape (coordinates,).
        margin: largest deviation from the path without a collision, in metres of motion.
        planner: planner that found it.
        checks: places that were tested.
        seconds: wall time.
    """

    names: tuple[str, ...]
    points: NDArray[np.float64]
    scale: NDArray[np.float64]
    margin: float
    planner: str
    checks: int = 0
    seconds: float = 0.0

    def interpolate(self, step: float) -> NDArray[np.float64]:
        """Points along the path at most `step` apart in every coordinate, corners included; shape (m, coordinates)."""
        points = [self.points[:1]]
        for a, b in zip(self.points, self.points[1:], strict=False):
            count = max(1, math.ceil(float(np.abs(b - a).max()) / step))
            points.append(a + (b - a) * (np.arange(1, count + 1) / count)[:, None])
        return np.concatenate(points)


def round_corners(path: MotionPath) -> PPoly:
    """Path with its corners replaced by parabolas that stay within the margin; twice differentiable in pieces.

    At a corner P with the unit directions u before and v after it, the parabola from P - l u by P to P + l v comes
    nearest to P in its middle, l (v - u) / 4 away.

    Returns:
        Polynomials of degree 2 over metres of motion, from 0 on.
    """
    points = path.points * path.scale
    keep = np.concatenate([[True], np.abs(np.diff(points, axis=0)).sum(axis=1) > 1e-9])
    points = points[keep]
    lengths = np.sqrt((np.diff(points, axis=0) ** 2).sum(axis=1))
    if not len(lengths):
        return PPoly(np.stack([np.zeros((1, points.shape[1])), points[:1] / path.scale]), [0.0, 1e-9])
    ways = np.diff(points, axis=0) / lengths[:, None]
    pieces: list[tuple[float, NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]] = []
    at, done = points[0], 0.0
    for k, way in enumerate(ways):
        cut = 0.0
        if k + 1 < len(ways):
            bend = ways[k + 1] - way
            turn = float(np.abs(bend).sum())
            cut = min(4.0 * path.margin / turn if turn > 1e-12 else 0.0, lengths[k] / 2, lengths[k + 1] / 2)
        straight = lengths[k] - done - cut
        if straight > 1e-12:
            pieces.append((straight, at, way, np.zeros_like(way)))
        at, done = points[k + 1] - cut * way, cut
        if cut > 0.0:
            pieces.append((2.0 * cut, at, way, (ways[k + 1] - way) / (4.0 * cut)))
            at = points[k + 1] + cut * ways[k + 1]
    breaks = np.concatenate([[0.0], np.cumsum([length for length, *_ in pieces])])
    coefficients = np.array([[bend / path.scale, way / path.scale, begin / path.scale]
                             for _, begin, way, bend in pieces])
    return PPoly(coefficients.transpose(1, 0, 2), breaks)
