"""Placements: positions, m, and rotations by roll, pitch and yaw as in URDF files (R = Rz Ry Rx), rad."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hrl_escape.errors import ConfigError


def read_placement(value: Any, name: str) -> NDArray[np.float64]:
    """Return a placement as a matrix (4, 4).

    Args:
        value: a position (3,), m; position, roll, pitch and yaw (6,), m and rad; or a matrix (4, 4).
        name: name of the value for messages.

    Raises:
        ConfigError: it is none of these.
    """
    try:
        given = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        given = np.zeros(0)
    if given.shape not in ((3,), (6,), (4, 4)) or not np.isfinite(given).all():
        raise ConfigError(name, value, "x, y, z in m; x, y, z, roll, pitch, yaw in m and rad; or a placement (4, 4)")
    if given.shape == (4, 4):
        turn = given[:3, :3]
        if not (np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) and np.linalg.det(turn) > 0.0
                and np.allclose(given[3], (0.0, 0.0, 0.0, 1.0))):
            raise ConfigError(name, given.tolist(), "a placement (4, 4) whose upper left part is a rotation")
        return given.copy()
    placement = np.eye(4)
    placement[:3, 3] = given[:3]
    if given.shape == (6,):
        placement[:3, :3] = make_rotation(*given[3:].tolist())
    return placement


def make_rotation(roll: float, pitch: float, yaw: float) -> NDArray[np.float64]:
    """Return the rotation of roll, pitch and yaw, (3, 3)."""
    turn = np.eye(3)
    for axis, angle in zip(np.eye(3), (roll, pitch, yaw), strict=True):
        turn = rotate_about(axis, angle) @ turn
    return turn


def rotate_about(axis: NDArray[np.float64], angle: ArrayLike) -> NDArray[np.float64]:
    """Return rotation matrices (..., 3, 3) about a unit axis (3,) by angles, rad, by Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = np.sin(angle)[..., None, None], np.cos(angle)[..., None, None]
    return np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross)


def compute_roll_pitch_yaw(turn: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return roll, pitch and yaw of a rotation (3, 3), rad."""
    pitch = math.atan2(-turn[2, 0], math.hypot(turn[0, 0], turn[1, 0]))
    if math.cos(pitch) < 1e-9:
        return 0.0, pitch, math.atan2(-turn[0, 1], turn[1, 1])
    return math.atan2(turn[2, 1], turn[2, 2]), pitch, math.atan2(turn[1, 0], turn[0, 0])
