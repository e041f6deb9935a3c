"""Arm model for planners: Pinocchio's kinematics of the robot's URDF, coal's collisions of its links.

The only wrapper of the two libraries. It chooses no configuration. Frame `base`: origin on the floor below the base's
axis, x ahead, z up; metres, radians.
"""

# pyright: reportAttributeAccessIssue=false
# (both libraries are compiled and carry no types)

from __future__ import annotations

import copy
import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from typing import Any, TypeAlias
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

from hrl_escape.planning.arm.bounds import MotionBounds  # needs coal
from hrl_escape.planning.arm.obstacles import Obstacle
from hrl_escape.planning.arm.shapes import make_shape, make_surface

_SLACK = 1e-9  # of a joint limit, as in `Kinematics`
_LEAST_MARGIN = 1e-6
"""Least margin of a test, m: without any, coal misses rare penetrations of convex hulls, up to centimetres deep."""
_FLOOR_SIDE = 1000.0  # m; rooms are at most 200 m wide
TOUCHING = 1e-3
"""Links that are nearer than this at home may touch, m: hulls are larger than the links."""
FEW_SOLIDS, MOST_TILES = 64, 256
"""Solids up to which all are tested, and tiles of the floor whose solids are kept beyond that."""


class ArmKinematics:
    """Kinematics of one robot, from Pinocchio, whose `model` has the base fixed at the origin.

    The hand is the robot's, or another link.
    """

    def __init__(self, robot: Robot, link: str = "") -> None:
        self.robot = robot
        self.model = pinocchio.buildModelFromXML(robot.urdf)
        self._data = self.model.createData()
        self._frame = self.model.getFrameId(link or robot.hand_link, pinocchio.BODY)
        self._used = [self.model.getJointId(name) for name in robot.joint_names]
        self._make_q = _JointMap(self.model, robot).make_q

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

    @cached_property
    def moves_hand(self) -> NDArray[np.bool_]:
        """Planned joints that move the hand, (joints,)."""
        above = {self.model.names[joint] for joint in self.model.supports[self.model.frames[self._frame].parentJoint]}
        followed = {number for name, (number, _, _) in self.robot.mimics.items() if name in above}
        return np.array([name in above or number in followed for number, name in enumerate(self.robot.joint_names)])

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


Key: TypeAlias = "str | Solid | Obstacle"
"""A thing that collides: the name of a link's shape, `floor`, a solid or an obstacle."""


@dataclasses.dataclass(frozen=True)
class PairRules:
    """Rules of the pairs of bodies that are tested.

    Attributes:
        srdf: text of an SRDF, or None.
        floor: height of the floor, m, or None for no floor.
        stands: the base never moves. Links that no planned joint moves are then not tested against solids.
        held: links that the hand holds. They are tested, with links that touch them at home, too.
        allowed: pairs of names of links and obstacles that may touch.
    """

    srdf: str | None = None
    floor: float | None = 0.0
    stands: bool = False
    held: frozenset[str] = frozenset()
    allowed: frozenset[frozenset[str]] = frozenset()


IN_ROOM = PairRules()
"""Rules of a robot that drives on a floor."""


