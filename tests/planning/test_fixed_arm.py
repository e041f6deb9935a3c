"""Arms without a room: obstacles at any placement, joints anywhere in the tree, objects that are carried."""

from __future__ import annotations

import itertools
import math
import time
from pathlib import Path

import numpy as np
import pybullet_data
import pytest

from benchmarks.arm_tasks import (
    HULL_MARGIN,
    TASKS,
    ArmCheck,
    check_task,
    list_published,
    make_continuous,
    make_dual_panda,
    plan_motions,
    write_shelf,
)
from benchmarks.published_arms import find_robots
from hrl_escape.errors import ConfigError, PlanningFailed, RobotError, UnknownNameError, UnsupportedError
from hrl_escape.planning import Arm, Obstacle

LIMIT = '<limit lower="-2" upper="2" effort="50" velocity="1"/>'


def make_link(name: str, length: float) -> str:
    return (f'<link name="{name}"><collision><origin xyz="{length / 2} 0 0"/><geometry>'
            f'<box size="{length - 0.06} 0.04 0.04"/></geometry></collision></link>')


def make_joint(name: str, kind: str, parent: str, child: str, at: str, axis: str = "0 0 1") -> str:
    return (f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{at}"/><axis xyz="{axis}"/>{LIMIT}</joint>')


TREE = ('<robot name="tree"><link name="foot"/><link name="column"/>'
        + make_joint("lift", "prismatic", "foot", "column", "0 0 0.5")
        + "".join(make_link(f"{side}-upper", 0.5) + make_link(f"{side}-lower", 0.4) + f'<link name="{side}-tip"/>'
                  + make_joint(f"{side}-shoulder", "revolute", "column", f"{side}-upper", f"0.05 {y} 0")
                  + make_joint(f"{side}-elbow", "revolute", f"{side}-upper", f"{side}-lower", "0.5 0 0")
                  + f'<joint name="{side}-end" type="fixed"><parent link="{side}-lower"/><child link="{side}-tip"/>'
                    '<origin xyz="0.4 0 0"/></joint>' for side, y in (("left", 0.3), ("right", -0.3)))
        + "</robot>")
"""Two planar arms of two joints on a column that lifts them."""
GROUPS = """<robot name="tree"><group name="left"><chain base_link="column" tip_link="left-tip"/></group>
<group name="body"><joint name="lift"/><group name="left"/></group>
<group_state name="out" group="left"><joint name="left-elbow" value="1"/></group_state></robot>"""


def test_a_group_may_be_in_another_in_another_and_so_on_or_in_itself():
    chain = "".join(f'<group name="g{number}"><group name="g{number + 1}"/></group>' for number in range(2000))
    srdf = f"""<robot name="tree">{chain}<group name="g2000"><joint name="left-elbow"/><group name="g0"/>
        <joint name="lift"/></group></robot>"""
    assert Arm.from_urdf(TREE, srdf=srdf, group="g0").joint_names == ("left-elbow", "lift")


def test_an_arm_without_collision_shapes_moves_straight():
    arm = Arm.from_urdf('<robot name="bare"><link name="foot"/><link name="boom"/>'
                        + make_joint("turn", "revolute", "foot", "boom", "0 0 0") + "</robot>")
    path = arm.plan(arm.home, [1.5])
    assert len(path.points) == 2 and path.points[-1].tolist() == [1.5]


def test_the_hand_is_where_geometry_says_from_a_base_at_any_placement():
    turn, (shoulder, elbow), lift = 0.7, (0.3, -0.8), 0.25
    arm = Arm.from_urdf(TREE, hand="left-tip", home={"lift": lift}, base_pose=(1.0, 2.0, 3.0, 0.0, 0.0, turn),
                        joints=("left-shoulder", "left-elbow"))
    x = 0.05 + 0.5 * math.cos(shoulder) + 0.4 * math.cos(shoulder + elbow)
    y = 0.3 + 0.5 * math.sin(shoulder) + 0.4 * math.sin(shoulder + elbow)
    expected = (1.0 + x * math.cos(turn) - y * math.sin(turn), 2.0 + x * math.sin(turn) + y * math.cos(turn), 3.75)
    at = arm.compute_placement((shoulder, elbow))
    assert at[:3, 3] == pytest.approx(expected) and math.atan2(at[1, 0], at[0, 0]) == pytest.approx(turn - 0.5)
    fallen = Arm.from_urdf(TREE, hand="left-tip", base_pose=(0.0, 0.0, 0.0, 0.0, math.pi / 2, 0.0))
    assert fallen.compute_placement("home")[:3, 3] == pytest.approx((0.5, 0.3, -0.95))
    postures = arm.solve_ik(at[:3, 3], seeds=16)
    assert len(postures) == 2, "the elbow is on either side"
    assert min(np.abs(posture.angles - (shoulder, elbow)).max() for posture in postures) < 1e-3


def test_bodies_within_a_micrometre_meet():
    """Without any margin, coal misses some penetrations."""
    for gap, expected in ((5e-7, False), (2e-6, True)):
        shelf = Obstacle.box("shelf", (0.3, 0.3, 0.1), (0.75, 0.3, 0.57 + gap))  # the lower link is 0.04 m high
        arm = Arm.from_urdf(TREE, hand="left-tip", joints=("left-shoulder", "left-elbow"), obstacles=[shelf])
        assert arm.is_free((0.0, 0.0)) == expected, gap


def test_joints_are_chosen_anywhere_in_the_tree_and_others_are_locked():
    arm = Arm.from_urdf(TREE, srdf=GROUPS, group="body")
    assert arm.joint_names == ("lift", "left-shoulder", "left-elbow") and arm.robot.hand_link == "left-tip"
    assert arm.postures["out"] == (0.0, 0.0, 1.0)
    both = Arm.from_urdf(TREE, hand="left-tip", joints=("right-elbow", "left-shoulder", "left-elbow"))
    start = (1.5, 0.1, 0.2)
    reached = both.solve_ik((0.6, 0.7, 0.5), start, seeds=4)
    assert reached and all(posture.angles[0] == 1.5 for posture in reached), "the right elbow does not move this hand"
    right = both.solve_ik(both.compute_placement((0.4, 0.0, 0.0), "right-tip")[:3, 3], start, hand="right-tip")
    assert right[0].angles == pytest.approx((0.4, 0.1, 0.2), abs=1e-3)
    with pytest.raises(UnsupportedError, match="no planned joint moves 'column'"):
        both.solve_ik((0, 0, 0), hand="column")


@pytest.mark.parametrize(("options", "error", "text"), [
    ({"joints": ("elbow",)}, RobotError, "no independent moving joint 'elbow'"),
    ({"hand": "nose"}, RobotError, "no link 'nose'"),
    ({"home": {"lift": 9.0}}, RobotError, "'lift' must be from -2 to 2, got 9.0"),
    ({"group": "legs", "srdf": GROUPS}, ConfigError, "a group of the SRDF: left, body"),
    ({"group": "left"}, ConfigError, "Give srdf="),
    ({"base_pose": (0.0, math.nan, 0.0)}, ConfigError, "base_pose"),
    ({"obstacles": [Obstacle.sphere("left-tip", 0.1)]}, ConfigError, "no other obstacle and no link has"),
])
def test_wrong_descriptions_are_refused_by_name(options, error, text):
    with pytest.raises(error, match=text):
        Arm.from_urdf(TREE, **options)


def test_wrong_obstacles_and_postures_are_refused_by_name():
    arm = Arm.from_urdf(TREE, hand="left-tip")
    for make in (lambda: Obstacle.box("b", (1, 0, 1)), lambda: Obstacle.sphere("b", math.inf),
                 lambda: Obstacle.box("b", (1, 1, 1), np.zeros((4, 4))), lambda: Obstacle.cylinder("", 1, 1),
                 lambda: arm.is_free((0, 0, 3)), lambda: arm.plan("home", [])):
        with pytest.raises(ConfigError):
            make()
    for call in (lambda: arm.remove("b"), lambda: arm.detach("b", "home"), lambda: arm.plan("home", "tucked"),
                 lambda: arm.compute_placement("home", "nose"),
                 lambda: arm.add(Obstacle.sphere("b", 1), may_touch=["nose"])):
        with pytest.raises(UnknownNameError):
            call()


# --- obstacles ------------------------------------------------------------------------------------

TURNED = (0.75, 0.42, 0.5, 0.4, -0.6, 1.1)


def make_obstacle(shape: str, folder: Path) -> Obstacle:
    if shape == "mesh":
        return Obstacle.mesh("thing", write_shelf(folder / "shelf.obj"), (0.75, 0.5, 0.3, 0.0, 0.0, 0.4), scale=0.6)
    return {"box": Obstacle.box("thing", (0.2, 0.1, 0.3), TURNED), "sphere": Obstacle.sphere("thing", 0.1, TURNED),
            "cylinder": Obstacle.cylinder("thing", 0.07, 0.3, TURNED)}[shape]


@pytest.mark.parametrize("shape", ["box", "sphere", "cylinder", "mesh"])
def test_clearances_are_those_of_bullet_for_every_shape_at_any_placement(shape, tmp_path):
    arm = Arm.from_urdf(TREE, hand="left-tip", joints=("left-shoulder", "left-elbow"), floor=0.3,
                        obstacles=[make_obstacle(shape, tmp_path)])
    check, met = ArmCheck(arm), 0
    for angles in np.random.default_rng(0).uniform((-0.4, -0.5), 1.0, (60, 2)):  # clear of the other arm
        check.place(angles)
        away = check.measure_obstacles()
        met += away < 0.0
        for margin in (0.0, 0.03):
            if abs(away - margin) > 2e-3:
                assert arm.is_free(angles, margin) == (away > margin)
    check.close()
    assert 5 < met < 55
    assert any(text.endswith("meets thing") for text in arm.list_collisions(np.array([0.0, 0.0]))) or shape != "box"


def test_a_concave_mesh_is_open_where_its_hull_is_not(tmp_path):
    """The arm reaches between two boards of a shelf."""
    shelf = Obstacle.mesh("shelf", write_shelf(tmp_path / "shelf.obj"), (0.85, 0.3, -0.2))
    arm = Arm.from_urdf(TREE, hand="left-tip", joints=("left-shoulder", "left-elbow"), obstacles=[shelf])
    assert arm.is_free("home", 0.02)
    assert not arm.move("shelf", (0.85, 0.3, 0.04)).is_free("home"), "a board is in the way"
    assert arm.remove("shelf").is_free("home")


def test_a_motion_avoids_an_obstacle_above_the_floor_and_passes_below_it():
    """A beam at the height of the arm blocks its way; lifted, it does not."""
    beam = Obstacle.box("beam", (0.3, 0.05, 0.1), (0.75, 0.3, 0.5))
    arm = Arm.from_urdf(TREE, hand="left-tip", joints=("left-shoulder", "left-elbow"), obstacles=[beam])
    start, goal = (-0.5, 0.0), (0.5, 0.0)
    around, straight = arm.plan(start, goal), arm.move("beam", (0.75, 0.3, 0.7)).plan(start, goal)
    assert len(straight.points) == 2 and len(around.points) > 2 and "<robot" not in repr(around)
    check = ArmCheck(arm)
    assert check.measure_path(around)[0] >= 0.01 - 1e-3
    check.close()
    began = time.perf_counter()
    with pytest.raises(PlanningFailed, match="left-lower meets beam") as refused:
        arm.plan("home", goal)
    assert 0 < refused.value.seconds <= time.perf_counter() - began
    assert refused.value.start is None and str(refused.value).startswith("no plan for configuration: ")
    trajectory = arm.trajectory(around)
    times, positions, velocities = trajectory.sample(1000)
    assert np.abs(velocities).max() <= 1.0 + 1e-9 and positions[-1] == pytest.approx(goal)
    assert len(arm.trajectory(arm.plan(start, start)).times) == 1


def test_the_first_goal_in_sight_is_taken_nearest_first():
    arm = Arm.from_urdf(TREE, hand="left-tip", joints=("left-shoulder", "left-elbow"))
    path = arm.plan("home", [(1.5, 0.0), (-0.2, 0.1), (1.0, 1.0)])
    assert path.points == pytest.approx(np.array([(0.0, 0.0), (-0.2, 0.1)]))


def test_links_that_no_planned_joint_moves_may_stand_in_an_obstacle():
    block = Obstacle.box("block", (0.2, 0.2, 0.2), (0.3, -0.3, 0.5))  # around the right arm
    both = Arm.from_urdf(TREE, hand="left-tip", obstacles=[block])
    assert both.joint_names[0] == "lift" and not both.is_free("home")
    left = Arm.from_urdf(TREE, hand="left-tip", joints=("left-shoulder", "left-elbow"), obstacles=[block])
    assert left.is_free("home") and left.plan("home", (0.4, 0.3)).points[-1] == pytest.approx((0.4, 0.3))


def test_an_object_that_is_carried_moves_and_collides_with_the_arm_until_it_is_released():
    wall = Obstacle.box("wall", (0.05, 0.4, 0.4), (1.2, 0.3, 0.5))
    rod = Obstacle.cylinder("rod", 0.02, 0.3, (1.0, 0.3, 0.5, 0.0, 0.0, 0.3))
    arm = Arm.from_urdf(TREE, hand="left-tip", joints=("left-shoulder", "left-elbow"), obstacles=[wall, rod])
    bent = (0.6, -1.2)
    assert arm.list_collisions("home") == []
    held = arm.attach("rod", "home", mass=1.0)
    assert [each.obstacle.name for each in held.attached] == ["rod"] and [o.name for o in held.obstacles] == ["wall"]
    moved = held.compute_placement(bent) @ np.linalg.inv(held.compute_placement("home")) @ rod.placement
    assert held.compute_placement(bent, "rod") == pytest.approx(moved)
    near = held.move("wall", (1.04, 0.3, 0.7))
    assert near.list_collisions("home") == ["rod meets wall"] and not near.is_free("home")
    assert held.attach("wall", "home", may_touch=["rod"]).is_free("home")
    put = held.detach("rod", bent)
    assert put.obstacles[-1].placement == pytest.approx(moved) and not put.attached
    assert put.robot.urdf.count("rod") == 0
    with pytest.raises(UnknownNameError, match="'rod'"):
        held.attach("rod", "home")
    cup = arm.add(Obstacle.sphere("Ann's cup", 0.02, (1.0, 0.3, 0.5))).attach("Ann's cup", "home")
    assert "cup" in cup.robot.urdf and "cup" not in cup.detach("Ann's cup", bent).robot.urdf


def test_a_hull_on_disk_is_used_again_while_its_mesh_is_the_same(tmp_path, monkeypatch):
    from hrl_escape.planning.arm import shapes

    folder = tmp_path / "hulls"
    folder.mkdir()
    monkeypatch.setattr(shapes, "make_cache_folder", lambda name: folder)
    urdf = '<robot name="r"><link name="a"/><link name="b"><collision><geometry><mesh filename="{}"/></geometry>' \
           "</collision></link>" + make_joint("turn", "revolute", "a", "b", "0 0 0.5") + "</robot>"
    ball = Obstacle.sphere("ball", 0.05, (0.3, 0.5, 0.95))

    def is_free(text: str) -> bool:
        mesh = tmp_path / "mesh.obj"
        mesh.write_text(text)
        shapes._load_hull.cache_clear()
        return Arm.from_urdf(urdf.format(mesh), obstacles=[ball]).is_free("home")

    def make_cube(size: str) -> str:
        corners = (f"v {x} {y} {z}\n" for x, y, z in itertools.product(("0", size), repeat=3))
        return "".join(corners) + "f 1 2 3\nf 4 5 6\nf 6 7 8\n"

    assert not is_free(make_cube("1")) and len(list(folder.iterdir())) == 1
    cached = next(folder.iterdir())
    good = cached.read_bytes()
    cached.write_bytes(good[:32] + bytes(len(good) - 32))  # damaged: its digest is another
    assert not is_free(make_cube("1")) and cached.read_bytes() == good
    assert is_free(make_cube(".1")) and len(list(folder.iterdir())) == 2

    mesh = Path(pybullet_data.getDataPath()) / "franka_panda/meshes/collision/link6.obj"
    new, again = (shapes._load_hull.__wrapped__(str(mesh), (1.0, 1.0, 1.0), 0, 0) for _ in range(2))
    assert np.array_equal(new.points(), again.points()), "so that plans do not depend on what is on disk"


# --- whole tasks ----------------------------------------------------------------------------------


@pytest.mark.nightly
@pytest.mark.parametrize("name", list(TASKS))
def test_tasks_in_a_shelf_and_under_a_table_are_free_by_bullet(name, tmp_path):
    assert check_task(TASKS[name](tmp_path)) > 0.004


@pytest.mark.nightly
@pytest.mark.parametrize("make", [make_dual_panda, make_continuous])
def test_composed_arms_plan_among_obstacles_free_by_bullet_within_limits(make):
    found = plan_motions(make(), 6)
    assert found["found"] >= 0.8 and found["straight"] < 1.0
    assert found["clearance mm"] > 0.0 and found["own mm"] > -1000 * HULL_MARGIN and found["strain"] <= 1.0 + 1e-6


PUBLISHED = list_published(find_robots())


@pytest.mark.slow
@pytest.mark.skipif(not find_robots().is_dir(), reason="example-robot-data is not installed")
@pytest.mark.parametrize("name", list(PUBLISHED))
def test_published_robots_plan_among_obstacles_free_by_bullet_within_limits(name, tmp_path):
    found = plan_motions(PUBLISHED[name](), 4, tmp_path / "robot.png")
    assert found["found"] >= 0.5 and (tmp_path / "robot.png").stat().st_size > 1000
    assert found["clearance mm"] > 0.0 and found["own mm"] > -1000 * HULL_MARGIN and found["strain"] <= 1.0 + 1e-6
