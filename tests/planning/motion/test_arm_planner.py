"""IK beside other solvers and beside the closed form; motions that Bullet, at ten times the resolution, finds free."""

from __future__ import annotations

import itertools
import math
import tempfile
from typing import Any

import numpy as np
import pinocchio
import pybullet
import pytest
from scipy.optimize import least_squares

from hrl_escape.env.config import DynamicsConfig, RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.geometry import Solid
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.robot import BASE_LINK
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError, PlanningFailed, PlanningReason, UnknownNameError, UnsupportedError
from hrl_escape.planning.motion.arm_planner import ArmPlanner
from hrl_escape.planning.scene.scene import Scene
from hrl_escape.planning.trajectories.path import MotionPath


def make_room(kind: Any, joints: int):
    robot = RobotConfig(kind=kind, joints=joints, body_radius=0.4, body_height=0.5)
    panels = Panels(width=1.0, height=1.0, centre_height=0.8)
    return generate(RoomConfig(room=ShapeConfig(width=8, depth=8), robot=robot,
                               dynamics=DynamicsConfig(press_with="hand"),
                               puzzle=ButtonsConfig(count=1, buttons=panels)), 0)


def make_planner(kind="arm", joints=3):
    planner = ArmPlanner(make_room(kind, joints))
    return planner, planner.rules.make_state(planner.instance.starts[0])


def place_base(planner, state):
    """Placement of the base in the room (4, 4)."""
    at = np.eye(4)
    angle = planner.rules.get_heading(state)
    at[:2, :2] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
    at[:2, 3] = state.x, state.y
    return at


# --- inverse kinematics ------------------------------------------------------------------------


def solve_as_pinocchio_shows(arm, target, start):
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


def solve_as_scipy_does(arm, target, starts):
    """Bounded least squares by trust regions, from each of some starts."""
    low, high = np.array(arm.robot.limits).T

    def error(q):
        hand = arm.compute_placement(q.tolist())
        return np.concatenate([target[:3, 3] - hand[:3, 3], pinocchio.log3(target[:3, :3] @ hand[:3, :3].T)])

    return any(least_squares(error, np.clip(start, low + 1e-6, high - 1e-6), bounds=(low, high), xtol=1e-12,
                             ftol=1e-12, gtol=1e-12, max_nfev=100).cost < 0.5e-8 for start in starts)


def compare_solvers(kind: str, count: int, scipy_every: int) -> tuple[float, float, float]:
    """Shares of reachable poses that are solved: ours, Pinocchio's example's, scipy's (of every n-th)."""
    planner, state = make_planner(kind, 7)
    rng, arm, base = np.random.default_rng(0), planner.kinematics, place_base(planner, state)
    low, high = planner._limits
    ours = example = scipys = 0
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
        if number % scipy_every == 0:
            scipys += solve_as_scipy_does(arm, target, rng.uniform(low, high, size=(8, 7)))
    return ours / count, example / count, scipys / math.ceil(count / scipy_every)


@pytest.mark.parametrize("kind", ["franka-panda", "kuka-iiwa"])
def test_poses_are_solved_at_least_as_often_as_by_other_solvers(kind):
    ours, example, scipys = compare_solvers(kind, 20, 10)
    assert ours >= 0.9 and ours >= example and ours >= scipys - 0.1


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kind", ["franka-panda", "kuka-iiwa"])
def test_a_thousand_poses_are_solved_at_least_as_often_as_by_other_solvers(kind):
    ours, example, scipys = compare_solvers(kind, 1000, 20)
    print(f"{kind}: {ours:.3f} solved, Pinocchio's example {example:.3f}, scipy from eight starts {scipys:.3f}")
    assert ours >= 0.95 and ours >= example and ours >= scipys - 0.05


def test_all_branches_are_those_of_the_closed_form():
    """Yaw, then two pitching links: for a reachable point the elbow is up or down."""
    planner, state = make_planner("arm", 3)
    rng, base = np.random.default_rng(0), place_base(planner, state)
    low, high = planner._limits
    length, counts = planner.instance.robot.link_length, []
    for _ in range(25):
        angles = rng.uniform(low, high)
        point = planner.kinematics.compute_placement(angles.tolist())[:3, 3]
        yaw = math.atan2(point[1], point[0])
        out, up = math.hypot(point[0], point[1]) - length, point[2] - planner.instance.robot.body_height
        bend = math.acos(np.clip((out**2 + up**2 - 2 * length**2) / (2 * length**2), -1, 1))
        expected = []
        for elbow in (bend, -bend):  # positive pitch lifts
            shoulder = math.atan2(up, out) - math.atan2(length * math.sin(elbow), length * (1 + math.cos(elbow)))
            branch = np.array([yaw, shoulder, elbow])
            if (branch >= low).all() and (branch <= high).all():
                expected.append(branch)
        found = planner.solve_ik(base[:3, :3] @ point + base[:3, 3], state, seeds=24, only_free=False)
        if abs(bend) < 0.06:
            continue  # the two are one
        assert len(found) == len(expected)
        for branch in expected:
            assert min(np.abs(p.angles - branch).max() for p in found) < 2e-3
        counts.append(len(found))
    assert set(counts) == {1, 2}