class ArmCollisions:
    """Collision test of the arm against solids, the floor and the robot itself, by coal.

    The base against solids is left to `CollisionMap`. Three kinds of pairs are never tested: links joined to each
    other, links whose relative placement no planned joint changes, and pairs that an SRDF allows. Without an SRDF, or
    with one that allows none, pairs are left out that are nearer than `TOUCHING` with all joints at home, such as the
    arm's foot and the base, as is the floor for a link of a driving robot that rests on it at home. The hand is the
    sphere that presses, added to the shape of its link.

    Args:
        robot: the robot.
        hand_radius: radius of the hand, m; 0 for none.
        solids: solids of the room, or obstacles.
        margin: what is nearer than this collides, m.
        rules: rules of the tested pairs.
    """

    def __init__(self, robot: Robot, hand_radius: float, solids: Sequence[Solid | Obstacle], margin: float = 0.0,
                 rules: PairRules = IN_ROOM, *, _links: Any = None) -> None:
        self.robot = robot
        self._model = pinocchio.buildModelFromXML(robot.urdf, pinocchio.JointModelPlanar())
        self._data = self._model.createData()
        self._joints = _JointMap(self._model, robot)
        links = self._make_links(hand_radius) if _links is None else _links
        self._remake = partial(ArmCollisions, robot, hand_radius, rules=rules, _links=links)
        self._solids, self._near = tuple(solids), dict[tuple[int, int], ArmCollisions]()
        self.rules = rules
        geometry = links.copy()
        self._bounds = MotionBounds(self._model, geometry, robot)
        own = len(geometry.geometryObjects)
        self._keys: list[Key] = [item.name for item in geometry.geometryObjects]
        base = self._model.getFrameId(BASE_LINK, pinocchio.BODY)
        for number, solid in enumerate(solids):
            geometry.addGeometryObject(_make_collision_object(number, solid))
            self._keys.append(solid)
        tested = [i for i in range(own) if geometry.geometryObjects[i].parentFrame != base
                  and (self._bounds.list_moving(i) or not rules.stands)]
        for i in tested:
            for other in range(own, len(geometry.geometryObjects)):
                geometry.addCollisionPair(pinocchio.CollisionPair(i, other))
        apart = [(i, j) for i in range(own) for j in range(i + 1, own)
                 if not self._is_joined(geometry, i, j) and not self._bounds.is_rigid(i, j)]
        held = [pair for pair in apart if any(self._name_body(geometry.geometryObjects[k]) in rules.held for k in pair)]
        apart = [pair for pair in apart if pair not in held]
        if rules.srdf is None or "<disable_collisions" not in rules.srdf:
            self._keep_clear(geometry, apart)
        else:
            self._add_pairs(geometry, apart)
            pinocchio.removeCollisionPairsFromXML(self._model, geometry, rules.srdf)
        self._add_pairs(geometry, held)
        if rules.floor is not None:
            floor = geometry.addGeometryObject(_make_floor(rules.floor))
            self._keys.append("floor")
            resting = [(i, floor) for i in tested]
            self._add_pairs(geometry, resting) if rules.stands else self._keep_clear(geometry, resting)
        for pair in geometry.collisionPairs.tolist() if rules.allowed else ():
            if frozenset(self._name_body(geometry.geometryObjects[k]) for k in (pair.first, pair.second)) \
                    in rules.allowed:
                geometry.removeCollisionPair(pair)
        self._geometry = geometry  # the manager refers to it
        self._set_margins(margin, {})

    def _name_body(self, item: Any) -> str:
        """Return the name of the link that a shape belongs to, or of a solid or the floor."""
        return self._model.frames[item.parentFrame].name if item.parentJoint else item.name

    @staticmethod
    def _add_pairs(geometry: Any, pairs: list[tuple[int, int]]) -> None:
        for pair in pairs:
            geometry.addCollisionPair(pinocchio.CollisionPair(*pair))

    def with_margins(self, margin: float, margins: Mapping[frozenset[Key], float]) -> ArmCollisions:
        """Return the same test with another margin, m, and with the margins of some pairs; shapes are shared."""
        other = copy.copy(self)
        other._near = {}
        other._set_margins(margin, margins)
        return other

    def _set_margins(self, margin: float, margins: Mapping[frozenset[Key], float]) -> None:
        self.margin, self._margins = margin, margins
        self._each = np.array([margins.get(self._name_pair(pair), margin) for pair in self._geometry.collisionPairs])
        self._tests = dict[float, _PairTest]()

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
        if hand_radius > 0.0:
            number = self._model.getFrameId(self.robot.hand_link, pinocchio.BODY)
            hand = self._model.frames[number]
            links.addGeometryObject(
                pinocchio.GeometryObject("hand", hand.parentJoint, number, hand.placement, coal.Sphere(hand_radius)))
        return links

    def _find_near(self, x: float, y: float) -> ArmCollisions:
        """The same test against the solids that can be reached from a tile of the floor, for a test moves them all."""
        if len(self._solids) <= FEW_SOLIDS or self.rules.stands:
            return self
        reach = float(self.sweeps[-1])  # farthest that any point of the robot is from the base's axis, m
        side = reach / 2
        tile = math.floor(x / side), math.floor(y / side)
        if tile not in self._near:
            if len(self._near) == MOST_TILES:
                self._near.pop(next(iter(self._near)))
            at_x, at_y = (side * (number + 0.5) for number in tile)
            far = reach + side + self.margin
            near = self._remake([solid for solid in self._solids
                                 if compute_distance(at_x, at_y, solid.footprint) <= far])
            self._near[tile] = near.with_margins(self.margin, self._margins)
        return self._near[tile]

    @property
    def sweeps(self) -> NDArray[np.float64]:
        """Bound of the motion of any point of the robot, m, for each unit of a joint; the base's turn is last."""
        return self._bounds.sweeps

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
        q = self._joints.make_q(angles)
        q[:4] = x, y, math.cos(heading), math.sin(heading)
        return q

    def is_free(self, x: float, y: float, heading: float, angles: Sequence[float]) -> bool:
        """Return whether no link meets a solid, the floor or another link.

        The place is that of the base's axis in the room, m; heading and joint angles are rad.
        """
        return self.keeps(1.0, x, y, heading, angles)

    def keeps(self, share: float, x: float, y: float, heading: float, angles: Sequence[float],
              change: NDArray[np.float64] | None = None) -> bool:
        """Return whether every pair keeps a share of its margin, at a posture and at all postures around it.

        Two bodies approach each other by at most `reach * change` for each joint between them, so they are tested at
        the posture with that much more distance (Schwarzer, Saha and Latombe 2005).

        Args:
            share: of each margin.
            x: of the base's axis in the room, m.
            y: likewise.
            heading: of the base, rad.
            angles: of the joints, rad.
            change: largest deviations of x, y, heading and joints, (3 + joints,), m and rad; None for none.
        """
        near = self._find_near(x, y)
        return near._keeps(share, near._make_q(x, y, heading, angles), change)

    def _keeps(self, share: float, q: NDArray[np.float64], change: NDArray[np.float64] | None) -> bool:
        test = self._tests.get(share)
        if test is None:
            test = self._tests[share] = _PairTest(self._model, self._geometry, share * self._each, self._bounds)
        if change is not test.change:
            test.widen(change)
        return not pinocchio.computeCollisions(self._model, self._data, test.manager, q, True)

    def measure_near(self, x: float, y: float, heading: float, angles: Sequence[float],
                     within: float) -> dict[frozenset[Key], float]:
        """Return the distances of the tested pairs that are nearer than `within`, m; arguments as of `is_free`."""
        near = self._find_near(x, y)
        data, q = _make_data(near._geometry, within), near._make_q(x, y, heading, angles)
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
                if not any(not isinstance(key, str) or key == "floor" for key in pair)}

    def describe(self, pair: frozenset[Key]) -> str:
        """Describe a pair in words, such as `arm-3 to obstacle at (1, 2)`."""
        links = {item.name: self._name_body(item) for item in self._geometry.geometryObjects.tolist()
                 if item.parentJoint}
        ordered = sorted(pair, key=lambda key: (not isinstance(key, str) or key == "floor", str(key)))
        words = [f"{key.role} at ({key.x:.4g}, {key.y:.4g})" if isinstance(key, Solid)
                 else key.name if isinstance(key, Obstacle) else links.get(key, key) for key in ordered]
        return " to ".join(words)

    def list_collisions(self, x: float, y: float, heading: float, angles: Sequence[float]) -> list[str]:
        """List what meets at a posture, such as `arm-3 meets floor`; arguments as of `is_free`."""
        data, q = _make_data(self._geometry, self._each), self._make_q(x, y, heading, angles)
        pinocchio.computeCollisions(self._model, self._data, self._geometry, data, q, False)
        names = [self._name_body(item) for item in self._geometry.geometryObjects.tolist()]
        pairs = zip(self._geometry.collisionPairs, data.collisionResults, strict=True)
        return sorted({f"{names[pair.first]} meets {names[pair.second]}" for pair, found in pairs
                       if found.isCollision()})

    def list_allowed(self) -> list[tuple[str, str, str]]:
        """List pairs of links that may touch: two names, and why, as an SRDF's `reason`.

        Links joined to each other are `Adjacent`, others `Default`. A pair counts if any two of its shapes may touch.
        """
        tested = {frozenset((pair.first, pair.second)) for pair in self._geometry.collisionPairs}
        allowed: dict[tuple[str, str], str] = {}
        items = enumerate(self._geometry.geometryObjects.tolist())
        own = [(number, item) for number, item in items if item.parentJoint]  # no solids
        for (i, one), (j, other) in itertools.combinations(own, 2):
            first, second = self._name_body(one), self._name_body(other)
            if first != second and frozenset((i, j)) not in tested:
                allowed[first, second] = "Adjacent" if self._is_joined(self._geometry, i, j) else "Default"
        return [(first, second, reason) for (first, second), reason in allowed.items()]


