"""Paths of the arm round solids for presses by hand: `ArmPlanner` behind the protocol of the primitive search."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import PlanningFailed

if TYPE_CHECKING:
    from hrl_escape.planning.arm.arm_planner import ArmPlanner

__all__ = ["ArmPaths"]

PATH_TESTS = 20_000
"""Most configurations tested for one path."""


class ArmPaths:
    """Paths of one room's arm, the base at rest; picklable.

    Args:
        instance: the room.
    """

    def __init__(self, instance: RoomInstance) -> None:
        self.instance = instance

    def __reduce__(self) -> tuple[type, tuple[RoomInstance]]:
        return type(self), (self.instance,)

    @cached_property
    def _planner(self) -> ArmPlanner:
        from hrl_escape.planning.arm.arm_planner import ArmPlanner  # loads OMPL and scipy, which few presses need

        return ArmPlanner(self.instance)

    def find_path(self, state: RoomState, angles: NDArray[np.float64], step: float) -> NDArray[np.float64] | None:
        """Find a path from a state's posture to another one.

        Args:
            state: base and arm at the beginning.
            angles: joint angles at the end, rad.
            step: largest distance of two places along the path in any joint, rad.

        Returns:
            Joint angles along the path, shape (n, joints), rad; None if none is found.
        """
        try:
            return self._planner.plan(state, angles, budget=PATH_TESTS).interpolate(step)
        except PlanningFailed:
            return None
