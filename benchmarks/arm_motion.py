"""Arms: inverse kinematics against other solvers, and motions in clutter that Bullet finds free.

Run: `python benchmarks/arm_motion.py` (six minutes on an idle core; `--poses 20 --motions 4` a few seconds); exits
with 1 if a target is missed. A thousand reachable poses a robot are solved by `ArmPlanner.solve_ik` from
eight starts, by the loop that Pinocchio's own example shows, by pink (`pip install pin-pink daqp`; left out
where it is not installed) from eight starts, and, every n-th, by scipy's bounded least squares from eight
starts. Then motions between random postures are planned among posts and boxes, and
every one is walked at ten times the planner's resolution with Bullet's distances, which the planner does
not use: links against solids, and links against links.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
import tempfile
import time
from typing import Any

import numpy as np
import pinocchio
import pybullet
from numpy.typing import NDArray
from scipy.optimize import least_squares

from hrl_escape.env.config import DynamicsConfig, RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.geometry import Solid
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.robot import BASE_LINK
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError, PlanningFailed, PlanningReason
from hrl_escape.planning.arm.arm_planner import ArmPlanner
from hrl_escape.planning.arm.model import ArmKinematics
from hrl_escape.planning.paths.problem import MotionPath
from hrl_escape.planning.scene import Scene

try:
    import pink
except ImportError:  # no dependency of this project
    pink = None


def make_room(kind: Any, joints: int) -> RoomInstance:
    """An 8 m room with one large panel and a robot with this arm."""
    robot = RobotConfig(kind=kind, joints=joints, body_radius=0.4, body_height=0.5)
    panels = Panels(width=1.0, height=1.0, centre_height=0.8)
    return generate(RoomConfig(room=ShapeConfig(width=8, depth=8), robot=robot,
                               dynamics=DynamicsConfig(press_with="hand"),
                               puzzle=ButtonsConfig(count=1, buttons=panels)), 0)


def make_planner(kind: str = "arm", joints: int = 3) -> tuple[ArmPlanner, RoomState]:
    """Planner of such a room, and the robot's first state."""
    planner = ArmPlanner(make_room(kind, joints))
    return planner, planner.rules.make_state(planner.instance.starts[0])


def place_base(planner: ArmPlanner, state: RoomState) -> NDArray[np.float64]:
    """Placement of the base in the room, shape (4, 4)."""
    at = np.eye(4)
    angle = planner.rules.get_heading(state)
    at[:2, :2] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
    at[:2, 3] = state.x, state.y
    return at


def solve_as_pinocchio_shows(arm: ArmKinematics, target: NDArray[np.float64], start: tuple[float, ...]) -> bool:
    """The loop of Pinocchio's example `inverse-kinematics.py`: Newton steps with little damping, limits left out."""
    model, data = arm.model, arm.model.createData()
    frame, q = arm._frame, arm._make_q(start)
    for _ in range(1000):
        pinocchio.framesForwardKinematics(model, data, q)
        error = pinocchio.log(data.oMf[frame].inverse() * pinocchio.SE3(target)).vector
        if np.linalg.norm(error) < 1e-4:
            low, high = np.array(arm.robot.limits).T
            angles = np.array([q[model.joints[j].idx_q] for j in arm._used])
            return bool((angles >= low).all() and (angles <= high).all())
        jacobian = pinocchio.computeFrameJacobian(model, data, q, frame)
        jacobian = -pinocchio.Jlog6(data.oMf[frame].inverse() * pinocchio.SE3(target)) @ jacobian
        step = -jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-12 * np.eye(6), error)
        q = pinocchio.integrate(model, q, 0.1 * step)
    return False


