"""IK beside other solvers and beside the closed form; motions that Bullet, at ten times the resolution, finds free."""

from __future__ import annotations

import dataclasses
import itertools
import math
from xml.etree import ElementTree

import numpy as np
import pytest

from benchmarks.arm_motion import BulletCheck, check_motions, compare_solvers, make_planner, place_base
from hrl_escape.env.config import RobotConfig, RoomConfig
from hrl_escape.env.geometry import Solid
from hrl_escape.env.presets import get_preset
from hrl_escape.env.robot import make_robot
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError, PlanningFailed, PlanningReason, UnknownNameError, UnsupportedError
from hrl_escape.planning.arm.arm_planner import ArmPlanner
from hrl_escape.planning.arm.model import FEW_SOLIDS, ArmCollisions
from hrl_escape.planning.arm.motion_search import CLEARANCE
from hrl_escape.planning.motion.trajectory import make_trajectory
from hrl_escape.planning.scene import Scene
from tests.planning.arm.robots import make_arm, place_arm

# --- inverse kinematics ------------------------------------------------------------------------


@pytest.mark.nightly
@pytest.mark.nightly_for("franka-panda")
@pytest.mark.parametrize("kind", ["franka-panda", "kuka-iiwa"])
def test_poses_are_solved_at_least_as_often_as_by_other_solvers(kind):
    ours, example, _, scipys = compare_solvers(kind, 20, 10)
    assert ours >= 0.9 and ours >= example and ours >= scipys - 0.1


@pytest.mark.nightly
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


@pytest.mark.nightly
def test_what_is_out_of_reach_or_no_target_is_said():
    planner, state = make_planner()
    assert planner.solve_ik((50.0, 0.0, 1.0), state) == []
    for wrong in ((1.0, 2.0), "hand", np.zeros((4, 4)), (math.nan, 0, 0)):
        with pytest.raises(ConfigError, match="target"):
            planner.solve_ik(wrong, state)
    with pytest.raises(UnsupportedError, match="no arm"):
        ArmPlanner(generate(get_preset("clutter"), 0))


@pytest.mark.nightly
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


@pytest.mark.parametrize("joints", [3, 4])
def test_a_posture_is_free_only_if_the_hand_is_above_the_floor(joints):
    """By the closed form: the lowest point of the hand is its centre less its radius."""
    planner, state = make_planner("arm", joints)
    low, high = planner._limits
    radius, rng, sunk = planner.instance.robot.hand_radius, np.random.default_rng(2), 0
    for angles in rng.uniform(low, high, size=(2_000, len(low))).tolist():
        height = planner.kinematics.compute_placement(angles)[2, 3]
        if height < radius - 1e-6:
            sunk += 1
            assert not planner.is_free(state, angles), f"the hand is {radius - height:.3f} m in the floor"
    assert sunk >= 20


@pytest.mark.nightly
def test_a_motion_goes_over_the_floor_and_not_through_it():
    planner, state = make_planner("arm", 4)
    low, high = planner._limits
    radius, rng = planner.instance.robot.hand_radius, np.random.default_rng(5)
    free = [angles for angles in rng.uniform(low, high, size=(400, len(low))) if planner.is_free(state, angles)]
    free.sort(key=lambda angles: planner.kinematics.compute_placement(angles.tolist())[2, 3])
    for begin, goal in zip(free[:4], free[4:8], strict=True):
        offsets = tuple((begin - np.array(planner.rules.robot.home)).tolist())
        path = planner.plan(state._replace(joint_offsets=offsets), goal)
        heights = [planner.kinematics.compute_placement(angles)[2, 3] for angles in path.interpolate(0.02).tolist()]
        assert min(heights) > radius


