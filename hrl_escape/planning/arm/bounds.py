"""Bounds of how far the bodies of an arm move and how near they are, from joints and spheres around the bodies."""

# pyright: reportAttributeAccessIssue=false
# (Pinocchio and coal are compiled and carry no types)

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.robot import Robot

_SLIDES = {"JointModelPX", "JointModelPY", "JointModelPZ", "JointModelPrismaticUnaligned"}


class PairBounds(NamedTuple):
    """Spheres and speeds of tested pairs of bodies; the second of a pair may be a solid."""

    first: NDArray[np.int64]  # (pairs,), numbers of geometry objects
    second: NDArray[np.int64]
    centres: list[NDArray[np.float64]]  # of the robot's objects' spheres, in their own frames, m
    places: NDArray[np.float64]  # (objects, 3), of all spheres; those of solids are fixed, m
    radii: NDArray[np.float64]  # (pairs,), of both spheres together, m
    speeds: NDArray[np.float64]  # (pairs, 3 + joints), metres for each unit of x, y, heading and joints
    on_solid: NDArray[np.bool_]  # (pairs,)
    turns: NDArray[np.float64]  # (pairs with a solid, 3, 3), the solid's rotation
    halves: NDArray[np.float64]  # (pairs with a solid, 3), half sizes of the solid's box, m
    solid_radii: NDArray[np.float64]  # (pairs with a solid,), of the link's sphere, m

    def bound_distances(self, placements: Any) -> NDArray[np.float64]:
        """Return lower bounds of the distances of the pairs, (pairs,), m, at placements of the objects."""
        places = self.places
        places[: len(self.centres)] = [placements[k].act(centre) for k, centre in enumerate(self.centres)]
        between = places[self.first] - places[self.second]
        away = np.sqrt((between * between).sum(axis=1)) - self.radii
        local = np.abs(between[self.on_solid][:, None, :] @ self.turns)[:, 0]
        outside = np.maximum(local - self.halves, 0.0)
        away[self.on_solid] = np.sqrt((outside * outside).sum(axis=1)) - self.solid_radii
        return away


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
    def pairs(self) -> PairBounds:
        """Bounds of the collision pairs."""
        items = self._geometry.geometryObjects.tolist()
        ends = [(pair.first, pair.second) for pair in self._geometry.collisionPairs]
        first, second = np.array(ends, dtype=np.int64).reshape(-1, 2).T
        reaches = [self._measure_reach(item) for item in items]
        radii = np.array([item.geometry.aabb_radius for item in items])
        speeds = np.zeros((len(ends), 3 + len(self._robot.joint_names)))
        for number, (i, j) in enumerate(ends):
            for joint in reaches[i].keys() ^ reaches[j].keys():
                reach = reaches[i].get(joint, reaches[j].get(joint, 0.0))
                if joint == 1:
                    speeds[number, :3] += 1.0, 1.0, reach
                elif joint in self.moved:
                    planned, factor = self.moved[joint]
                    speeds[number, 3 + planned] += abs(factor) * reach
        on_solid = np.array([items[j].parentJoint == 0 for _, j in ends], dtype=bool)
        fixed = [items[j] for (_, j), is_fixed in zip(ends, on_solid, strict=True) if is_fixed]
        centres = [np.array(item.geometry.aabb_center) for item in items]
        places = np.array([item.placement.act(centre) for item, centre in zip(items, centres, strict=True)])
        own = sum(item.parentJoint > 0 for item in items)  # the robot's come first
        return PairBounds(first, second, centres[:own], places, radii[first] + radii[second], speeds, on_solid,
                          np.array([item.placement.rotation for item in fixed]).reshape(-1, 3, 3),
                          np.array([_measure_half(item.geometry) for item in fixed]).reshape(-1, 3),
                          radii[first[on_solid]])

    def _measure_reach(self, item: Any) -> dict[int, float]:
        """Metres that a shape moves at most for each unit of a joint above it, by the joint's number in the model.

        Also measures the shape's sphere. A solid has no joint above it.
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


def _measure_half(shape: Any) -> NDArray[np.float64]:
    """Half sizes of the box around a solid in its own frame, m, centred at `aabb_center`."""
    box = shape.aabb_local
    return (np.asarray(box.max_) - np.asarray(box.min_)) / 2.0
