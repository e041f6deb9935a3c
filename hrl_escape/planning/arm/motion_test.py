"""Tests of an arm's motions, with or without its base, as a whole: conservative advancement in a straight line."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from functools import lru_cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from hrl_escape.planning.arm.model import LEAST_SHARE, ArmCollisions
from hrl_escape.planning.paths.problem import CheckerBudget

BaseTest: TypeAlias = Callable[[NDArray[np.float64], float], bool]
"""Test of the base: true if it fits at coordinates with a margin, m."""
TESTED = 0.05
"""Distance of the postures that are tested before a motion is certified, in metres of motion."""
_BASE_ROOMS = (0.5, 0.1)  # m of room around the base, with which it may go so far without another test


@dataclasses.dataclass(frozen=True, eq=False)
class MotionTest:
    """Test of coordinates, joint angles or x, y, heading and joint angles, in m and rad.

    Attributes:
        collisions: of the arm, with the margins that it keeps.
        place: x and y, m, and heading, rad, of a base at rest, or None if coordinates begin with them.
        does_base_fit: tests the base.
        margin: distance that the base keeps from solids, m.
        budget: spent by one for each posture at which a motion is tested.
        scale: largest motion of a point of the robot for each unit of a coordinate, m, (coordinates,).
    """

    collisions: ArmCollisions
    place: tuple[float, float, float] | None
    does_base_fit: BaseTest
    margin: float
    budget: CheckerBudget
    scale: NDArray[np.float64]

    def is_free(self, at: NDArray[np.float64]) -> bool:
        """Return whether base and arm keep their margins at coordinates."""
        return self.does_base_fit(at, self.margin) and self.collisions.is_free(*split_coordinates(at, self.place))

    def is_move_free(self, begin: NDArray[np.float64], end: NDArray[np.float64]) -> bool:
        """Return whether a straight motion from a free place keeps all margins where tested, and half everywhere.

        Raises:
            Spent: the budget is used up.
        """
        count = math.ceil(float(np.linalg.norm((end - begin) * self.scale)) / TESTED)
        for share in _list_shares(count):
            self.budget.spend(1)
            if not self.is_free(begin + share * (end - begin)):
                return False
        return self.keeps_half(begin, end)

    def keeps_half(self, begin: NDArray[np.float64], end: NDArray[np.float64]) -> bool:
        """Return whether a straight motion certainly keeps half of all margins.

        It is refused where it comes nearer than `LEAST_SHARE` of a margin, as the steps would become too short.

        Raises:
            Spent: the budget is used up.
        """
        move, done = end - begin, 0.0
        change = move if self.place is None else np.concatenate([np.zeros(3), move])
        base_motion = float(np.abs(change[:2]).sum() + abs(change[2]) * self.collisions.sweeps[-1])
        rooms = (*_BASE_ROOMS, self.margin, LEAST_SHARE * self.margin)
        while done < 1.0:
            self.budget.spend(1)
            at, most = begin + done * move, 1.0 - done
            if base_motion > 0.0:
                room = next((room for room in rooms if self.does_base_fit(at, room)), None)
                if room is None:
                    return False
                most = min(most, (room - self.margin / 2.0) / base_motion)
            share = self.collisions.advance(*split_coordinates(at, self.place), change, most)
            if share < 0.0:
                return False
            done += share
        return True


@lru_cache(maxsize=256)
def _list_shares(count: int) -> tuple[float, ...]:
    """Return shares of a motion from its end on: halves, then quarters, and so on, at least `count` of them."""
    shares, parts = [1.0], 1
    while len(shares) < count:
        parts *= 2
        shares += [k / parts for k in range(1, parts, 2)]
    return tuple(shares)


def split_coordinates(at: NDArray[np.float64], place: tuple[float, float, float] | None
                      ) -> tuple[float, float, float, list[float]]:
    """Split coordinates into x, y, m, heading, rad, and joint angles, rad; `place` as in `MotionTest`."""
    if place is not None:
        return *place, at.tolist()
    x, y, heading, *angles = at.tolist()
    return x, y, heading, angles
