"""A path of straight lines as a motion in time.

It is timed by Ruckig (Berscheid and Kroeger 2021), under limits of speed, acceleration and jerk.
On a line all coordinates share one profile. At a corner the velocity goes from the first line's to the second's
along the straight line between the two, also by one profile: from w to w' in T seconds. By its symmetry the corner
begins w T / 2 before the point and ends w' T / 2 behind it, and passes it at most |w' - w| T / 8 away. So every limit
that holds for the ends of a profile holds all along it, including the limits of the base in every direction.
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
from hrl_escape.planning.paths.problem import MotionPath

HALVINGS = 40
"""Number of halvings to find the speed at a corner."""


class TimedPath(NamedTuple):
    """Knots of a motion from rest to rest, of constant jerk between them."""

    times: NDArray[np.float64]  # rising from 0, shape (n,), s
    positions: NDArray[np.float64]  # shape (n, coordinates), m and rad
    velocities: NDArray[np.float64]  # shape (n, coordinates), m/s and rad/s


def evaluate_motion(motion: TimedPath, times: NDArray[np.float64], order: int = 0) -> NDArray[np.float64]:
    """Evaluate the cubic Hermite curve through the knots of a motion, or a derivative of it.

    Args:
        motion: two knots or more.
        times: times within the motion, any shape, s.
        order: number of derivatives, 0 to 3.

    Returns:
        Values, float64 (..., coordinates).
    """
    knots, positions, velocities = motion
    line = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(knots) - 2)
    spans = np.diff(knots)[:, None]
    slopes = np.diff(positions, axis=0) / spans
    bends = (velocities[:-1] + velocities[1:] - 2.0 * slopes) / spans
    coefficients = positions[:-1], velocities[:-1], (slopes - velocities[:-1]) / spans - bends, bends / spans
    since = (times - knots[line])[..., None]
    values, power = np.zeros((*np.shape(times), positions.shape[1])), np.ones_like(since)
    for degree, coefficient in enumerate(coefficients[order:], start=order):
        values += coefficient[line] * power * math.perm(degree, order)
        power = power * since
    return values


class _Lines:
    """A path of straight lines and the corners between them, to be passed at shares of full speed.

    `points` are float64 (lines + 1, coordinates), `lengths` (lines,), `ways` the directions (lines, coordinates).
    `caps` are the largest speed, acceleration and jerk along each line, (lines, 3). `bends` are the changes of velocity
    at corners at full speed, (lines - 1, coordinates), and `strength` their limits, (lines - 1, 3).
    """

    def __init__(self, path: MotionPath, rates: NDArray[np.float64]) -> None:
        self._rates, self._is_base, self._margin = rates, path.names[:2] == ("x", "y"), path.margin
        self.points = path.points[np.append(True, self._measure(np.diff(path.points, axis=0)).max(axis=1) > 1e-9)]
        changes = np.diff(self.points, axis=0)
        self.lengths = self._measure(changes).max(axis=1)
        self.ways = changes / self.lengths[:, None]
        self.caps = self._limit(self.ways)
        self.bends = np.diff(self.caps[:, :1] * self.ways, axis=0)
        self.strength = self._limit(self.bends)
        self._deviations = np.abs(self.bends * path.scale).sum(axis=1) / 8.0
        self._is_straight = self._measure(self.bends).max(axis=1, initial=0.0) < 1e-9

    def _measure(self, vectors: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sizes that are limited, of vectors (n, coordinates); for the base, of its motion in the plane."""
        sizes = np.abs(vectors)
        if self._is_base:
            sizes[:, :2] = np.hypot(vectors[:, 0], vectors[:, 1])[:, None]
        return sizes

    def _limit(self, vectors: NDArray[np.float64]) -> NDArray[np.float64]:
        """Largest first, second and third derivative of a share of each vector, shape (n, 3)."""
        return (self._rates / np.maximum(self._measure(vectors), 1e-12)[:, :, None]).min(axis=1)

    def bend(self, corner: int, share: float) -> float:
        """Time of a corner at a share of full speed, s."""
        k = corner - 1
        if share == 0.0 or not 0 <= k < len(self.bends) or self._is_straight[k]:
            return 0.0
        return compute_ramp(self.strength[k, 1] / share, self.strength[k, 2] / share)

    def is_roundable(self, corner: int, share: float) -> bool:
        """True if a corner can be rounded at a share of full speed, within the margin and both lines."""
        seconds = self.bend(corner, share)
        cuts = share * self.caps[corner - 1 : corner + 1, 0] * seconds
        deviation = share * self._deviations[corner - 1] * seconds
        return deviation <= self._margin and bool((cuts <= self.lengths[corner - 1 : corner + 1]).all())

    def get_straight(self, line: int, begin: float, end: float) -> float:
        """Length of a line without its corners, which it begins and ends with at these shares of full speed."""
        cut = begin * self.bend(line, begin) + end * self.bend(line + 1, end)
        return self.lengths[line] - self.caps[line, 0] * cut / 2.0

    def is_passable(self, line: int, begin: float, end: float) -> bool:
        """True if a line is long enough to change its speed from one share to the other."""
        change, (speed, acceleration, jerk) = abs(end - begin) * self.caps[line, 0], self.caps[line]
        ramp = compute_ramp(acceleration / change, jerk / change) if change > 0.0 else 0.0
        return speed * (begin + end) / 2.0 * ramp <= self.get_straight(line, begin, end)

    def choose_shares(self) -> list[float]:
        """Choose the largest share of full speed at each corner, and rest at both ends."""
        lines = range(len(self.ways))
        shares = [0.0, *(_find_largest(0.0, 1.0, lambda q, k=k: self.is_roundable(k, q)) for k in lines[1:]), 0.0]
        for line in reversed(lines):
            if shares[line] > shares[line + 1]:
                end = shares[line + 1]
                shares[line] = _find_largest(end, shares[line], lambda q, k=line, e=end: self.is_passable(k, q, e))
        for line in lines:
            if shares[line + 1] > shares[line]:
                begin, end = shares[line : line + 2]
                shares[line + 1] = _find_largest(begin, end, lambda q, k=line, b=begin: self.is_passable(k, b, q))
        return shares


