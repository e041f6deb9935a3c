"""Arm model for planners: Pinocchio's kinematics of the robot's URDF, coal's collisions of its links.

The only wrapper of the two libraries. It chooses no configuration. Frame `base`: origin on the floor below the base's
axis, x ahead, z up; metres, radians.
"""

# pyright: reportAttributeAccessIssue=false
# (both libraries are compiled and carry no types)

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from typing import Any, NamedTuple, TypeAlias
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hrl_escape.env.geometry import Solid, compute_distance
from hrl_escape.env.robot import BASE_LINK, Robot
from hrl_escape.env.urdf import read_numbers
from hrl_escape.errors import MissingPackageError, RobotError, UnsupportedError

try:
    import coal
    import pinocchio
except ImportError as missing:
    raise MissingPackageError("pin", "Planning for an arm", missing) from missing

from hrl_escape.planning.arm.shapes import make_shape  # needs coal

_SLACK = 1e-9  # of a joint limit, as in `Kinematics`
_FLOOR_SIDE = 1000.0  # m; rooms are at most 200 m wide
_SLIDES = {"JointModelPX", "JointModelPY", "JointModelPZ", "JointModelPrismaticUnaligned"}
TOUCHING = 1e-3
"""Links that are nearer than this at home may touch, m: hulls are larger than the links."""
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
        self._check_product(path)
        hand = np.eye(4)
        for k in range(max(counts, default=1)):
            q = self._make_q([self.robot.home[i] + (low[i] + min(k, counts[i] - 1)) * self.robot.step + offsets[i]
                              for i in range(len(counts))])
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

    def _check_product(self, path: list[int]) -> None:
        """Refuse a chain in which a joint follows another across a third, so that no table holds its placements."""
        order = [self.model.names[joint] for joint in path]
        for name, (i, _, _) in self.robot.mimics.items():
            source = self.robot.joint_names[i]
            if name in order:
                between = order[order.index(source) + 1 : order.index(name)]
                if order.index(name) < order.index(source) or any(joint in self.robot.joint_names for joint in between):
                    raise UnsupportedError(f"joint {name!r} mimics {source!r} across another joint: primitives of this "
                                           "arm cannot be planned. ArmPlanner plans it in joint angles")

    def compute_placement(self, angles: Sequence[float]) -> NDArray[np.float64]:
        """Placement of the hand's link in the base frame at given joint angles (rad), shape (4, 4)."""
        pinocchio.framesForwardKinematics(self.model, self._data, self._make_q(angles))
        return self._data.oMf[self._frame].homogeneous.copy()

    def compute_jacobian(self, angles: Sequence[float]) -> NDArray[np.float64]:
        """Jacobian of the hand along the base's axes, shape (6, joints): m/rad (velocity), then rad/rad (rotation)."""
        jacobian = pinocchio.computeFrameJacobian(self.model, self._data, self._make_q(angles), self._frame,
                                                  pinocchio.LOCAL_WORLD_ALIGNED)
        return jacobian.reshape(6, self.model.nv) @ self._rates  # of one joint it comes as a vector

    def compute_efforts(self, angles: ArrayLike, speeds: ArrayLike, accelerations: ArrayLike) -> NDArray[np.float64]:
        """Torque that each joint needs for a motion, by the recursive Newton-Euler algorithm, (joints,), N m.

        Of angles, rad, speeds, rad/s, and accelerations, rad/s^2, each (joints,).
        """
        rates = self._rates @ np.asarray(speeds), self._rates @ np.asarray(accelerations)
        return pinocchio.rnea(self.model, self._data, self._make_q(np.asarray(angles).tolist()), *rates) @ self._rates

    @cached_property
    def _rates(self) -> NDArray[np.float64]:
        """Velocities of the model's joints for each unit of a planned joint's, (model's, planned)."""
        rates = np.zeros((self.model.nv, len(self._used)))
        rates[[self.model.joints[joint].idx_v for joint in self._used], range(len(self._used))] = 1.0
        for name, (i, factor, _) in self.robot.mimics.items():
            rates[self.model.joints[self.model.getJointId(name)].idx_v, i] = factor
        return rates

    def _make_q(self, angles: Sequence[float]) -> NDArray[np.float64]:
        return _make_configuration(self.model, self._rest, self._used, self.robot, angles)

    def solve_ik(self, target: ArrayLike, seed: Sequence[float], tolerance: float) -> NDArray[np.float64] | None:
        """Joint angles that bring the hand to a position or a pose, by the Levenberg-Marquardt method (Sugihara 2011).

        The target, in the base frame, is a position of the hand (3,), m, or a placement of its link (4, 4). Angles
        begin at `seed`, rad, and are held at their limits; `tolerance` is the largest distance, m, and for a pose also
        rotation, rad, from the target. Returns (joints,), rad, continuous joints within [-pi, pi), or None if the seed
        does not lead there.
        """
        wanted = np.asarray(target, dtype=np.float64)
        low, high = np.where(self.robot.continuous, [[-np.inf], [np.inf]], np.array(self.robot.limits).T)
        angles, damping = np.array(seed, dtype=np.float64), 1e-2
        error, jacobian = self._compute_error(angles, wanted)
        for _ in range(100):
            if np.linalg.norm(error[:3]) <= tolerance and np.linalg.norm(error[3:]) <= tolerance:
                turned = np.remainder(angles + np.pi, 2 * np.pi) - np.pi
                return np.where(self.robot.continuous, turned, angles)
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