class _JointMap:
    """Configuration vectors of a model for angles of the planned joints."""

    def __init__(self, model: Any, robot: Robot) -> None:
        self._rest = pinocchio.neutral(model)
        for name, angle in robot.rest.items():
            kind = model.joints[model.getJointId(name)]
            self._rest[kind.idx_q : kind.idx_q + kind.nq] = angle if kind.nq == 1 else (math.cos(angle),
                                                                                        math.sin(angle))
        moving = {name: (number, 1.0, 0.0) for number, name in enumerate(robot.joint_names)} | robot.mimics
        rows = [(model.joints[model.getJointId(name)], row) for name, row in moving.items()]
        plain, turning = ([(kind.idx_q, *row) for kind, row in rows if kind.nq == size] for size in (1, 2))
        self._plain, self._turning = (tuple(np.array(list(column)) for column in zip(*each, strict=True))
                                      for each in (plain, turning))

    def make_q(self, angles: Sequence[float]) -> NDArray[np.float64]:
        """Return the configuration vector for angles, rad; those of continuous joints are cosine and sine."""
        q, values = self._rest.copy(), np.asarray(angles, dtype=np.float64)
        if self._plain:
            at, numbers, factors, offsets = self._plain
            q[at] = factors * values[numbers] + offsets
        if self._turning:
            at, numbers, factors, offsets = self._turning
            turned = factors * values[numbers] + offsets
            q[at], q[at + 1] = np.cos(turned), np.sin(turned)
        return q