@pytest.mark.nightly
def test_motions_in_clutter_are_free_by_bullet_at_ten_times_the_resolution():
    planned, bent = check_motions("arm", 3, 4)
    assert planned >= 3 and bent >= 1


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
    for wrong in ((0.1, 0.2), (0.1, 0.2, 99.0), (0.1, -99.0, 0.2), (0.1, 0.2, math.nan)):
        with pytest.raises(ConfigError, match="3 joints"):
            planner.plan(state, wrong)
    for wrong in ((state.x, state.y), (state.x, state.y, math.nan), (99.0, state.y, 0.0)):
        with pytest.raises(ConfigError, match="place"):
            planner.plan_whole_body(state, wrong, (0.1, 0.2, 0.3))
    with pytest.raises(UnknownNameError):
        planner.plan(state, (0.1, 0.2, 0.3), planner="nobody")
    heading = planner.rules.get_heading(state)
    hand = planner.rules.get_hand(state)
    wall = Solid("box", hand[0] - 0.3 * math.cos(heading), hand[1] - 0.3 * math.sin(heading), 0.05, 0.05, height=2.0)
    stuck = ArmPlanner(Scene.of(planner.instance, state).add("post", wall).instance)
    with pytest.raises(PlanningFailed) as failed:
        stuck.plan(state, (0.9, 0.0, 0.0))
    assert failed.value.reason is PlanningReason.START_INVALID
    assert "arm-3 meets obstacle at (" in str(failed.value) and "arm-1 meets" not in str(failed.value)
    with pytest.raises(PlanningFailed) as failed:
        stuck.plan(state._replace(joint_steps=(5, 0, 0)), (0.0, 0.0, 0.0))
    assert failed.value.reason is PlanningReason.GOAL_INVALID and "meets obstacle" in str(failed.value)


SRDF = """<robot name="arm"><group_state name="up" group="arm"><joint name="joint-2" value="0.9"/></group_state>
<disable_collisions link1="mobile-base" link2="arm-1" reason="Adjacent"/>
<disable_collisions link1="{0}" link2="{1}" reason="Never"/></robot>"""


def test_an_srdf_says_which_links_may_touch_and_names_postures(tmp_path):
    """The third link is folded back into the first: a collision, unless the SRDF allows that pair."""
    room = make_planner("arm", 3)[0].instance
    room = dataclasses.replace(room, robot=dataclasses.replace(room.robot, joint_limit_deg=179.0))
    folded = (0.0, 0.4, math.radians(179.0) - 0.05)
    free = {}
    for pair in (("arm-1", "arm-3"), ("arm-1", "hand")):
        path = tmp_path / "arm.srdf"
        path.write_text(SRDF.format(*pair))
        planner = ArmPlanner(room, srdf=path)
        state = planner.rules.make_state(room.starts[0])
        free[pair[1]] = {text for text in planner._get_collisions(0.0).list_collisions(state.x, state.y, 0.0, folded)}
        assert planner.postures == {"up": (0.0, 0.9, 0.0)}
        assert planner.plan(state, planner.postures["up"]).points[-1] == pytest.approx(planner.postures["up"])
    assert "arm-1 meets arm-3" in free["hand"] and "arm-1 meets arm-3" not in free["arm-3"]
    for wrong in ("<urdf/>", "<robot", str(tmp_path / "none.srdf")):
        with pytest.raises(ConfigError, match="srdf"):
            ArmPlanner(room, srdf=wrong)


@pytest.mark.nightly_for("franka-panda-7", "kuka-iiwa-7")
@pytest.mark.parametrize(("kind", "joints"), [("franka-panda", 7), ("kuka-iiwa", 7), ("arm", 3)])
def test_an_srdf_that_is_made_reads_back_as_the_same_arm(kind, joints):
    planner, state = make_planner(kind, joints)
    planner.postures["tucked"] = tuple(0.3 * low + 0.7 * high for low, high in planner.rules.robot.limits)
    again = ArmPlanner(planner.instance, srdf=planner.to_srdf())
    assert again.postures == {"home": planner.rules.robot.home, **planner.postures}
    assert again.to_srdf() == planner.to_srdf()
    rng, (low, high) = np.random.default_rng(0), np.array(planner.rules.robot.limits).T
    met = set()
    for angles in rng.uniform(low, high, (150, joints)).tolist():
        one, other = (each._get_collisions(0.0).list_collisions(state.x, state.y, 0.3, angles)
                      for each in (planner, again))
        assert one == other
        met.update(one)
    assert not {f"{first} meets {second}" for first, second, _ in planner._get_collisions(0.0).list_allowed()} & met
    assert any("meets" in each for each in met)