Key: TypeAlias = "str | Solid"
"""A thing that collides: the name of a link's shape, `floor`, or a solid."""


class _Pairs(NamedTuple):
    """Bounds of distances and motions of tested pairs of bodies; the second of a pair may be a solid."""

    first: NDArray[np.int64]  # (pairs,), numbers of geometry objects
    second: NDArray[np.int64]
    centres: list[NDArray[np.float64]]  # of the objects' spheres, in their own frames, m
    radii: NDArray[np.float64]  # (pairs,), of both spheres together, m
    speeds: NDArray[np.float64]  # (pairs, 3 + joints), metres for each unit of x, y, heading and joints
    margins: NDArray[np.float64]  # (pairs,), m
    on_solid: NDArray[np.bool_]  # (pairs,)
    turns: NDArray[np.float64]  # (pairs with a solid, 3, 3), the solid's rotation
    halves: NDArray[np.float64]  # (pairs with a solid, 3), half sizes of the solid's box, m
    solid_radii: NDArray[np.float64]  # (pairs with a solid,), of the link's sphere, m


class ArmCollisions:
    """Collision test of the arm against solids, the floor and the robot itself, by coal.

    The base against solids is left to `CollisionMap`. Three kinds of pairs are never tested: links joined to each
    other, links whose relative placement no planned joint changes, and pairs that an SRDF allows. Without an SRDF, or
    with one that allows none, pairs are left out that meet with all joints at home (such as the arm's foot and the
    base), as is the floor for a link that rests on it at home. The hand is the sphere that presses, added to the shape
    of its link.

    Args:
        robot: the robot.
        hand_radius: radius of the hand, m.
        solids: what stands in the room.
        margin: what is nearer than this collides, m.
        srdf: text of an SRDF, or None.
        margins: margins of pairs that differ from `margin`, m.
    """

    def __init__(self, robot: Robot, hand_radius: float, solids: Sequence[Solid], margin: float = 0.0,
                 srdf: str | None = None, *, margins: Mapping[frozenset[Key], float] | None = None,
                 _links: Any = None) -> None:
        self.robot, self.margin = robot, margin
        self._model = pinocchio.buildModelFromXML(robot.urdf, pinocchio.JointModelPlanar())
        self._data = self._model.createData()
        self._used = [self._model.getJointId(name) for name in robot.joint_names]
        self._rest = _make_rest(self._model, robot)
        links = self._make_links(hand_radius) if _links is None else _links
        self._remake = partial(ArmCollisions, robot, hand_radius, margin=margin, srdf=srdf, _links=links)
        self._solids, self._near = tuple(solids), dict[tuple[int, int], ArmCollisions]()
        self._margins = dict(margins or {})
        geometry = links.copy()
        own = len(geometry.geometryObjects)
        self._keys: list[Key] = [item.name for item in geometry.geometryObjects]
        base = self._model.getFrameId(BASE_LINK, pinocchio.BODY)
        for number, solid in enumerate(solids):
            place = f"{solid.role} at ({solid.x:.4g}, {solid.y:.4g}), number {number}"
            geometry.addGeometryObject(_make_collision_object(place, solid))
            self._keys.append(solid)
        for i, item in enumerate(geometry.geometryObjects[:own].tolist()):
            if item.parentFrame == base:
                continue
            for other in range(own, len(geometry.geometryObjects)):
                geometry.addCollisionPair(pinocchio.CollisionPair(i, other))
        apart = [(i, j) for i in range(own) for j in range(i + 1, own)
                 if not self._is_joined(geometry, i, j) and not self._is_rigid(geometry, i, j)]
        floor = geometry.addGeometryObject(_make_floor())
        self._keys.append("floor")
        resting = [(i, floor) for i in range(own) if geometry.geometryObjects[i].parentFrame != base]
        if srdf is None or "<disable_collisions" not in srdf:
            self._keep_clear(geometry, apart)
        else:
            for pair in apart:
                geometry.addCollisionPair(pinocchio.CollisionPair(*pair))
            pinocchio.removeCollisionPairsFromXML(self._model, geometry, srdf)
        self._keep_clear(geometry, resting)
        self._geometry = geometry  # the manager refers to it
        self._manager: Any = pinocchio.BroadPhaseManager_DynamicAABBTreeCollisionManager(
            self._model, geometry, self._make_data())

    def with_margins(self, margins: Mapping[frozenset[Key], float]) -> ArmCollisions:
        """Return the same test with other margins, m, of some pairs."""
        return self._remake(self._solids, margins=margins)

    def with_margin(self, margin: float) -> ArmCollisions:
        """Return the same test with one other margin, m, of all pairs; shapes of links are shared."""
        return self._remake(self._solids, margin=margin)

    def _make_data(self) -> Any:
        """Results of collision tests, with the margins in their requests."""
        data = self._geometry.createData()
        for pair, request in zip(self._geometry.collisionPairs, data.collisionRequests, strict=True):
            request.security_margin = self._margins.get(self._name_pair(pair), self.margin)
        return data

    def _name_pair(self, pair: Any) -> frozenset[Key]:
        return frozenset((self._keys[pair.first], self._keys[pair.second]))

    def _make_links(self, hand_radius: float) -> Any:
        """Shapes of the robot's links and of the hand."""
        links = pinocchio.GeometryModel()
        for link in ElementTree.fromstring(self.robot.urdf).findall("link"):
            name = link.get("name", "")
            number = self._model.getFrameId(name, pinocchio.BODY)
            frame = self._model.frames[number]
            for count, element in enumerate(link.findall("collision")):
                geometry = element.find("geometry")
                if geometry is None:
                    continue
                place = frame.placement * _read_origin(element)
                links.addGeometryObject(pinocchio.GeometryObject(f"{name}_{count}", frame.parentJoint, number, place,
                                                                 make_shape(geometry, name)))
        number = self._model.getFrameId(self.robot.hand_link, pinocchio.BODY)
        hand = self._model.frames[number]
        links.addGeometryObject(
            pinocchio.GeometryObject("hand", hand.parentJoint, number, hand.placement, coal.Sphere(hand_radius)))
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
            self._near[tile] = self._remake([solid for solid in self._solids
                                             if compute_distance(at_x, at_y, solid.footprint) <= far],
                                            margins=self._margins)
        return self._near[tile]

    def compute_sweeps(self) -> NDArray[np.float64]:
        """Farthest that any point of the robot moves for each radian of a joint, links stretched out, (joints + 1,), m.

        The base's turn comes last.
        """
        far = np.zeros(len(self._used) + 1)
        for item in self._geometry.geometryObjects.tolist():
            if item.parentJoint == 0:  # a solid
                continue
            item.geometry.computeLocalAABB()
            here = np.zeros_like(far)
            for joint, reach in self._measure_reach(item).items():
                if joint in self._moved:
                    number, factor = self._moved[joint]
                    here[number] += abs(factor) * reach
                elif joint == 1:
                    here[-1] = reach
            far = np.maximum(far, here)
        return far

    @cached_property
    def _moved(self) -> dict[int, tuple[int, float]]:
        """Joints of the model that move with a planned one: its number, and how fast for each unit of it."""
        moved = {joint: (number, 1.0) for number, joint in enumerate(self._used)}
        return moved | {self._model.getJointId(name): (number, factor)
                        for name, (number, factor, _) in self.robot.mimics.items()}

    def _is_rigid(self, geometry: Any, i: int, j: int) -> bool:
        """Return whether no planned joint changes how two shapes are placed to each other."""
        above = [{joint for joint in self._model.supports[geometry.geometryObjects[k].parentJoint]
                  if joint in self._moved} for k in (i, j)]
        return above[0] == above[1]

    def _is_joined(self, geometry: Any, i: int, j: int) -> bool:
        a, b = (geometry.geometryObjects[k].parentJoint for k in (i, j))
        return a == b or self._model.parents[a] == b or self._model.parents[b] == a

    def _keep_clear(self, geometry: Any, pairs: list[tuple[int, int]]) -> None:
        """Keep for collision tests only the pairs that are apart by `TOUCHING` with all joints at home."""
        data = geometry.createData()
        home = self._make_q(0.0, 0.0, 0.0, self.robot.home)
        pinocchio.updateGeometryPlacements(self._model, self._data, geometry, data, home)
        request = coal.CollisionRequest()
        request.security_margin = TOUCHING
        for i, j in pairs:
            a, b = geometry.geometryObjects[i], geometry.geometryObjects[j]
            where = [coal.Transform3s(data.oMg[k].rotation, data.oMg[k].translation) for k in (i, j)]
            if not coal.collide(a.geometry, where[0], b.geometry, where[1], request, coal.CollisionResult()):
                geometry.addCollisionPair(pinocchio.CollisionPair(i, j))

    def _make_q(self, x: float, y: float, heading: float, angles: Sequence[float]) -> NDArray[np.float64]:
        q = _make_configuration(self._model, self._rest, self._used, self.robot, angles)
        q[:4] = x, y, math.cos(heading), math.sin(heading)
        return q

    def is_free(self, x: float, y: float, heading: float, angles: Sequence[float]) -> bool:
        """Return whether no link meets a solid, the floor or another link.

        The place is that of the base's axis in the room, m; heading and joint angles are rad.
        """
        return self._find_near(x, y)._test(x, y, heading, angles)

    def _test(self, x: float, y: float, heading: float, angles: Sequence[float]) -> bool:
        q = self._make_q(x, y, heading, angles)
        return not pinocchio.computeCollisions(self._model, self._data, self._manager, q, True)

    def measure_near(self, x: float, y: float, heading: float, angles: Sequence[float],
                     within: float) -> dict[frozenset[Key], float]:
        """Return the distances of the tested pairs that are nearer than `within`, m; arguments as of `is_free`."""
        near = self._find_near(x, y)
        data, q = near._geometry.createData(), near._make_q(x, y, heading, angles)
        for request in data.collisionRequests:
            request.security_margin = within
        pinocchio.computeCollisions(near._model, near._data, near._geometry, data, q, False)
        found = dict[frozenset[Key], float]()
        for number, (pair, result) in enumerate(zip(near._geometry.collisionPairs, data.collisionResults, strict=True)):
            if result.isCollision():
                away = pinocchio.computeDistance(near._geometry, data, number).min_distance
                key = near._name_pair(pair)
                found[key] = min(away, found[key]) if key in found else away
        return found

    def list_own_pairs(self) -> set[frozenset[Key]]:
        """Return the tested pairs of links of the robot."""
        return {pair for pair in map(self._name_pair, self._geometry.collisionPairs)
                if not any(isinstance(key, Solid) or key == "floor" for key in pair)}

    def advance(self, x: float, y: float, heading: float, angles: Sequence[float], change: NDArray[np.float64],
                most: float) -> float:
        """Return how much of a straight motion is certainly free from a posture on, by conservative advancement.

        A pair of bodies moves by at most `reach * change` for a joint between them, so that it stays apart while that
        is less than its distance. Distances are bounded by spheres around the bodies, and measured where that bound is
        too small (Schwarzer, Saha and Latombe 2005).

        Args:
            x: of the base's axis in the room, m.
            y: likewise.
            heading: of the base, rad.
            angles: of the joints, rad.
            change: how far x, y, heading and joints move in the whole motion, (3 + joints,), m and rad.
            most: largest share of the motion that is asked for.

        Returns:
            A share above 0 during which every pair keeps half its margin; negative if a pair is nearer than its margin.
        """
        return self._find_near(x, y)._advance(self._make_q(x, y, heading, angles), np.abs(change), most)

    def _advance(self, q: NDArray[np.float64], change: NDArray[np.float64], most: float) -> float:
        pairs, data = self._pairs, self._distances
        pinocchio.updateGeometryPlacements(self._model, self._data, self._geometry, data, q)
        centres = np.array([data.oMg[k].act(centre) for k, centre in enumerate(pairs.centres)])
        between = centres[pairs.first] - centres[pairs.second]
        away = np.sqrt((between * between).sum(axis=1)) - pairs.radii
        local = np.abs(between[pairs.on_solid][:, None, :] @ pairs.turns)[:, 0]
        outside = np.maximum(local - pairs.halves, 0.0)
        away[pairs.on_solid] = np.sqrt((outside * outside).sum(axis=1)) - pairs.solid_radii
        motion = pairs.speeds @ change
        share = (away - 0.5 * pairs.margins) / np.maximum(motion, 1e-12)
        for number in np.argsort(share).tolist():
            if share[number] >= most:
                break
            exact = pinocchio.computeDistance(self._geometry, data, number).min_distance
            if exact < pairs.margins[number]:
                return -1.0
            most = min(most, (exact - 0.5 * pairs.margins[number]) / max(motion[number], 1e-12))
        return most

    @cached_property
    def _distances(self) -> Any:
        return self._geometry.createData()

    @cached_property
    def _pairs(self) -> _Pairs:
        geometry, items = self._geometry, self._geometry.geometryObjects.tolist()
        ends = [(pair.first, pair.second) for pair in geometry.collisionPairs]
        first, second = np.array(ends, dtype=np.int64).reshape(-1, 2).T
        for item in items:
            item.geometry.computeLocalAABB()
        radii = np.array([item.geometry.aabb_radius for item in items])
        reaches = [self._measure_reach(item) for item in items]
        speeds = np.zeros((len(ends), 3 + len(self._used)))
        for number, (i, j) in enumerate(ends):
            for joint in reaches[i].keys() ^ reaches[j].keys():
                reach = reaches[i].get(joint, reaches[j].get(joint, 0.0))
                if joint == 1:
                    speeds[number, :3] += 1.0, 1.0, reach
                elif joint in self._moved:
                    planned, factor = self._moved[joint]
                    speeds[number, 3 + planned] += abs(factor) * reach
        on_solid = np.array([items[j].parentJoint == 0 for _, j in ends], dtype=bool)
        fixed = [items[j] for (_, j), is_fixed in zip(ends, on_solid, strict=True) if is_fixed]
        return _Pairs(first, second, [item.geometry.aabb_center for item in items], radii[first] + radii[second],
                      speeds, np.array([self._margins.get(self._name_pair(pair), self.margin)
                                        for pair in geometry.collisionPairs]),
                      on_solid, np.array([item.placement.rotation for item in fixed]).reshape(-1, 3, 3),
                      np.array([_measure_half(item.geometry) for item in fixed]).reshape(-1, 3),
                      radii[first[on_solid]])

    def _measure_reach(self, item: Any) -> dict[int, float]:
        """Metres that a shape moves at most for each unit of a joint above it, by the joint's number in the model."""
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

    def describe(self, pair: frozenset[Key]) -> str:
        """Describe a pair in words, such as `arm-3 to obstacle at (1, 2)`."""
        links = {item.name: self._model.frames[item.parentFrame].name
                 for item in self._geometry.geometryObjects.tolist() if item.parentJoint}
        words = [f"{key.role} at ({key.x:.4g}, {key.y:.4g})" if isinstance(key, Solid) else links.get(key, key)
                 for key in sorted(pair, key=lambda key: (isinstance(key, Solid) or key == "floor", str(key)))]
        return " to ".join(words)

    def list_collisions(self, x: float, y: float, heading: float, angles: Sequence[float]) -> list[str]:
        """List what meets at a posture, such as `arm-3 meets floor`; arguments as of `is_free`."""
        data, q = self._make_data(), self._make_q(x, y, heading, angles)
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


