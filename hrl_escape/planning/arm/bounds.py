"""Bounds of how far the bodies of an arm move, from its joints and spheres around the bodies."""

# pyright: reportAttributeAccessIssue=false
# (Pinocchio and coal are compiled and carry no types)

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.robot import Robot

_SLIDES = {"JointModelPX", "JointModelPY", "JointModelPZ", "JointModelPrismaticUnaligned"}


class MotionBounds:
    """Bounds of a robot's motions among solids, computed at first use; model and geometry do not change after that."""

    def __init__(self, model: Any, geometry: Any, robot: Robot) -> None:
        self._model, self._geometry, self._robot = model, geometry, robot

    @cached_property
    def moved(self) -> dict[int, tuple[int, float]]:
        """Joints of the model that move with a planned one: its number, and how fast for each unit of it."""
        moved = {self._model.getJointId(name): (number, 1.0) for number, name in enumerate(self._robot.joint_names)}
        return moved | {self._model.getJointId(name): (number, factor)
                        for name, (number, factor, _) in self._robot.mimics.items()}

    def list_moving(self, i: int) -> set[int]:
        """Return the joints above a geometry object that move with a planned joint."""
        return {joint for joint in self._model.supports[self._geometry.geometryObjects[i].parentJoint]
                if joint in self.moved}

    def is_rigid(self, i: int, j: int) -> bool:
        """Return whether no planned joint changes how two geometry objects are placed to each other."""
        return self.list_moving(i) == self.list_moving(j)

    @cached_property
    def sweeps(self) -> NDArray[np.float64]:
        """Farthest that any point of the robot moves for each unit of a joint, links stretched out, (joints + 1,), m.

        The base's turn comes last.
        """
        far = np.zeros(len(self._robot.joint_names) + 1)
        for item in self._geometry.geometryObjects.tolist():
            here = np.zeros_like(far)
            for joint, reach in self._measure_reach(item).items():
                if joint in self.moved:
                    number, factor = self.moved[joint]
                    here[number] += abs(factor) * reach
                elif joint == 1:
                    here[-1] = reach
            far = np.maximum(far, here)
        return far

    @cached_property
    def speeds(self) -> NDArray[np.float64]:
        """Bounds of how far the bodies of each pair approach, (pairs, 3 + joints), m for each unit of a coordinate.

        Coordinates are x, y, heading and joints.
        """
        reaches = [self._measure_reach(item) for item in self._geometry.geometryObjects.tolist()]
        speeds = np.zeros((len(self._geometry.collisionPairs), 3 + len(self._robot.joint_names)))
        for row, pair in zip(speeds, self._geometry.collisionPairs, strict=True):
            first, second = reaches[pair.first], reaches[pair.second]
            for joint in first.keys() ^ second.keys():
                reach = first.get(joint, second.get(joint, 0.0))
                if joint == 1:
                    row[:3] += 1.0, 1.0, reach
                elif joint in self.moved:
                    planned, factor = self.moved[joint]
                    row[3 + planned] += abs(factor) * reach
        return speeds

    def _measure_reach(self, item: Any) -> dict[int, float]:
        """Metres that a shape moves at most for each unit of a joint above it, by the joint's number in the model.

        A solid has no joint above it.
        """
        item.geometry.computeLocalAABB()
        model, reaches = self._model, dict[int, float]()
        reach = float(np.linalg.norm(item.placement.act(item.geometry.aabb_center))) + item.geometry.aabb_radius
        joint = item.parentJoint
        while joint > 0:
            slides = model.joints[joint].shortname() in _SLIDES
            reaches[joint] = 1.0 if slides else reach
            reach += float(np.linalg.norm(model.jointPlacements[joint].translation))
            if slides:
                at = model.joints[joint].idx_q
                reach += float(max(abs(model.lowerPositionLimit[at]), abs(model.upperPositionLimit[at])))
            joint = model.parents[joint]
        return reaches