def test_manipulability_is_the_volume_by_finite_differences():
    planner, state = make_planner("arm", 4)
    target = place_base(planner, state) @ planner.kinematics.compute_placement((0.1, 0.3, -0.4, 0.2))
    posture = planner.solve_ik(target[:3, 3], state)[0]
    columns = [(np.array(planner.rules.robot.compute_hand(posture.angles + h)) -
                np.array(planner.rules.robot.compute_hand(posture.angles - h))) / 2e-6 for h in 1e-6 * np.eye(4)]
    jacobian = np.array(columns).T
    assert posture.manipulability == pytest.approx(math.sqrt(np.linalg.det(jacobian @ jacobian.T)), rel=1e-4)


def test_what_is_out_of_reach_or_no_target_is_said():
    planner, state = make_planner()
    assert planner.solve_ik((50.0, 0.0, 1.0), state) == []
    for wrong in ((1.0, 2.0), "hand", np.zeros((4, 4)), (math.nan, 0, 0)):
        with pytest.raises(ConfigError, match="target"):
            planner.solve_ik(wrong, state)
    with pytest.raises(UnsupportedError, match="no arm"):
        ArmPlanner(generate(get_preset("clutter"), 0))


def test_a_reachability_map_agrees_with_inverse_kinematics(tmp_path):
    planner, state = make_planner("arm", 3)
    point = (0.5, -0.5, 0.8)
    reach = planner.map_reach(point)
    assert 0.0 < reach.share.max() <= 1.0
    best = reach.get_best()
    rng = np.random.default_rng(0)
    places = [best, *(np.array(point[:2]) + rng.uniform(-1.4, 1.4, size=(5, 2)))]
    for x, y in places:
        (x, y), number = (reach.low + (np.floor((np.array([x, y]) - reach.low) / 0.1) + 0.5) * 0.1).tolist(), 0
        for heading in range(0, 36, 3):
            there = state._replace(x=x, y=y, heading_steps=heading)
            number += bool(planner.solve_ik(point, there, seeds=2, only_free=False, tolerance=0.05))
        share = reach.share[int((x - reach.low[0]) / 0.1), int((y - reach.low[1]) / 0.1)]
        assert abs(number / 12 - share) <= 0.17 or (share == 0.0 and not planner._floor.is_free(x, y))
    reach.draw(tmp_path / "reach.png")


# --- motion ----------------------------------------------------------------------------------------


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

    def place(self, x, y, heading, angles):
        turn = pybullet.getQuaternionFromEuler((0, 0, heading))
        info = pybullet.getDynamicsInfo(self.body, -1, physicsClientId=self.client)
        centre, _ = pybullet.multiplyTransforms((x, y, 0), turn, info[3], info[4])
        pybullet.resetBasePositionAndOrientation(self.body, centre, turn, physicsClientId=self.client)
        for name, angle in {**self.robot.rest, **dict(zip(self.robot.joint_names, angles, strict=True))}.items():
            pybullet.resetJointState(self.body, self.numbers[name], angle, physicsClientId=self.client)

    def measure(self, a, b):
        points = pybullet.getClosestPoints(self.body, self.body, 0.05, a, b, physicsClientId=self.client)
        return min((point[8] for point in points), default=0.05)

    def compute_clearance(self) -> float:
        """Least distance of a link above the base from a solid, and of two links, up to 5 cm."""
        least = min((self.measure(a, b) for a, b in self.pairs), default=0.05)
        for solid in self.solids:
            points = pybullet.getClosestPoints(self.body, solid, 0.05, physicsClientId=self.client)
            base = {-1, self.links.get(BASE_LINK, -1)}
            least = min([least, *(point[8] for point in points if point[3] not in base)])
        return least

    def close(self):
        pybullet.disconnect(self.client)