def solve_as_scipy_does(arm: ArmKinematics, target: NDArray[np.float64], starts: NDArray[np.float64]) -> bool:
    """Bounded least squares by trust regions, from each of some starts."""
    low, high = np.array(arm.robot.limits).T

    def error(q: NDArray[np.float64]) -> NDArray[np.float64]:
        hand = arm.compute_placement(q.tolist())
        return np.concatenate([target[:3, 3] - hand[:3, 3], pinocchio.log3(target[:3, :3] @ hand[:3, :3].T)])

    return any(least_squares(error, np.clip(start, low + 1e-6, high - 1e-6), bounds=(low, high), xtol=1e-12,
                             ftol=1e-12, gtol=1e-12, max_nfev=100).cost < 0.5e-8 for start in starts)


class PinkSolver:
    """A frame task of pink with its defaults, stepped until the hand is there or comes no nearer."""

    def __init__(self, arm: ArmKinematics) -> None:
        self.arm, self.model = arm, arm.model.copy()
        self.low, self.high = self.model.lowerPositionLimit.copy(), self.model.upperPositionLimit.copy()
        self.used = [self.model.joints[j].idx_q for j in arm._used]
        self.low[self.used], self.high[self.used] = np.array(arm.robot.limits).T
        self.model.lowerPositionLimit, self.model.upperPositionLimit = self.low, self.high
        self.task = pink.FrameTask(self.model.frames[arm._frame].name, position_cost=1.0, orientation_cost=1.0)

    def solve(self, target: NDArray[np.float64], start: NDArray[np.float64]) -> bool:
        """Return whether the hand comes within 1e-4 (m, rad) of a placement, the joints within their limits."""
        self.task.set_target(pinocchio.SE3(target))
        first = np.clip(self.arm._make_q(tuple(start.tolist())), self.low, self.high)
        configuration = pink.Configuration(self.model, self.model.createData(), first)
        before = math.inf
        for count in range(100):
            error = float(np.linalg.norm(self.task.compute_error(configuration)))
            if error < 1e-4:
                q = configuration.q[self.used]
                return bool((q >= self.low[self.used] - 1e-6).all() and (q <= self.high[self.used] + 1e-6).all())
            if count % 20 == 19:
                if error > 0.9 * before:
                    return False
                before = error
            try:
                velocity = pink.solve_ik(configuration, [self.task], 1.0, "daqp", damping=1e-9, safety_break=False)
            except pink.exceptions.NoSolutionFound:
                return False
            configuration.integrate_inplace(velocity, 1.0)
        return False


def compare_solvers(kind: str, count: int, scipy_every: int) -> tuple[float, float, float, float]:
    """Shares of reachable poses that are solved: ours, Pinocchio's example's, pink's, scipy's (of every n-th)."""
    planner, state = make_planner(kind, 7)
    rng, arm, base = np.random.default_rng(0), planner.kinematics, place_base(planner, state)
    low, high = planner._limits
    ours = example = pinks = scipys = 0
    others, pink_solver = np.random.default_rng(1), PinkSolver(arm) if pink else None
    for number in range(count):
        target = arm.compute_placement(rng.uniform(low, high).tolist())
        found = planner.solve_ik(base @ target, state, seeds=8, only_free=False)
        for posture in found:
            hand = base @ arm.compute_placement(posture.angles.tolist())
            assert np.linalg.norm((hand - base @ target)[:3, 3]) < 2e-4
            assert np.abs(hand[:3, :3] - (base @ target)[:3, :3]).max() < 2e-4
            assert posture.margin >= 0.0 and posture.manipulability >= 0.0
        ours += bool(found)
        example += solve_as_pinocchio_shows(arm, target, planner.rules.robot.home)
        if pink_solver:
            starts = np.vstack([planner.rules.robot.home, others.uniform(low, high, size=(7, 7))])
            pinks += any(pink_solver.solve(target, start) for start in starts)
        if number % scipy_every == 0:
            scipys += solve_as_scipy_does(arm, target, rng.uniform(low, high, size=(8, 7)))
    return ours / count, example / count, pinks / count, scipys / math.ceil(count / scipy_every)


