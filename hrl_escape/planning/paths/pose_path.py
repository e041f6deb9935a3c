"""Paths of a rectangular base in SE(2): place and heading, by OMPL's single-query planners.

A disc's path is one of places, as it may turn anywhere. A rectangle's is one of poses, tested with a margin that
covers all poses between two tested ones: between poses `s` apart, with headings scaled by half the diagonal to
metres, no point of the rectangle is farther than s / sqrt(2) from where it was tested.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrl_escape.errors import PathPlannerError, UnsupportedError
from hrl_escape.floor.clearance import CollisionMap
from hrl_escape.planning.paths.planners import OMPL_PLANNERS, find_joint_path
from hrl_escape.planning.paths.problem import SPACING, CheckerBudget, step_aside

_ASIDE = (1.0, 1.5, 2.0, 4.0)
"""Margins by which a pose in contact is left before the search."""
_MOST_ENDS = 64


def check_pose_planner(name: str) -> None:
    """Refuse a path planner that plans in the plane only.

    Raises:
        UnsupportedError: the message lists those that plan poses.
    """
    if name not in OMPL_PLANNERS:
        raise UnsupportedError(f"path planner {name!r} plans places of a disc; poses of a rectangular base are planned "
                               f"by {', '.join(OMPL_PLANNERS)}")


def find_pose_path(collision: CollisionMap, start: NDArray[np.float64], ends: NDArray[np.float64], planner: str,
                   seed: int, budget: CheckerBudget) -> NDArray[np.float64] | None:
    """Find a path of poses from a start to any of some ends.

    Args:
        collision: the room.
        start: x, y and heading, shape (3,), m and rad; the base fits there.
        ends: poses of which any will do, shape (n, 3); the base fits there.
        planner: one of `OMPL_PLANNERS`.
        seed: the same seed gives the same path.
        budget: poses that may be tested, and the time limit.

    Returns:
        Poses to go through in straight lines while turning evenly, shape (k, 3), or None.

    Raises:
        OutOfTime: the clock has run out before there was a path.
        PathPlannerError: the path collides.
    """
    spacing = min(SPACING, collision.inner / 5)
    margin = spacing * math.sqrt(0.5)
    ends = ends[np.linspace(0, len(ends) - 1, min(len(ends), _MOST_ENDS)).astype(int)].copy()
    ends[:, 2] = start[2] + np.remainder(ends[:, 2] - start[2] + math.pi, math.tau) - math.pi
    begin = _move_aside(collision, start, margin)
    pairs = [(end, aside) for end in ends if (aside := _move_aside(collision, end, margin)) is not None]
    if begin is None or not pairs:
        return None
    goals = np.array([aside for _, aside in pairs])
    scale = np.array([1.0, 1.0, collision.radius])
    high = np.array([*-collision.low, start[2] + 1.5 * math.pi])
    low = np.array([*collision.low, start[2] - 1.5 * math.pi])

    def is_free(at: NDArray[np.float64]) -> bool:
        x, y, heading = (at / scale).tolist()
        return collision.does_fit(x, y, (math.cos(heading), math.sin(heading)), margin)

    path = find_joint_path(low * scale, high * scale, begin * scale, goals * scale, is_free, spacing, budget,
                           planner=planner, seed=seed)
    if path is None:
        return None
    path = path / scale
    reached = pairs[int(np.abs((goals - path[-1]) * scale).sum(axis=1).argmin())][0]
    path = np.concatenate([[start], path, [reached]])
    path = path[np.concatenate([[True], np.abs(np.diff(path, axis=0)).max(axis=1) > 1e-12])]
    _check(collision, path, scale, spacing / 4, planner)
    return path


def _move_aside(collision: CollisionMap, pose: NDArray[np.float64], margin: float) -> NDArray[np.float64] | None:
    """Nearest pose with a margin, straight from one that may touch a wall."""
    x, y, heading = pose.tolist()
    rotation = math.cos(heading), math.sin(heading)
    place = step_aside((x, y), heading, [distance * margin + 1e-6 for distance in _ASIDE],
                       lambda x, y: collision.does_fit(x, y, rotation, margin),
                       lambda x, y, to_x, to_y: collision.is_move_free(x, y, to_x, to_y, rotation))
    return None if place is None else np.array([*place, heading])


def _check(collision: CollisionMap, path: NDArray[np.float64], scale: NDArray[np.float64], spacing: float, name: str
           ) -> None:
    """Check a path at poses a quarter as far apart as in the search. Raises `PathPlannerError`."""
    for a, b in zip(path[:-1], path[1:], strict=True):
        count = 1 + math.ceil(float(np.abs((b - a) * scale).sum()) / spacing)
        for x, y, heading in np.linspace(a, b, count).tolist():
            if not collision.does_fit(x, y, (math.cos(heading), math.sin(heading))):
                raise PathPlannerError(f"path planner {name!r} returned a path that collides between {a.tolist()} and "
                                       f"{b.tolist()}")