def surround(planner: ArmPlanner, state, rng) -> ArmPlanner:
    """A room with six posts and boxes within the arm's reach."""
    scene = Scene.of(planner.instance, state)
    for number in range(60):
        angle, away = rng.uniform(-math.pi, math.pi), rng.uniform(0.75, 1.7)
        solid = Solid(("box", "cylinder")[number % 2], state.x + away * math.cos(angle),
                      state.y + away * math.sin(angle), *rng.uniform(0.05, 0.15, size=2).tolist(),
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
    """Plans motions in clutter; returns how many were planned, and how many of these are not straight lines."""
    planned = bent = 0
    rng = np.random.default_rng(0)
    empty, state = make_planner(kind, joints)
    for first in range(0, queries, 10):
        planner = surround(empty, state, rng)
        check = BulletCheck(planner)
        for _ in range(first, min(first + 10, queries)):
            path = plan_between_random_postures(planner, state, rng)
            if path is not None:
                spacing = 2.0 * path.margin / math.sqrt(joints) / float(path.scale.max())
                for angles in path.interpolate(spacing / 10):
                    check.place(state.x, state.y, planner.rules.get_heading(state), angles.tolist())
                    assert check.compute_clearance() > 0.0
                planned, bent = planned + 1, bent + (len(path.points) > 2)
        check.close()
    return planned, bent


def plan_between_random_postures(planner, state, rng) -> MotionPath | None:
    """A path between two free postures; None if the budget did not suffice."""
    low, high = planner._limits
    samples = (rng.uniform(low, high) for _ in range(500))
    begin, end = itertools.islice((q for q in samples if planner.is_free(state, q.tolist(), 0.005)), 2)
    offsets = tuple((begin - planner.rules.robot.home).tolist())
    try:
        path = planner.plan(state._replace(joint_offsets=offsets), end)
    except PlanningFailed as failure:
        assert failure.reason in (PlanningReason.BUDGET_EXHAUSTED, PlanningReason.UNREACHABLE_AT_RESOLUTION)
        return None
    assert np.allclose(path.points[0], begin) and np.allclose(path.points[-1], end)
    assert (path.points >= low - 1e-9).all() and (path.points <= high + 1e-9).all()
    return path


def test_motions_in_clutter_are_free_by_bullet_at_ten_times_the_resolution():
    planned, bent = check_motions("arm", 3, 4)
    assert planned >= 3 and bent >= 1


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize(("kind", "joints"), [("arm", 4), ("franka-panda", 7)])
def test_two_hundred_motions_in_clutter_are_free_by_bullet_at_ten_times_the_resolution(kind, joints):
    planned, bent = check_motions(kind, joints, 200 if kind == "arm" else 40)
    print(f"{kind}: {planned} planned, {bent} of them round something")
    assert planned >= 0.95 * (200 if kind == "arm" else 40) and bent >= 10


def test_base_and_arm_move_together_where_neither_could_alone():
    """A low bar across the room's middle stops an arm held out, and a wall with a gap the straight way."""
    planner, state = make_planner("arm", 3)
    state = state._replace(x=-2.0, y=0.0, heading_steps=0)
    scene = Scene.of(planner.instance, state).add("left", Solid("box", 0.0, 2.3, 0.1, 1.6, height=1.5))
    scene = scene.add("right", Solid("box", 0.0, -2.3, 0.1, 1.6, height=1.5))
    planner = ArmPlanner(scene.instance)
    home = planner.rules.robot.home
    path = planner.plan_whole_body(state, (2.0, 1.5, math.pi / 2), (0.5, 0.2, 0.0))
    assert path.names[:3] == ("x", "y", "heading") and np.allclose(path.points[0][3:], home)
    assert np.allclose(path.points[-1], (2.0, 1.5, math.pi / 2, 0.5, 0.2, 0.0))
    check = BulletCheck(planner)
    for x, y, heading, *angles in path.interpolate(0.01).tolist():
        assert planner._floor.is_free(x, y)
        check.place(x, y, heading, angles)
        assert check.compute_clearance() > 0.0
    check.close()


def test_motions_are_the_same_again_and_failures_have_reasons():
    planner, state = make_planner("arm", 3)
    one, two = (planner.plan(state, (0.9, 0.5, -0.8), seed=3).points for _ in range(2))
    assert np.array_equal(one, two)
    with pytest.raises(ConfigError, match="3 joints"):
        planner.plan(state, (0.1, 0.2))
    with pytest.raises(UnknownNameError):
        planner.plan(state, (0.1, 0.2, 0.3), planner="nobody")
    heading = planner.rules.get_heading(state)
    hand = planner.rules.get_hand(state)
    wall = Solid("box", hand[0] - 0.3 * math.cos(heading), hand[1] - 0.3 * math.sin(heading), 0.05, 0.05, height=2.0)
    stuck = ArmPlanner(Scene.of(planner.instance, state).add("post", wall).instance)
    with pytest.raises(PlanningFailed) as failed:
        stuck.plan(state, (0.9, 0.0, 0.0))
    assert failed.value.reason is PlanningReason.START_INVALID
    with pytest.raises(PlanningFailed) as failed:
        stuck.plan(state._replace(joint_steps=(5, 0, 0)), (0.0, 0.0, 0.0))
    assert failed.value.reason is PlanningReason.GOAL_INVALID
