"""Time along a path of straight lines, under limits of speed, acceleration and jerk.

By Ruckig (Berscheid and Kroeger 2021).

On a line all coordinates share one profile. At a corner the velocity goes from the first line's to the second's
along the straight line between the two, also by one profile: from w to w' in T seconds. By its symmetry the corner
begins w T / 2 before the point and ends w' T / 2 behind it, and passes it at most |w' - w| T / 8 away. So every limit
that holds for the ends of a profile holds all along it, those of the base in every direction included.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import ruckig
from numpy.typing import NDArray

from hrl_escape.errors import ConfigError
from hrl_escape.planning.motion.limits import compute_ramp
from hrl_escape.planning.motion_path import MotionPath

HALVINGS = 40
"""Halvings by which the speed at a corner is found."""


class TimedPath(NamedTuple):
    """Knots of a motion from rest to rest, of constant jerk between them.

    Attributes:
        times: rising from 0, shape (n,), s.
        positions: shape (n, coordinates), m and rad.
        velocities: shape (n, coordinates), m/s and rad/s.
    """

    times: NDArray[np.float64]
    positions: NDArray[np.float64]
    velocities: NDArray[np.float64]


def time_path(path: MotionPath, rates: NDArray[np.float64]) -> TimedPath:
    """Time a path; it rests at corners that its margin does not let it round.

    Args:
        path: the path.
        rates: largest speed, acceleration and jerk of each coordinate, shape (coordinates, 3).
    """
    def measure(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sizes that are limited, of vectors (n, coordinates): those of the base by its motion in the plane."""
        sizes = np.abs(vectors)
        if path.names[:2] == ("x", "y"):
            sizes[:, :2] = np.hypot(vectors[:, 0], vectors[:, 1])[:, None]
        return sizes

    def limit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
        """Largest first, second and third derivative of a share of each vector, shape (n, 3)."""
        return (rates / np.maximum(measure(vectors), 1e-12)[:, :, None]).min(axis=1)

    points = path.points[np.append(True, measure(np.diff(path.points, axis=0)).max(axis=1) > 1e-9)]
    if len(points) < 2:
        return TimedPath(np.zeros(1), points, np.zeros_like(points))
    changes = np.diff(points, axis=0)
    lengths = measure(changes).max(axis=1)
    ways = changes / lengths[:, None]
    caps = limit(ways)
    bends = np.diff(caps[:, :1] * ways, axis=0)  # change of velocity at each corner, at full speed
    strength, deviations = limit(bends), np.abs(bends * path.scale).sum(axis=1) / 8.0
    is_straight = measure(bends).max(axis=1, initial=0.0) < 1e-9

    def bend(corner: int, share: float) -> float:
        """Time of a corner at a share of full speed, s."""
        k = corner - 1
        if share == 0.0 or not 0 <= k < len(bends) or is_straight[k]:
            return 0.0
        return compute_ramp(strength[k, 1] / share, strength[k, 2] / share)

    def is_roundable(corner: int, share: float) -> bool:
        seconds = bend(corner, share)
        cuts = share * caps[corner - 1 : corner + 1, 0] * seconds
        deviation = share * deviations[corner - 1] * seconds
        return deviation <= path.margin and bool((cuts <= lengths[corner - 1 : corner + 1]).all())

    def get_straight(line: int, begin: float, end: float) -> float:
        """Length of a line without its corners."""
        return lengths[line] - caps[line, 0] * (begin * bend(line, begin) + end * bend(line + 1, end)) / 2.0

    def is_passable(line: int, begin: float, end: float) -> bool:
        change = abs(end - begin) * caps[line, 0]
        ramp = compute_ramp(caps[line, 1] / change, caps[line, 2] / change) if change > 0.0 else 0.0
        return caps[line, 0] * (begin + end) / 2.0 * ramp <= get_straight(line, begin, end)

    shares = [0.0, *(_find_largest(0.0, 1.0, lambda q, k=k: is_roundable(k, q)) for k in range(1, len(ways))), 0.0]
    for line in reversed(range(len(ways))):
        if shares[line] > shares[line + 1]:
            end = shares[line + 1]
            shares[line] = _find_largest(end, shares[line], lambda q, k=line, end=end: is_passable(k, q, end))
    for line in range(len(ways)):
        if shares[line + 1] > shares[line]:
            begin = shares[line]
            shares[line + 1] = _find_largest(begin, shares[line + 1], lambda q, k=line, b=begin: is_passable(k, b, q))

    knots, now = [(0.0, points[0], np.zeros(len(path.names)))], 0.0
    for line, way in enumerate(ways):
        begin, end = shares[line : line + 2]
        top, straight = caps[line, 0], get_straight(line, begin, end)
        at = points[line] + top * begin * bend(line, begin) / 2.0 * way
        if straight > 1e-12:
            for moment, done, speed in _run_profile(straight, top * begin, top * end, caps[line]):
                knots.append((now + moment, at + done * way, speed * way))
            now = knots[-1][0]
        if bend(line + 1, end) > 0.0:
            at, before, change = at + straight * way, top * end * way, end * bends[line]
            for moment, done, share in _run_profile(None, 0.0, 1.0, strength[line] / end):
                knots.append((now + moment, at + moment * before + done * change, before + share * change))
            now = knots[-1][0]
    times, positions, velocities = (np.array(column) for column in zip(*knots, strict=True))
    return TimedPath(times, positions, velocities)


def _find_largest(low: float, high: float, is_right: Callable[[float], bool]) -> float:
    """Largest number that is right, if all below are."""
    if is_right(high):
        return high
    for _ in range(HALVINGS):
        middle = (low + high) / 2.0
        low, high = (middle, high) if is_right(middle) else (low, middle)
    return low


def _run_profile(length: float | None, begin: float, end: float, limits: NDArray[np.float64]
                 ) -> list[tuple[float, float, float]]:
    """Time, way and speed at the end of each phase of the fastest motion between two speeds.

    Args:
        length: of the way; None for the shortest time, however long the way.
        begin: speed.
        end: speed.
        limits: of speed, acceleration and jerk.

    Raises:
        ConfigError: limits so far apart that there is none.
    """
    wanted, found = ruckig.InputParameter(1), ruckig.Trajectory(1)
    wanted.current_velocity, wanted.target_velocity = [begin], [end]
    if length is None:
        wanted.control_interface = ruckig.ControlInterface.Velocity
    else:
        wanted.target_position = [length]
    wanted.max_velocity = [max(float(limits[0]), begin, end)]
    wanted.max_acceleration, wanted.max_jerk = [float(limits[1])], [float(limits[2])]
    if ruckig.Ruckig(1).calculate(wanted, found) not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise ConfigError("limits", limits.tolist(), "limits under which the path can be followed")
    profile = found.profiles[0][0]
    ends = [length if length is not None else profile.p[-1], end]
    phases, moment = [], 0.0
    for seconds, way, speed in zip(profile.t, profile.p[1:], profile.v[1:], strict=True):
        moment += seconds
        if seconds > 1e-12:
            phases.append((moment, way, speed))
    return [*phases[:-1], (phases[-1][0], *ends)] if phases and math.isfinite(moment) else []
