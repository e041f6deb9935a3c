"""Inverse kinematics of an arm: postures that bring its hand to a target, and how good they are."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.placements import read_placement
from hrl_escape.env.robot import Robot
from hrl_escape.planning.arm.model import ArmKinematics

DISTINCT = 0.05
"""Postures nearer to each other than this in every joint are one, rad."""


@dataclasses.dataclass(frozen=True, eq=False)
class ArmPosture:
    """Configuration of the arm that brings the hand to a target."""

    angles: NDArray[np.float64]  # joint angles, shape (joints,), rad
    margin: float  # least distance of a joint from its limits, rad; at most pi, as continuous joints have none
    manipulability: float
    """Yoshikawa's measure, sqrt(det(J J^T)), of the hand's translation, and of its rotation too if the target was a
    pose (Yoshikawa 1985); of J^T J for arms with fewer joints than rows."""
    is_free: bool  # no link meets a solid, the shut door or another link


def read_target(target: Any, base: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a target in the base frame: position (3,), m, or placement (4, 4).

    Args:
        target: position (3,), m; position, roll, pitch and yaw (6,), m and rad; or placement (4, 4), in the frame of
            the room or world.
        base: placement of the base there, (4, 4).

    Raises:
        ConfigError: it is none of these.
    """
    goal, inverse = read_placement(target, "target"), np.linalg.inv(base)
    return inverse[:3, :3] @ goal[:3, 3] + inverse[:3, 3] if np.shape(target) == (3,) else inverse @ goal


def find_postures(arm: ArmKinematics, goal: NDArray[np.float64], first: NDArray[np.float64], seeds: int,
                  tolerance: float, is_free: Callable[[Sequence[float]], bool], only_free: bool) -> list[ArmPosture]:
    """Find the postures that bring the hand to a goal, those farthest from joint limits first.

    Levenberg-Marquardt searches begin at `first` and at points of a Halton sequence between the joint limits; postures
    that coincide count once. Joints that do not move the hand stay as in `first`.

    Args:
        arm: kinematics of the arm and hand.
        goal: position (3,), m, or placement (4, 4), in the base frame.
        first: joint angles, (joints,), rad.
        seeds: searches.
        tolerance: largest distance from the goal, m; for a placement also the largest rotation from it, rad.
        is_free: tests joint angles for collisions.
        only_free: leave out postures in collision.
    """
    robot, moves = arm.robot, arm.moves_hand
    low, high = np.array(robot.limits).T
    here = np.clip(first, low, high)
    starts = np.concatenate([here[None], low + (high - low) * make_halton(max(0, seeds - 1), len(low))])
    starts[:, ~moves] = here[~moves]
    found: list[NDArray[np.float64]] = []
    for seed in starts.tolist():
        angles = arm.solve_ik(goal, seed, tolerance)
        if angles is not None and all(np.abs(subtract_angles(robot, angles, other)).max() > DISTINCT
                                      for other in found):
            found.append(angles)
    limited, rows = moves & ~np.array(robot.continuous), 3 if goal.shape == (3,) else 6
    postures = [ArmPosture(angles, float(np.minimum(angles - low, high - angles).min(where=limited, initial=np.pi)),
                           measure_manipulability(arm, angles, rows), is_free(angles.tolist())) for angles in found]
    return sorted((p for p in postures if p.is_free or not only_free), key=lambda p: -p.margin)


def subtract_angles(robot: Robot, angles: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the difference of configurations (..., joints), rad, that of continuous joints within [-pi, pi]."""
    difference = angles - others
    turned = difference - np.round(difference / math.tau) * math.tau
    return np.where(robot.continuous, turned, difference)


def measure_manipulability(arm: ArmKinematics, angles: NDArray[np.float64], rows: int) -> float:
    """Return Yoshikawa's measure, as in `ArmPosture`, of the first rows of the Jacobian."""
    jacobian = arm.compute_jacobian(angles.tolist())[:rows, arm.moves_hand]
    square = jacobian @ jacobian.T if jacobian.shape[1] >= rows else jacobian.T @ jacobian
    return math.sqrt(max(0.0, float(np.linalg.det(square))))


def make_halton(count: int, dimensions: int) -> NDArray[np.float64]:
    """Return the first points of the Halton sequence in the unit cube, shape (count, dimensions)."""
    from scipy.stats import qmc  # takes half a second to load

    return qmc.Halton(dimensions, scramble=False).fast_forward(1).random(count)