def test_the_made_srdf_of_a_panda_allows_pairs_that_moveit_allows_and_tests_none_that_touch_at_home():
    """MoveIt's own matrix for a Panda has these pairs as adjacent or always in touch."""
    planner, _ = make_planner("franka-panda", 7)
    root = ElementTree.fromstring(planner.to_srdf())
    pairs = {frozenset((each.get("link1"), each.get("link2"))): each.get("reason")
             for each in root.findall("disable_collisions")}
    for number in range(7):
        assert pairs[frozenset((f"panda_link{number}", f"panda_link{number + 1}"))] == "Adjacent"
    assert pairs[frozenset(("panda_link5", "panda_link7"))] == "Default"
    assert frozenset(("panda_link0", "panda_link5")) not in pairs
    assert root.find("group[@name='arm']/chain").attrib == {
        "base_link": "mobile-base", "tip_link": planner.rules.robot.hand_link}
    assert root.find("group[@name='hand']/link").get("name") == planner.rules.robot.hand_link == "panda_grasptarget"
    assert root.find("end_effector").get("parent_link") == "panda_hand"


def test_pairs_that_touch_at_home_count_where_the_srdf_does_not_allow_them():
    """A Panda's hulls of the fifth and seventh link overlap at joint angles 0, as MoveIt's own SRDF has it."""
    planner, state = make_planner("franka-panda", 7)
    home = planner.rules.robot.home
    assert planner.is_free(state, home)
    other = '<disable_collisions link1="panda_link0" link2="panda_link1"/>'
    strict = ArmPlanner(planner.instance, srdf=f"<robot name='panda'>{other}</robot>")
    met = strict._get_collisions(0.0).list_collisions(state.x, state.y, 0.0, home)
    assert "panda_link5 meets panda_link7" in met and not strict.is_free(state, home)
    allowed = "".join('<disable_collisions link1="{}" link2="{}"/>'.format(*pair.split(" meets ")) for pair in met)
    assert ArmPlanner(planner.instance, srdf=f"<robot name='panda'>{allowed}</robot>").is_free(state, home)
    assert ArmPlanner(planner.instance, srdf="<robot name='panda'/>").is_free(state, home), "it has no such matrix"


GRIPPER = """
<robot name="so"><link name="foot"/>
  <link name="gripper"><visual><origin xyz="0.4 0 0"/><geometry><box size="0.8 0.1 0.1"/></geometry></visual></link>
  <joint name="gripper" type="revolute"><parent link="foot"/><child link="gripper"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>"""


def test_a_joint_may_be_named_as_its_link():
    """As in the URDF of the SO-100."""
    robot = RobotConfig(kind="urdf", urdf=GRIPPER, joints=1, hand_link="gripper", body_radius=0.4, body_height=0.5)
    planner = ArmPlanner(generate(RoomConfig(robot=robot), 0))
    state = planner.rules.make_state(planner.instance.starts[0])
    assert planner.kinematics.compute_placement((0.5,))[:2, 0] == pytest.approx([math.cos(0.5), math.sin(0.5)])
    assert planner.plan(state, (0.5,)).points[-1] == pytest.approx(0.5)


@pytest.mark.nightly_for("400-0.0", "400-0.05")
@pytest.mark.parametrize(("solids", "margin"), [(FEW_SOLIDS, 0.0), (400, 0.0), (400, 0.05)])
def test_among_many_solids_the_near_ones_are_tested_and_the_answer_is_that_of_all(solids, margin):
    """Against a list of what meets, which always looks at all; tiles that were dropped are made anew."""
    rng = np.random.default_rng(1)
    placed = [Solid("box", *rng.uniform(-6, 6, 2), *rng.uniform(0.02, 0.3, 2), height=rng.uniform(0.1, 2.0),
                    yaw=rng.uniform(0, 3)) for _ in range(solids)]
    robot = make_robot(RobotConfig(kind="arm", joints=3))
    tests = ArmCollisions(robot, 0.05, placed, margin)
    free, most = [], np.array([6.0, 6.0, 3.0, *(high for _, high in robot.limits)])
    for _ in range(150):
        x, y, heading, *angles = most * rng.uniform(-1, 1, len(most))
        free.append(tests.is_free(x, y, heading, angles))
        assert free[-1] == (not tests.list_collisions(x, y, heading, angles))
    assert 0.05 < np.mean(free) < 0.95
    assert bool(tests._near) == (solids > FEW_SOLIDS)