class _PairTest:
    """Broad-phase test of all pairs of bodies with margins, m, that can be widened."""

    def __init__(self, model: Any, geometry: Any, margins: NDArray[np.float64], bounds: MotionBounds) -> None:
        data = _make_data(geometry, margins)
        self.manager: Any = pinocchio.BroadPhaseManager_DynamicAABBTreeCollisionManager(model, geometry, data)
        self.change: NDArray[np.float64] | None = None
        self._requests, self._bounds = list(data.collisionRequests), bounds
        self._margins = np.array([request.security_margin for request in self._requests])

    def widen(self, change: NDArray[np.float64] | None) -> None:
        """Add to the margins how far the bodies of each pair approach when coordinates change, (3 + joints,)."""
        self.change = change
        wide = self._margins if change is None else self._margins + self._bounds.speeds @ change
        for request, margin in zip(self._requests, wide.tolist(), strict=True):
            request.security_margin = margin


def _make_data(geometry: Any, margins: ArrayLike) -> Any:
    """Results of collision tests with margins, m, of all pairs or of each, (pairs,)."""
    data = geometry.createData()
    for request, margin in zip(data.collisionRequests, np.broadcast_to(margins, len(data.collisionRequests)),
                               strict=True):
        request.security_margin = max(float(margin), _LEAST_MARGIN)
    return data


def _read_origin(element: ElementTree.Element) -> Any:
    origin = element.find("origin")
    values = [(0.0, 0.0, 0.0)] * 2 if origin is None else [read_numbers(origin.get(key, "0 0 0"), 3)
                                                           for key in ("xyz", "rpy")]
    if None in values:
        raise RobotError("an <origin> of a collision shape of the URDF must have 3 finite numbers for xyz and rpy")
    xyz, rpy = values
    return pinocchio.SE3(pinocchio.rpy.rpyToMatrix(np.array(rpy)), np.array(xyz))


def _make_floor(height: float) -> Any:
    """The floor: a slab below a height, m, since the bounding box of a half-space is infinite."""
    slab = coal.Box(_FLOOR_SIDE, _FLOOR_SIDE, 1.0)
    return pinocchio.GeometryObject("floor", 0, pinocchio.SE3(np.eye(3), np.array([0.0, 0.0, height - 0.5])), slab)


def _make_collision_object(number: int, solid: Solid | Obstacle) -> Any:
    if isinstance(solid, Obstacle):
        shape = (make_surface(solid.file, solid.sizes) if solid.file
                 else make_shape(solid.make_geometry(), solid.name))
        return pinocchio.GeometryObject(solid.name, 0, pinocchio.SE3(solid.placement), shape)
    if solid.shape == "cylinder":
        shape = coal.Cylinder(solid.half_x, solid.height)
    else:
        shape = coal.Box(2 * solid.half_x, 2 * solid.half_y, solid.height)
    turn = pinocchio.utils.rotate("z", solid.yaw)
    place = pinocchio.SE3(turn, np.array([solid.x, solid.y, solid.height / 2]))
    name = f"{solid.role} at ({solid.x:.4g}, {solid.y:.4g}), number {number}"
    return pinocchio.GeometryObject(name, 0, place, shape)