def _make_configuration(model: Any, rest: NDArray[np.float64], used: list[int], robot: Robot,
                        angles: Sequence[float]) -> NDArray[np.float64]:
    """Return the configuration vector of a model for angles of the planned joints, rad."""
    q = rest.copy()
    for joint, angle in zip(used, angles, strict=True):
        _set_joint(model, q, joint, angle)
    for name, (i, factor, offset) in robot.mimics.items():
        _set_joint(model, q, model.getJointId(name), factor * angles[i] + offset)
    return q


def _set_joint(model: Any, q: NDArray[np.float64], joint: int, angle: float) -> None:
    kind = model.joints[joint]
    q[kind.idx_q : kind.idx_q + kind.nq] = angle if kind.nq == 1 else (math.cos(angle), math.sin(angle))


def _read_origin(element: ElementTree.Element) -> Any:
    origin = element.find("origin")
    values = [(0.0, 0.0, 0.0)] * 2 if origin is None else [read_numbers(origin.get(key, "0 0 0"), 3)
                                                           for key in ("xyz", "rpy")]
    if None in values:
        raise RobotError("an <origin> of a collision shape of the URDF must have 3 finite numbers for xyz and rpy")
    xyz, rpy = values
    return pinocchio.SE3(pinocchio.rpy.rpyToMatrix(np.array(rpy)), np.array(xyz))


def _measure_half(shape: Any) -> NDArray[np.float64]:
    """Half sizes of the box around a solid in its own frame, m."""
    if isinstance(shape, coal.Box):
        return np.asarray(shape.halfSide)
    return np.array([shape.radius, shape.radius, shape.halfLength])


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