# --- clearance of every pair -----------------------------------------------------------------------

FINGERS = """<link name="f1"><collision><geometry><box size="0.02 0.02 0.02"/></geometry></collision></link>
<joint name="g1" type="{0}"><parent link="boom"/><child link="f1"/><origin xyz="0.62 0 0"/><axis xyz="0 0 1"/>
  <limit lower="0" upper="0.1" effort="1" velocity="1"/></joint>
<link name="f2"/><joint name="g2" type="{0}"><parent link="f1"/><child link="f2"/><origin xyz="0.02 0 0"/>
  <axis xyz="0 0 1"/><limit lower="0" upper="0.1" effort="1" velocity="1"/></joint>
<link name="f3"><collision><geometry><box size="0.02 0.02 0.02"/></geometry></collision></link>
<joint name="g3" type="{0}"><parent link="f2"/><child link="f3"/><origin xyz="{1} 0 0"/><axis xyz="0 0 1"/>
  <limit lower="0" upper="0.1" effort="1" velocity="1"/></joint>"""


@pytest.mark.parametrize("kind", ["revolute", "fixed"])
@pytest.mark.parametrize("gap", [-0.01, 0.0005, 0.005])
def test_links_that_no_planned_joint_moves_against_each_other_do_not_block_plans(kind, gap):
    """Nor do they with an SRDF that leaves their pair out."""
    planner, state = place_arm(make_arm(rest=FINGERS.format(kind, gap)))
    srdf = '<robot name="r"><disable_collisions link1="foot" link2="boom"/></robot>'
    for each in (planner, ArmPlanner(planner.instance, srdf=srdf)):
        assert each.is_free(state, [0.0]) and each.is_free(state, [0.9])
        path = each.plan(state, [0.9])
        assert len(path.points) == 2 and path.points[-1] == pytest.approx([0.9])


def test_a_start_or_goal_nearer_than_a_millimetre_is_refused_with_the_pair():
    """The boom ends half a millimetre before a box."""
    planner, state = place_arm(make_arm(), [Solid("box", 0.7005, 0.0, 0.1, 0.1, height=1.5)])
    assert planner.is_free(state, [0.0]) and not planner.is_free(state, [0.0], margin=0.001)
    aside = place_at(state, planner, [0.9])
    for begin, goal, reason in ((state, 0.9, PlanningReason.START_INVALID), (aside, 0.0, PlanningReason.GOAL_INVALID)):
        with pytest.raises(PlanningFailed) as failed:
            planner.plan(begin, [goal])
        assert failed.value.reason is reason
        assert failed.value.nearest == "nearer than 1 mm: boom to obstacle at (0.7005, 0)"
        assert failed.value.nearest in str(failed.value)


def place_at(state, planner, angles):
    """The state with the arm at angles, rad."""
    steps, offsets = planner.rules.split_angles(angles)
    return state._replace(joint_steps=steps, joint_offsets=offsets)


def measure_along(planner, state, path, step=0.002):
    """Least distance to a solid or between links by Bullet: at the start, at the end and along the path, m."""
    check = BulletCheck(planner)
    away = []
    for angles in path.interpolate(step).tolist():
        check.place(state.x, state.y, planner.rules.get_heading(state), angles)
        away.append(check.compute_clearance())
    check.close()
    return away[0], away[-1], min(away)