class BulletCheck:
    """Distances by Bullet between the robot's links and a room's solids, and between its links."""

    def __init__(self, planner: ArmPlanner) -> None:
        self.client, self.robot = pybullet.connect(pybullet.DIRECT), planner.rules.robot
        with tempfile.NamedTemporaryFile("w", suffix=".urdf") as file:
            file.write(self.robot.urdf)
            file.flush()
            self.body = pybullet.loadURDF(file.name, flags=pybullet.URDF_USE_SELF_COLLISION,
                                          physicsClientId=self.client)
        infos = [pybullet.getJointInfo(self.body, j, physicsClientId=self.client)
                 for j in range(pybullet.getNumJoints(self.body, physicsClientId=self.client))]
        self.numbers = {info[1].decode(): j for j, info in enumerate(infos)}
        self.links = {info[12].decode(): j for j, info in enumerate(infos)}
        self.parents = {j: info[16] for j, info in enumerate(infos)}
        self.solids = []
        for solid in planner.instance.solids:
            place = {"basePosition": (solid.x, solid.y, solid.height / 2),
                     "baseOrientation": pybullet.getQuaternionFromEuler((0, 0, solid.yaw))}
            sizes = ({"halfExtents": (solid.half_x, solid.half_y, solid.height / 2)} if solid.shape == "box"
                     else {"radius": solid.half_x, "height": solid.height})
            kind = pybullet.GEOM_BOX if solid.shape == "box" else pybullet.GEOM_CYLINDER
            shape = pybullet.createCollisionShape(kind, **sizes, physicsClientId=self.client)
            self.solids.append(pybullet.createMultiBody(0, shape, **place, physicsClientId=self.client))
        self.place(0.0, 0.0, 0.0, self.robot.home)
        moving = [-1, *(j for j in self.parents if j >= 0)]
        self.pairs = [(a, b) for a, b in itertools.combinations(moving, 2)
                      if self.parents.get(a) != b and self.parents.get(b) != a and self.measure(a, b) > 1e-3]

    def place(self, x: float, y: float, heading: float, angles: list[float] | tuple[float, ...]) -> None:
        """Put the robot there."""
        turn = pybullet.getQuaternionFromEuler((0, 0, heading))
        info = pybullet.getDynamicsInfo(self.body, -1, physicsClientId=self.client)
        centre, _ = pybullet.multiplyTransforms((x, y, 0), turn, info[3], info[4])
        pybullet.resetBasePositionAndOrientation(self.body, centre, turn, physicsClientId=self.client)
        for name, angle in {**self.robot.rest, **dict(zip(self.robot.joint_names, angles, strict=True))}.items():
            pybullet.resetJointState(self.body, self.numbers[name], angle, physicsClientId=self.client)

    def measure(self, a: int, b: int) -> float:
        """Distance of two links of the robot, up to 5 cm, m."""
        points = pybullet.getClosestPoints(self.body, self.body, 0.05, a, b, physicsClientId=self.client)
        return min((point[8] for point in points), default=0.05)

    def compute_clearance(self) -> float:
        """Least distance of a link above the base from a solid, and of two links, up to 5 cm, m."""
        least = min((self.measure(a, b) for a, b in self.pairs), default=0.05)
        for solid in self.solids:
            points = pybullet.getClosestPoints(self.body, solid, 0.05, physicsClientId=self.client)
            base = {-1, self.links.get(BASE_LINK, -1)}
            least = min([least, *(point[8] for point in points if point[3] not in base)])
        return least

    def close(self) -> None:
        """Disconnect from Bullet."""
        pybullet.disconnect(self.client)


