"""Arm model for planners: Pinocchio's kinematics of the robot's URDF and coal's collisions of its links.

The only wrapper of the two libraries. It computes positions of the hand, on the joint lattice and
off it, and tests whether the links are clear of walls, obstacles and each other. It chooses no
configuration. Frame `base`: origin on the floor below the base's axis, x ahead, z up; metres, radians.
"""

# pyright: reportAttributeAccessIssue=false
# (both libraries are compiled and carry no types)

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import coal
import numpy as np
import pinocchio
from numpy.typing import ArrayLike, NDArray

from hrl_escape.env.geometry import Solid
from hrl_escape.env.robot import BASE_LINK, Robot

__all__ = ["ArmCollisions", "ArmKinematics"]

_SLACK = 1e-9  # of a joint limit, as in `Kinematics`


class ArmKinematics:
    """Kinematics of one robot, from Pinocchio.

    Attributes:
        robot: the robot.
        model: Pinocchio's model of it, the base fixed at the origin.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.model = pinocchio.buildModelFromXML(robot.urdf)
        self._data = self.model.createData()
        self._frame = self.model.getFrameId(robot.hand_link)
        self._used = [self.model.getJointId(name) for name in robot.joint_names]
        self._rest = _make_rest(self.model, robot)

    def get_ranges(self, joint_offsets: tuple[float, ...]) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Fewest and most steps of each joint within its limits, given its offset from the lattice."""
        robot = self.robot
        if not joint_offsets:
            return robot.step_low, robot.step_high
        at = [home + offset for home, offset in zip(robot.home, joint_offsets, strict=True)]
        return (
            tuple(math.ceil((low - a - _SLACK) / robot.step) for a, (low, _) in zip(at, robot.limits, strict=True)),
            tuple(math.floor((high - a + _SLACK) / robot.step) for a, (_, high) in zip(at, robot.limits, strict=True)),
        )

    def compute_placements(
        self, joint_offsets: tuple[float, ...] = ()
    ) -> tuple[list[NDArray[np.float64]], NDArray[np.float64]]:
        """Tabulate the placements of every joint by itself; products of them make the lattice.

        Args:
            joint_offsets: angles beyond whole steps, rad; empty for none.

        Returns:
            For each joint the placements (steps, 4, 4) of its link in the link of the joint before it,
            from the fewest steps to the most; and the hand (3,) in the last of these links, m.
        """
        low, high = self.get_ranges(joint_offsets)
        offsets = joint_offsets or (0.0,) * len(low)
        counts = [b - a + 1 for a, b in zip(low, high, strict=True)]
        tables = [np.empty((count, 4, 4)) for count in counts]
        path = list(self.model.supports[self.model.frames[self._frame].parentJoint])[1:]
        hand = np.eye(4)
        for k in range(max(counts, default=1)):
            q = self._rest.copy()
            for i, joint in enumerate(self._used):
                steps = low[i] + min(k, counts[i] - 1)
                _set_joint(self.model, q, joint, self.robot.home[i] + steps * self.robot.step + offsets[i])
            pinocchio.forwardKinematics(self.model, self._data, q)
            since = np.eye(4)
            for joint in path:
                since = since @ self._data.liMi[joint].homogeneous
                if joint in self._used:
                    i = self._used.index(joint)
                    tables[i][min(k, counts[i] - 1)] = since
                    since = np.eye(4)
            hand = since @ self.model.frames[self._frame].placement.homogeneous
        return tables, hand[:3, 3].copy()

    def compute_placement(self, angles: Sequence[float]) -> NDArray[np.float64]:
        """Placement of the hand's link in the base frame at given joint angles (rad), shape (4, 4)."""
        q = self._rest.copy()
        for joint, angle in zip(self._used, angles, strict=True):
            _set_joint(self.model, q, joint, angle)
        pinocchio.framesForwardKinematics(self.model, self._data, q)
        return self._data.oMf[self._frame].homogeneous.copy()

    def solve_ik(self, point: ArrayLike, seeds: Sequence[Sequence[float]], tolerance: float,
                 limits: bool = True) -> NDArray[np.float64] | None:
        """Joint angles that bring the hand to a point, by damped least squares (Nakamura and Hanafusa 1986).

        Args:
            point: wanted position of the hand in the base frame, shape (3,), m.
            seeds: first joint angles of each attempt, rad.
            tolerance: largest distance from the point, m.
            limits: keep the joint limits.

        Returns:
            Shape (joints,), rad, or None if no seed led there.
        """
        point = np.asarray(point, dtype=np.float64)
        low, high = np.array(self.robot.limits).T
        columns = [self.model.joints[joint].idx_v for joint in self._used]
        for seed in seeds:
            angles = np.array(seed, dtype=np.float64)
            for _ in range(60):
                q = self._rest.copy()
                for joint, angle in zip(self._used, angles, strict=True):
                    _set_joint(self.model, q, joint, angle)
                jacobian = pinocchio.computeFrameJacobian(
                    self.model, self._data, q, self._frame, pinocchio.LOCAL_WORLD_ALIGNED)
                jacobian = jacobian.reshape(6, self.model.nv)[:3, columns]  # of one joint it comes as a vector
                pinocchio.updateFramePlacement(self.model, self._data, self._frame)
                error = point - self._data.oMf[self._frame].translation
                if np.linalg.norm(error) <= tolerance:
                    return angles
                damped = jacobian @ jacobian.T + 1e-4 * np.eye(3)
                angles = angles + np.clip(jacobian.T @ np.linalg.solve(damped, error), -0.5, 0.5)
                if limits:
                    angles = np.clip(angles, low, high)
        return None