THREE_JOINTS = """<link name="fore"><collision><origin xyz="0.2 0 0"/><geometry><box size="0.3 0.04 0.04"/></geometry>
</collision></link><joint name="elbow" type="revolute"><parent link="boom"/><child link="fore"/>
<origin xyz="0.6 0 0"/><axis xyz="0 0 1"/><limit lower="-2.5" upper="2.5" effort="10" velocity="1"/></joint>
<link name="tip"><collision><origin xyz="0.1 0 0"/><geometry><box size="0.1 0.03 0.03"/></geometry></collision></link>
<joint name="wrist" type="revolute"><parent link="fore"/><child link="tip"/><origin xyz="0.38 0 0"/><axis xyz="0 1 0"/>
<limit lower="-1.5" upper="1.5" effort="10" velocity="1"/></joint>"""


@pytest.mark.nightly
def test_a_path_keeps_half_its_clearance_by_bullet():
    """From solids and the floor; where start or goal is nearer, half that distance counts."""
    urdf = make_arm(rest=THREE_JOINTS, limit='<limit lower="-3" upper="3" effort="10" velocity="1"/>')
    posts = [Solid("cylinder", 0.75 * math.cos(angle), 0.75 * math.sin(angle), 0.04, 0.04, height=height)
             for angle, height in ((0.5, 1.2), (-0.6, 0.9), (1.6, 2.0))]
    planner, state = place_arm(urdf, posts, hand="tip", joints=3)
    rng, (low, high) = np.random.default_rng(3), np.array(planner.rules.robot.limits).T
    bent, near, least = 0, 0, []
    free = (each for each in rng.uniform(low, high, (2000, 3)) if planner.is_free(state, each.tolist(), 0.0015))
    for number in range(8):
        begin, goal = next(free), next(free)
        try:
            path = planner.plan(place_at(state, planner, begin.tolist()), goal, seed=number)
        except PlanningFailed as failed:
            assert failed.reason is PlanningReason.BUDGET_EXHAUSTED
            continue
        first, last, along = measure_along(planner, state, path)
        documented = min(CLEARANCE, 0.5 * first, 0.5 * last) / 2
        assert along >= documented - 1e-5
        bent, near = bent + (len(path.points) > 2), near + (min(first, last) < CLEARANCE)
        least.append(along)
    assert len(least) >= 6 and bent >= 3 and near >= 1 and min(least) < 2 * CLEARANCE


def test_a_posture_is_tested_with_all_postures_around_it():
    """Two opposite corners of a box of postures are the farthest from its middle."""
    urdf = make_arm(rest=THREE_JOINTS, limit='<limit lower="-3" upper="3" effort="10" velocity="1"/>')
    posts = [Solid("cylinder", 0.8 * math.cos(angle), 0.8 * math.sin(angle), 0.04, 0.04, height=1.5)
             for angle in (0.5, -0.6, 1.6)]
    planner, _ = place_arm(urdf, posts, hand="tip", joints=3)
    rng, tests = np.random.default_rng(4), planner._get_collisions(CLEARANCE)
    kept, nearest = 0, math.inf
    for angles in rng.uniform(-2.5, 2.5, (150, 3)):
        change = np.concatenate([np.zeros(3), rng.uniform(0.0, 0.2, 3)])
        if tests.keeps(0.5, 0.0, 0.0, 0.0, angles, change):
            corners = angles + np.array(list(itertools.product((-1, 1), repeat=3))) * change[3:]
            around = [min(tests.measure_near(0.0, 0.0, 0.0, at, 0.2).values(), default=0.2) for at in corners]
            kept, nearest = kept + 1, min(nearest, *around)
    assert kept >= 20 and CLEARANCE / 2 - 1e-6 <= nearest < 3 * CLEARANCE