def surround(planner: ArmPlanner, state: RoomState, rng: np.random.Generator) -> ArmPlanner:
    """A room with six posts and boxes within the arm's reach."""
    scene = Scene.of(planner.instance, state)
    for number in range(60):
        angle, away = rng.uniform(-math.pi, math.pi), rng.uniform(0.75, 1.7)
        solid = Solid(("box", "cylinder")[number % 2], state.x + away * math.cos(angle),
                      state.y + away * math.sin(angle), float(rng.uniform(0.05, 0.15)), float(rng.uniform(0.05, 0.15)),
                      float(rng.uniform(-3, 3)), height=float(rng.uniform(0.4, 1.2)))
        try:
            added = scene.add(f"post-{number}", solid)
        except ConfigError:
            continue
        if ArmPlanner(added.instance).is_free(state, planner.rules.get_angles(state)):
            scene = added
        if len(scene.names) == 10:
            break
    return ArmPlanner(scene.instance)


def check_motions(kind: str, joints: int, queries: int) -> tuple[int, int]:
    """Plan motions in clutter; returns how many were planned, and how many of these are not straight lines.

    Raises:
        AssertionError: one is not free.
    """
    planned = bent = 0
    rng = np.random.default_rng(0)
    empty, state = make_planner(kind, joints)
    for first in range(0, queries, 10):
        planner = surround(empty, state, rng)
        check = BulletCheck(planner)
        for _ in range(first, min(first + 10, queries)):
            path = plan_between_random_postures(planner, state, rng)
            if path is not None:
                for angles in path.interpolate(0.001 / math.sqrt(joints) / float(path.scale.max())):
                    check.place(state.x, state.y, planner.rules.get_heading(state), angles.tolist())
                    assert check.compute_clearance() > 0.0
                planned, bent = planned + 1, bent + (len(path.points) > 2)
        check.close()
    return planned, bent


def plan_between_random_postures(planner: ArmPlanner, state: RoomState, rng: np.random.Generator) -> MotionPath | None:
    """A path between two free postures, or None if the budget did not suffice."""
    low, high = planner._limits
    samples = (rng.uniform(low, high) for _ in range(500))
    begin, end = itertools.islice((q for q in samples if planner.is_free(state, q.tolist(), 0.005)), 2)
    robot = planner.rules.robot
    turned = begin - robot.home
    steps = np.clip(np.round(turned / robot.step).astype(int), robot.step_low, robot.step_high)
    offsets = turned - steps * robot.step
    try:
        turned_state = state._replace(joint_steps=tuple(steps.tolist()), joint_offsets=tuple(offsets.tolist()))
        path = planner.plan(turned_state, end)
    except PlanningFailed as failure:
        assert failure.reason in (PlanningReason.BUDGET_EXHAUSTED, PlanningReason.UNREACHABLE_AT_RESOLUTION)
        return None
    assert np.allclose(path.points[0], begin) and np.allclose(path.points[-1], end)
    assert (path.points >= low - 1e-9).all() and (path.points <= high + 1e-9).all()
    return path


def main() -> int:
    """Measure everything."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--poses", type=int, default=1000, help="poses a robot; 0 for none")
    parser.add_argument("--motions", type=int, default=200,
                        help="motions of four joints, and a twentieth as many by a Panda")
    args = parser.parse_args()
    met = []
    for kind in ("franka-panda", "kuka-iiwa") if args.poses else ():
        begin = time.thread_time()
        ours, example, pinks, scipys = compare_solvers(kind, args.poses, 20)
        by_pink = f"by pink {pinks:.1%}, " if pink else ""
        print(f"{kind}: {ours:.1%} of {args.poses} poses solved, by Pinocchio's example {example:.1%}, {by_pink}by "
              f"scipy {scipys:.1%} of every 20th; {time.thread_time() - begin:.0f} s CPU", flush=True)
        met.append(ours >= 0.95 and ours >= example and ours >= scipys - 0.05)
    for kind, joints, count in (("arm", 4, args.motions), ("franka-panda", 7, args.motions // 20)):
        begin = time.thread_time()
        planned, bent = check_motions(kind, joints, count)
        print(f"{kind}, {joints} joints: {planned} of {count} motions planned, all free by Bullet, {bent} round "
              f"something; {time.thread_time() - begin:.0f} s CPU", flush=True)
        met.append(planned >= 0.95 * count)
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main())