def time_path(path: MotionPath, rates: NDArray[np.float64]) -> TimedPath:
    """Time a path; it rests at corners that its margin does not let it round.

    `rates` are the largest speed, acceleration and jerk of each coordinate, shape (coordinates, 3).
    """
    lines = _Lines(path, rates)
    if not len(lines.ways):
        return TimedPath(np.zeros(1), lines.points, np.zeros_like(lines.points))
    shares = lines.choose_shares()
    knots, now = [(0.0, lines.points[0], np.zeros(len(path.names)))], 0.0
    for line, way in enumerate(lines.ways):
        begin, end = shares[line : line + 2]
        top, straight = lines.caps[line, 0], lines.get_straight(line, begin, end)
        at = lines.points[line] + top * begin * lines.bend(line, begin) / 2.0 * way
        if straight > 1e-12:
            for moment, done, speed in _run_profile(straight, top * begin, top * end, lines.caps[line]):
                knots.append((now + moment, at + done * way, speed * way))
            now = knots[-1][0]
        if lines.bend(line + 1, end) > 0.0:
            at, before, change = at + straight * way, top * end * way, end * lines.bends[line]
            for moment, done, share in _run_profile(None, 0.0, 1.0, lines.strength[line] / end):
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

    A length of None asks for the shortest time, however long the way. Limits are of speed, acceleration and jerk.

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
        raise ConfigError("limits", limits.tolist(), "limits that allow the path")
    profile = found.profiles[0][0]
    ends = [length if length is not None else profile.p[-1], end]
    phases, moment = [], 0.0
    for seconds, way, speed in zip(profile.t, profile.p[1:], profile.v[1:], strict=True):
        moment += seconds
        if seconds > 1e-12:
            phases.append((moment, way, speed))
    return [*phases[:-1], (phases[-1][0], *ends)] if phases and math.isfinite(moment) else []