class ArmCollisions:
    """Collision test of the arm against solids and the robot itself, by coal.

    The base against solids is left to `CollisionMap`. Links joined to each other, and pairs that meet with
    all joints at home (the arm's foot and the base), never count. The hand is the sphere that presses, added
    to the shape of its link.
    """

    def __init__(self, robot: Robot, hand_radius: float, solids: Sequence[Solid]) -> None:
        self.robot = robot
        self._model = pinocchio.buildModelFromXML(robot.urdf, pinocchio.JointModelPlanar())
        self._data = self._model.createData()
        self._used = [self._model.getJointId(name) for name in robot.joint_names]
        self._rest = _make_rest(self._model, robot)
        geometry = pinocchio.buildGeomFromUrdfString(self._model, robot.urdf, pinocchio.GeometryType.COLLISION)
        hand = self._model.frames[self._model.getFrameId(robot.hand_link)]
        geometry.addGeometryObject(
            pinocchio.GeometryObject("hand", hand.parentJoint, hand.placement, coal.Sphere(hand_radius)))
        own = len(geometry.geometryObjects)
        for item in geometry.geometryObjects:
            if isinstance(item.geometry, coal.BVHModelBase):
                item.geometry.buildConvexHull(True, "Qt")  # hulls are quicker, and larger, so safe
                item.geometry = item.geometry.convex
        base = self._model.getFrameId(BASE_LINK)
        for number, solid in enumerate(solids):
            geometry.addGeometryObject(_make_collision_object(f"solid-{number}", solid))
        for i, item in enumerate(geometry.geometryObjects[:own].tolist()):
            if item.parentFrame == base:
                continue
            for other in range(own, len(geometry.geometryObjects)):
                geometry.addCollisionPair(pinocchio.CollisionPair(i, other))
        apart = [(i, j) for i in range(own) for j in range(i + 1, own) if not self._is_joined(geometry, i, j)]
        self._keep_clear(geometry, apart)
        self._geometry = geometry  # the manager refers to it
        self._manager: Any = pinocchio.BroadPhaseManager_DynamicAABBTreeCollisionManager(
            self._model, geometry, geometry.createData())

    def _is_joined(self, geometry: Any, i: int, j: int) -> bool:
        a, b = (geometry.geometryObjects[k].parentJoint for k in (i, j))
        return a == b or self._model.parents[a] == b or self._model.parents[b] == a

    def _keep_clear(self, geometry: Any, pairs: list[tuple[int, int]]) -> None:
        """Test those pairs of the robot's own links that are apart at home."""
        data = geometry.createData()
        home = self._make_q(0.0, 0.0, 0.0, self.robot.home)
        pinocchio.updateGeometryPlacements(self._model, self._data, geometry, data, home)
        for i, j in pairs:
            a, b = geometry.geometryObjects[i], geometry.geometryObjects[j]
            where = [coal.Transform3s(data.oMg[k].rotation, data.oMg[k].translation) for k in (i, j)]
            if not coal.collide(a.geometry, where[0], b.geometry, where[1], coal.CollisionRequest(),
                                coal.CollisionResult()):
                geometry.addCollisionPair(pinocchio.CollisionPair(i, j))

    def _make_q(self, x: float, y: float, heading: float, angles: Sequence[float]) -> NDArray[np.float64]:
        q = self._rest.copy()
        q[:4] = x, y, math.cos(heading), math.sin(heading)
        for joint, angle in zip(self._used, angles, strict=True):
            _set_joint(self._model, q, joint, angle)
        return q

    def is_free(self, x: float, y: float, heading: float, angles: Sequence[float]) -> bool:
        """Return whether no link meets a solid or another link.

        Args:
            x: the base's axis in the room, m.
            y: the base's axis in the room, m.
            heading: rad.
            angles: joint angles, rad.
        """
        q = self._make_q(x, y, heading, angles)
        return not pinocchio.computeCollisions(self._model, self._data, self._manager, q, True)


def _make_rest(model: Any, robot: Robot) -> NDArray[np.float64]:
    q = pinocchio.neutral(model)
    for name, angle in robot.rest.items():
        _set_joint(model, q, model.getJointId(name), angle)
    return q


def _set_joint(model: Any, q: NDArray[np.float64], joint: int, angle: float) -> None:
    kind = model.joints[joint]
    q[kind.idx_q : kind.idx_q + kind.nq] = angle if kind.nq == 1 else (math.cos(angle), math.sin(angle))


def _make_collision_object(name: str, solid: Solid) -> Any:
    if solid.shape == "cylinder":
        shape = coal.Cylinder(solid.half_x, solid.height)
    else:
        shape = coal.Box(2 * solid.half_x, 2 * solid.half_y, solid.height)
    turn = pinocchio.utils.rotate("z", solid.yaw)
    place = pinocchio.SE3(turn, np.array([solid.x, solid.y, solid.height / 2]))
    return pinocchio.GeometryObject(name, 0, place, shape)
