"""Tests of an arm's motions, with or without its base: straight lines, at places on them and as a whole."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from functools import lru_cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from hrl_escape.planning.arm.model import ArmCollisions
from hrl_escape.planning.paths.problem import CheckerBudget

BaseTest: TypeAlias = Callable[[NDArray[np.float64], float], bool]
"""Test of the base: true if it fits at coordinates with a margin, m."""
TESTED = 0.05
"""Distance of the postures that are tested before a motion is certified, in metres of motion."""
LEAST_SHARE = 0.75
"""Share of its margin below which a pair of bodies ends a motion."""
_LONGEST = 0.1  # longest part of a motion that is certified by one test, in metres of motion


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

        Each part of it is tested in its middle, with as much more distance as the bodies can approach within the part.
        Where that is too much, the part is halved. A motion is refused where a middle keeps less than `LEAST_SHARE` of
        a margin, as the parts would become too short.

        Raises:
            Spent: the budget is used up.
        """
        move = end - begin
        change = np.abs(move if self.place is None else np.concatenate([np.zeros(3), move]))
        base_motion = float(change[:2].sum() + change[2] * self.collisions.sweeps[-1])
        count = max(1, math.ceil(float(np.abs(move) @ self.scale) / _LONGEST))
        half, middles = 0.5 / count, [(k + 0.5) / count for k in range(count)]
        while middles:
            around, long = half * change, []
            for middle in middles:
                at = begin + middle * move
                if not self._keeps(0.5, at, base_motion * half if base_motion else None, around):
                    if not self._keeps(LEAST_SHARE, at, 0.0 if base_motion else None):
                        return False
                    long.append(middle)
            half /= 2.0
            middles = [middle + side for middle in long for side in (-half, half)]
        return True

    def _keeps(self, share: float, at: NDArray[np.float64], base_motion: float | None,
               around: NDArray[np.float64] | None = None) -> bool:
        """Return whether base and arm keep a share of their margins, also where coordinates deviate.

        The base is tested with as many metres more as `base_motion`; it is not for None.
        """
        self.budget.spend(1)
        return ((base_motion is None or self.does_base_fit(at, share * self.margin + base_motion))
                and self.collisions.keeps(share, *split_coordinates(at, self.place), around))


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