def test_a_failed_plan_names_what_is_on_the_straight_line():
    planner, state = place_arm(make_arm(), [Solid("cylinder", 0.6, 0.0, 0.03, 0.03, height=2.0)])
    with pytest.raises(PlanningFailed) as failed:
        planner.plan(place_at(state, planner, [-0.8]), [0.8], budget=500)
    assert failed.value.nearest == "the straight line, on which boom meets obstacle at (0.6, 0), number 4"


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (1.0, 0.3, 0.0)])
@pytest.mark.parametrize("along", [0.66, 1.3, 1.7])
def test_a_joint_that_slides_does_not_pass_through_a_thin_post(axis, along):
    """Pinocchio has models of their own for slides along an axis of the frame."""
    text = make_arm('<box size="0.02 0.02 0.02"/>', kind="prismatic", place='xyz="0 0 0"',
                    limit='<limit lower="0" upper="2" effort="1" velocity="1"/>')
    text = text.replace('<axis xyz="0 0 1"/>', '<axis xyz="{} {} {}"/>'.format(*axis))
    x, y, _ = along * np.array(axis) / np.linalg.norm(axis)
    planner, state = place_arm(text, [Solid("box", x, y, 0.005, 0.005, height=2.0)])
    with pytest.raises(PlanningFailed) as failed:
        planner.plan(state, [2.0], budget=1_000)
    assert failed.value.reason is PlanningReason.BUDGET_EXHAUSTED
    assert planner.plan(state, [along - 0.1]).points[-1] == pytest.approx([along - 0.1])


# --- continuous joints -----------------------------------------------------------------------------

TURNING = make_arm(kind="continuous", limit='<limit effort="10" velocity="1"/>')


def test_a_continuous_joint_takes_the_short_way_round():
    planner, state = place_arm(TURNING, angles=[math.radians(170)])
    for goal in (-170, 190, 550, 910, -1250):
        path = planner.plan(state, [math.radians(goal)])
        assert np.degrees(path.points[:, 0]) == pytest.approx([170, 190])
    times, positions, _ = make_trajectory(path).sample(100)
    assert np.degrees(positions[:, 0]).max() == pytest.approx(190) and np.degrees(positions[:, 0]).min() > 169.9
    limited, state = place_arm(make_arm(limit='<limit lower="-3.1" upper="3.1" effort="10" velocity="1"/>'),
                               angles=[math.radians(170)])
    assert np.degrees(limited.plan(state, [math.radians(-170)]).points[:, 0]) == pytest.approx([170, -170])


def test_a_continuous_joint_goes_the_other_way_round_an_obstacle():
    planner, state = place_arm(TURNING, [Solid("box", -0.5, 0.0, 0.05, 0.03, height=1.5)], angles=[math.radians(160)])
    path = planner.plan(state, [math.radians(-160)])
    swept = np.degrees(path.points[:, 0])
    assert swept[0] == pytest.approx(160) and swept[-1] == pytest.approx(-160)
    first, last, along = measure_along(planner, state, path)
    assert along >= min(CLEARANCE, 0.5 * first, 0.5 * last) / 2 - 1e-5
    both = [Solid("box", side * 0.5, 0.0, 0.05, 0.03, height=1.5) for side in (-1, 1)]
    planner, state = place_arm(TURNING, both, angles=[math.radians(90)])
    with pytest.raises(PlanningFailed):
        planner.plan(state, [math.radians(-90)], budget=2_000)


def test_inverse_kinematics_of_a_continuous_joint_finds_one_posture_whatever_turn_it_begins_in():
    tip = """<link name="tip"/><joint name="wrist" type="fixed"><parent link="boom"/><child link="tip"/>
    <origin xyz="0.6 0 0"/></joint>"""
    urdf = make_arm(kind="continuous", limit="", rest=tip)
    for begin in (-3.0, 0.0, 3.1):
        planner, state = place_arm(urdf, hand="tip", angles=[begin])
        for wanted in (3.0, -3.0, math.pi):
            target = (0.6 * math.cos(wanted), 0.6 * math.sin(wanted), 0.7)
            found = planner.solve_ik(target, state)
            assert len(found) == 1 and found[0].margin == math.pi
            assert math.remainder(found[0].angles[0] - wanted, math.tau) == pytest.approx(0.0, abs=1e-3)
            assert abs(planner.plan(state, found[0].angles).points[-1, 0] - begin) <= math.pi + 1e-6
