"""Arm model for planners: Pinocchio's kinematics of the robot's URDF, coal's collisions of its links.

The only wrapper of the two libraries. It chooses no configuration. Frame `base`: origin on the floor below the base's
axis, x ahead, z up; metres, radians.
"""

# pyright: reportAttributeAccessIssue=false
# (both libraries are compiled and carry no types)

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hrl_escape.env.geometry import Solid, compute_distance
from hrl_escape.env.robot import BASE_LINK, Robot
from hrl_escape.errors import MissingPackageError

try:
    import coal
    import pinocchio
except ImportError as missing:
    raise MissingPackageError("pin", "Planning for an arm", missing) from missing

_SLACK = 1e-9  # of a joint limit, as in `Kinematics`
_FLOOR_SIDE = 1000.0  # m; rooms are at most 200 m wide
FEW_SOLIDS, MOST_TILES = 64, 256
"""Solids up to which all are tested, and tiles of the floor whose solids are kept beyond that."""


class ArmKinematics:
    """Kinematics of one robot, from Pinocchio, whose `model` has the base fixed at the origin."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.model = pinocchio.buildModelFromXML(robot.urdf)
        self._data = self.model.createData()
        self._frame = self.model.getFrameId(robot.hand_link, pinocchio.BODY)
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

    def compute_placements(self, joint_offsets: tuple[float, ...] = ()
                           ) -> tuple[list[NDArray[np.float64]], NDArray[np.float64]]:
        """Tabulate the placements of every joint by itself; products of them make the lattice.

        Joint offsets are angles beyond whole steps, rad; empty for none.

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
        pinocchio.framesForwardKinematics(self.model, self._data, self._make_q(angles))
        return self._data.oMf[self._frame].homogeneous.copy()

    def compute_jacobian(self, angles: Sequence[float]) -> NDArray[np.float64]:
        """Jacobian of the hand along the base's axes, shape (6, joints): m/rad (velocity), then rad/rad (rotation)."""
        columns = [self.model.joints[joint].idx_v for joint in self._used]
        jacobian = pinocchio.computeFrameJacobian(self.model, self._data, self._make_q(angles), self._frame,
                                                  pinocchio.LOCAL_WORLD_ALIGNED)
        return jacobian.reshape(6, self.model.nv)[:, columns]  # of one joint it comes as a vector

    def compute_efforts(self, angles: ArrayLike, speeds: ArrayLike, accelerations: ArrayLike) -> NDArray[np.float64]:
        """Torque that each joint needs for a motion, by the recursive Newton-Euler algorithm, (joints,), N m.

        Of angles, rad, speeds, rad/s, and accelerations, rad/s^2, each (joints,).
        """
        columns = [self.model.joints[joint].idx_v for joint in self._used]
        rates = np.zeros((2, self.model.nv))
        rates[0, columns], rates[1, columns] = speeds, accelerations
        return pinocchio.rnea(self.model, self._data, self._make_q(np.asarray(angles).tolist()), *rates)[columns]

    def _make_q(self, angles: Sequence[float]) -> NDArray[np.float64]:
        q = self._rest.copy()
        for joint, angle in zip(self._used, angles, strict=True):
            _set_joint(self.model, q, joint, angle)
        return q

    def solve_ik(self, target: ArrayLike, seed: Sequence[float], tolerance: float) -> NDArray[np.float64] | None:
        """Joint angles that bring the hand to a position or a pose, by the Levenberg-Marquardt method (Sugihara 2011).

        The target, in the base frame, is a position of the hand (3,), m, or a placement of its link (4, 4). Angles
        begin at `seed`, rad, and are held at their limits; `tolerance` is the largest distance, m, and for a pose also
        rotation, rad, from the target. Returns (joints,), rad, or None if the seed does not lead there.
        """
        wanted = np.asarray(target, dtype=np.float64)
        low, high = np.array(self.robot.limits).T
        angles, damping = np.array(seed, dtype=np.float64), 1e-2
        error, jacobian = self._compute_error(angles, wanted)
        for _ in range(100):
            if np.linalg.norm(error[:3]) <= tolerance and np.linalg.norm(error[3:]) <= tolerance:
                return angles
            gradient = jacobian.T @ error
            # a joint at its limit that would pass it is left out of the step
            stuck = ((angles <= low) & (gradient < 0.0)) | ((angles >= high) & (gradient > 0.0))
            jacobian = np.where(stuck, 0.0, jacobian)
            square = float(error @ error)
            matrix = jacobian @ jacobian.T + damping * square * np.eye(len(error)) + 1e-12 * np.eye(len(error))
            step = np.clip(angles + np.clip(jacobian.T @ np.linalg.solve(matrix, error), -0.5, 0.5), low, high)
            new_error, new_jacobian = self._compute_error(step, wanted)
            if float(new_error @ new_error) < square:
                angles, error, jacobian, damping = step, new_error, new_jacobian, damping / 4.0
            else:
                jacobian, damping = new_jacobian if (step == angles).all() else jacobian, damping * 8.0
                if damping > 1e8:
                    return None
        return None

    def _compute_error(self, angles: NDArray[np.float64], wanted: NDArray[np.float64]
                       ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Difference to a position (3,) or pose (6,), and the Jacobian in the same rows."""
        jacobian = self.compute_jacobian(angles.tolist())
        pinocchio.updateFramePlacement(self.model, self._data, self._frame)
        hand = self._data.oMf[self._frame]
        if wanted.shape == (3,):
            return wanted - hand.translation, jacobian[:3]
        turn = pinocchio.log3(wanted[:3, :3] @ hand.rotation.T)
        return np.concatenate([wanted[:3, 3] - hand.translation, turn]), jacobian


class ArmCollisions:
    """Collision test of the arm against solids, the floor and the robot itself, by coal.

    The base against solids is left to `CollisionMap`. Links joined to each other never count, nor do pairs that an SRDF
    allows; without one, or with one that allows none, those that meet with all joints at home (the arm's foot and the
    base). Nor does a link that rests on the floor at home. The hand is the sphere that presses, added to the shape of
    its link. What is nearer than `margin`, m, collides.
    """

    def __init__(self, robot: Robot, hand_radius: float, solids: Sequence[Solid], margin: float = 0.0,
                 srdf: str | None = None, *, _links: Any = None) -> None:
        self.robot, self.margin = robot, margin
        self._model = pinocchio.buildModelFromXML(robot.urdf, pinocchio.JointModelPlanar())
        self._data = self._model.createData()
        self._used = [self._model.getJointId(name) for name in robot.joint_names]
        self._rest = _make_rest(self._model, robot)
        links = self._make_links(hand_radius) if _links is None else _links
        self._make_near = partial(ArmCollisions, robot, hand_radius, margin=margin, srdf=srdf, _links=links)
        self._solids, self._near = tuple(solids), dict[tuple[int, int], ArmCollisions]()
        geometry = links.copy()
        own = len(geometry.geometryObjects)
        base = self._model.getFrameId(BASE_LINK, pinocchio.BODY)
        for number, solid in enumerate(solids):
            place = f"{solid.role} at ({solid.x:.4g}, {solid.y:.4g}), number {number}"
            geometry.addGeometryObject(_make_collision_object(place, solid))
        for i, item in enumerate(geometry.geometryObjects[:own].tolist()):
            if item.parentFrame == base:
                continue
            for other in range(own, len(geometry.geometryObjects)):
                geometry.addCollisionPair(pinocchio.CollisionPair(i, other))
        apart = [(i, j) for i in range(own) for j in range(i + 1, own) if not self._is_joined(geometry, i, j)]
        floor = geometry.addGeometryObject(_make_floor())
        resting = [(i, floor) for i in range(own) if geometry.geometryObjects[i].parentFrame != base]
        if srdf is None or "<disable_collisions" not in srdf:
            self._keep_clear(geometry, apart)
        else:
            for pair in apart:
                geometry.addCollisionPair(pinocchio.CollisionPair(*pair))
            pinocchio.removeCollisionPairsFromXML(self._model, geometry, srdf)
        self._keep_clear(geometry, resting)
        self._geometry = geometry  # the manager refers to it
        data = geometry.createData()
        for request in data.collisionRequests:
            request.security_margin = margin
        self._manager: Any = pinocchio.BroadPhaseManager_DynamicAABBTreeCollisionManager(self._model, geometry, data)

    def _make_links(self, hand_radius: float) -> Any:
        """Shapes of the robot's links and of the hand."""
        links = pinocchio.buildGeomFromUrdfString(self._model, self.robot.urdf, pinocchio.GeometryType.COLLISION)
        number = self._model.getFrameId(self.robot.hand_link, pinocchio.BODY)
        hand = self._model.frames[number]
        links.addGeometryObject(
            pinocchio.GeometryObject("hand", hand.parentJoint, number, hand.placement, coal.Sphere(hand_radius)))
        for item in links.geometryObjects:
            if isinstance(item.geometry, coal.BVHModelBase):
                item.geometry.buildConvexHull(True, "Qt")  # convex hulls are faster to test, and larger, so safe
                item.geometry = item.geometry.convex
        return links

    @cached_property
    def _reach(self) -> float:
        """Farthest that any point of the robot is from the base's axis, m."""
        return float(self.compute_sweeps()[-1])

    def _find_near(self, x: float, y: float) -> ArmCollisions:
        """The same test against the solids that can be reached from a tile of the floor, for a test moves them all."""
        if len(self._solids) <= FEW_SOLIDS:
            return self
        side = self._reach / 2
        tile = math.floor(x / side), math.floor(y / side)
        if tile not in self._near:
            if len(self._near) == MOST_TILES:
                self._near.pop(next(iter(self._near)))
            at_x, at_y = (side * (number + 0.5) for number in tile)
            far = self._reach + side + self.margin
            self._near[tile] = self._make_near([solid for solid in self._solids
                                                if compute_distance(at_x, at_y, solid.footprint) <= far])
        return self._near[tile]

    def compute_sweeps(self) -> NDArray[np.float64]:
        """Farthest that any point of the robot moves for each radian of a joint, links stretched out, (joints + 1,), m.

        The base's turn comes last.
        """
        model, far = self._model, np.zeros(len(self._used) + 1)
        for item in self._geometry.geometryObjects.tolist():
            if item.parentJoint == 0:  # a solid
                continue
            item.geometry.computeLocalAABB()
            reach = float(np.linalg.norm(item.placement.act(item.geometry.aabb_center))) + item.geometry.aabb_radius
            joint = item.parentJoint
            while joint > 0:
                if joint in self._used:
                    number = self._used.index(joint)
                    far[number] = max(far[number], 1.0 if "P" in model.joints[joint].shortname()[-2:] else reach)
                elif joint == 1:
                    far[-1] = max(far[-1], reach)
                reach += float(np.linalg.norm(model.jointPlacements[joint].translation))
                if "P" in model.joints[joint].shortname()[-2:]:  # it slides
                    low, high = model.lowerPositionLimit, model.upperPositionLimit
                    at = model.joints[joint].idx_q
                    reach += float(max(abs(low[at]), abs(high[at])))
                joint = model.parents[joint]
        return far

    def _is_joined(self, geometry: Any, i: int, j: int) -> bool:
        a, b = (geometry.geometryObjects[k].parentJoint for k in (i, j))
        return a == b or self._model.parents[a] == b or self._model.parents[b] == a

    def _keep_clear(self, geometry: Any, pairs: list[tuple[int, int]]) -> None:
        """Keep for collision tests only the pairs that are apart with all joints at home."""
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
        """Return whether no link meets a solid, the floor or another link.

        The place is that of the base's axis in the room, m; heading and joint angles are rad.
        """
        return self._find_near(x, y)._test(x, y, heading, angles)

    def _test(self, x: float, y: float, heading: float, angles: Sequence[float]) -> bool:
        q = self._make_q(x, y, heading, angles)
        return not pinocchio.computeCollisions(self._model, self._data, self._manager, q, True)

    def list_collisions(self, x: float, y: float, heading: float, angles: Sequence[float]) -> list[str]:
        """List what meets at a posture, such as `arm-3 meets floor`; arguments as of `is_free`."""
        data, q = self._geometry.createData(), self._make_q(x, y, heading, angles)
        for request in data.collisionRequests:
            request.security_margin = self.margin
        pinocchio.computeCollisions(self._model, self._data, self._geometry, data, q, False)

        def name(number: int) -> str:
            item = self._geometry.geometryObjects[number]
            return self._model.frames[item.parentFrame].name if item.parentJoint else item.name

        pairs = zip(self._geometry.collisionPairs, data.collisionResults, strict=True)
        return sorted({f"{name(pair.first)} meets {name(pair.second)}" for pair, found in pairs if found.isCollision()})

    def list_allowed(self) -> list[tuple[str, str, str]]:
        """List pairs of links that may touch: two names, and why, as an SRDF's `reason`.

        Links joined to each other are `Adjacent`, others `Default`. A pair counts if any two of its shapes may touch.
        """
        tested = {frozenset((pair.first, pair.second)) for pair in self._geometry.collisionPairs}
        allowed: dict[tuple[str, str], str] = {}
        items = enumerate(self._geometry.geometryObjects.tolist())
        own = [(number, item) for number, item in items if item.parentJoint]  # no solids
        for (i, one), (j, other) in itertools.combinations(own, 2):
            first, second = (self._model.frames[item.parentFrame].name for item in (one, other))
            if first != second and frozenset((i, j)) not in tested:
                allowed[first, second] = "Adjacent" if self._is_joined(self._geometry, i, j) else "Default"
        return [(first, second, reason) for (first, second), reason in allowed.items()]


def _make_rest(model: Any, robot: Robot) -> NDArray[np.float64]:
    q = pinocchio.neutral(model)
    for name, angle in robot.rest.items():
        _set_joint(model, q, model.getJointId(name), angle)
    return q


def _set_joint(model: Any, q: NDArray[np.float64], joint: int, angle: float) -> None:
    kind = model.joints[joint]
    q[kind.idx_q : kind.idx_q + kind.nq] = angle if kind.nq == 1 else (math.cos(angle), math.sin(angle))


def _make_floor() -> Any:
    """The floor: a slab whose top is z = 0, since the bounding box of a half-space is infinite."""
    slab = coal.Box(_FLOOR_SIDE, _FLOOR_SIDE, 1.0)
    return pinocchio.GeometryObject("floor", 0, pinocchio.SE3(np.eye(3), np.array([0.0, 0.0, -0.5])), slab)


def _make_collision_object(name: str, solid: Solid) -> Any:
    if solid.shape == "cylinder":
        shape = coal.Cylinder(solid.half_x, solid.height)
    else:
        shape = coal.Box(2 * solid.half_x, 2 * solid.half_y, solid.height)
    turn = pinocchio.utils.rotate("z", solid.yaw)
    place = pinocchio.SE3(turn, np.array([solid.x, solid.y, solid.height / 2]))
    return pinocchio.GeometryObject(name, 0, place, shape)
