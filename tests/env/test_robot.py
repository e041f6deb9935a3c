"""The robot's own kinematics against Pinocchio and Bullet, its joint lattice, and what a URDF may lack."""

from __future__ import annotations

import dataclasses
import itertools
import math
import os
from pathlib import Path

import numpy as np
import pinocchio
import pybullet
import pytest

from hrl_escape.env.config import RobotConfig
from hrl_escape.env.mesh_files import load_mesh
from hrl_escape.env.robot import BASE_LINK, Robot, make_robot, sample_hand_positions
from hrl_escape.env.urdf import LARGEST_MESHES, load_urdf
from hrl_escape.errors import ConfigError, FileReadError, RobotError
from tests.command_line import run_here
from tests.forks import run_fork

# every trap at once: turned and shifted fixed joints, an axis that is not of unit length, a continuous and a
# prismatic joint, a joint that no primitive moves, a branch beside the chain, limits that leave out zero
USER_URDF = """
<robot name="mine">
  <link name="base"/><link name="turned"/><link name="upper"/><link name="lower"/><link name="slide"/>
  <link name="wrist"/><link name="tool"/><link name="lamp"/>
  <joint name="foot" type="fixed"><parent link="base"/><child link="turned"/>
    <origin xyz="0.1 -0.2 0.3" rpy="0.4 -0.5 0.6"/></joint>
  <joint name="a" type="revolute"><parent link="turned"/><child link="upper"/>
    <origin xyz="0.05 0 0.1" rpy="0 0.3 0"/><axis xyz="1 2 2"/>
    <limit lower="-1" upper="2" effort="1" velocity="1"/></joint>
  <joint name="b" type="continuous"><parent link="upper"/><child link="lower"/>
    <origin xyz="0.4 0 0"/><axis xyz="0 -1 0"/></joint>
  <joint name="c" type="prismatic"><parent link="lower"/><child link="slide"/>
    <origin xyz="0.3 0.1 0" rpy="0.2 0 1.1"/><axis xyz="0 0 1"/>
    <limit lower="0.2" upper="0.6" effort="1" velocity="1"/></joint>
  <joint name="d" type="revolute"><parent link="slide"/><child link="wrist"/>
    <origin xyz="0.2 0 0"/><limit lower="0.5" upper="1.5" effort="1" velocity="1"/></joint>
  <joint name="e" type="fixed"><parent link="wrist"/><child link="tool"/><origin xyz="0 0.3 0.1"/></joint>
  <joint name="f" type="revolute"><parent link="upper"/><child link="lamp"/>
    <origin xyz="0 0 1"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>
"""

ROBOTS = {
    "1 joint": RobotConfig(joints=1, link_length=0.8),
    "3 joints": RobotConfig(joints=3, mount_forward=0.3),
    "6 joints": RobotConfig(joints=6, body_height=0.7),
    "7 joints": RobotConfig(joints=7, joint_limit_deg=170),
    "kuka-iiwa": RobotConfig(kind="kuka-iiwa", joints=7),
    "franka-panda": RobotConfig(kind="franka-panda", joints=7),
    "franka-panda, 3 of its joints": RobotConfig(kind="franka-panda", joints=3, mount_forward=-0.2),
    "user's": RobotConfig(kind="urdf", joints=4, urdf=USER_URDF, hand_link="tool"),
    "user's, 3 of its joints": RobotConfig(kind="urdf", joints=3, urdf=USER_URDF, hand_link="tool"),
}


def sample_angles(robot: Robot, count: int) -> np.ndarray:
    low, high = np.array(robot.limits).T
    return np.random.default_rng(5).uniform(low, high, size=(count, len(low)))


def move_joints(model: pinocchio.Model, data: pinocchio.Data, robot: Robot, angles: np.ndarray) -> None:
    q = pinocchio.neutral(model)
    for name, angle in robot.rest.items() | dict(zip(robot.joint_names, angles, strict=True)).items():
        joint = model.joints[model.getJointId(name)]
        q[joint.idx_q : joint.idx_q + joint.nq] = angle if joint.nq == 1 else (math.cos(angle), math.sin(angle))
    pinocchio.framesForwardKinematics(model, data, q)


def find_hands_by_pinocchio(robot: Robot, angles: np.ndarray) -> np.ndarray:
    model = pinocchio.buildModelFromXML(robot.urdf)
    data, frame = model.createData(), model.getFrameId(robot.hand_link)
    hands = []
    for row in angles:
        move_joints(model, data, robot, row)
        hands.append(data.oMf[frame].translation.copy())
    return np.array(hands)


def find_hands_by_bullet(robot: Robot, angles: np.ndarray, folder: Path) -> np.ndarray:
    file = folder / "robot.urdf"
    file.write_text(robot.urdf)
    client = pybullet.connect(pybullet.DIRECT)
    try:
        body = pybullet.loadURDF(str(file), useFixedBase=True, physicsClientId=client)
        infos = [pybullet.getJointInfo(body, i, physicsClientId=client)
                 for i in range(pybullet.getNumJoints(body, physicsClientId=client))]
        joints, links = ({info[k].decode(): info[0] for info in infos} for k in (1, 12))
        middle = pybullet.getBasePositionAndOrientation(body, physicsClientId=client)[0]
        offset = pybullet.getDynamicsInfo(body, -1, physicsClientId=client)[3]  # where its inertia sits in the link
        hands = []
        for row in angles:
            for name, angle in robot.rest.items() | dict(zip(robot.joint_names, row, strict=True)).items():
                pybullet.resetJointState(body, joints[name], angle, physicsClientId=client)
            state = pybullet.getLinkState(body, links[robot.hand_link], computeForwardKinematics=True,
                                          physicsClientId=client)
            hands.append(np.array(state[4]) - middle + offset)
    finally:
        pybullet.disconnect(client)
    return np.array(hands)


@pytest.mark.nightly_for("franka-panda", "franka-panda, 3 of its joints")
@pytest.mark.parametrize("name", ROBOTS)
def test_hand_is_where_pinocchio_and_bullet_have_it(name: str, tmp_path: Path):
    robot = make_robot(ROBOTS[name])
    angles = sample_angles(robot, 40)
    own = robot.compute_hand(angles)
    assert np.ptp(own, axis=0).max() > 0.1  # the hand does move
    np.testing.assert_allclose(own, find_hands_by_pinocchio(robot, angles), rtol=0, atol=1e-6)
    np.testing.assert_allclose(own, find_hands_by_bullet(robot, angles, tmp_path), rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ROBOTS)
def test_elbows_are_where_pinocchio_has_the_joints_and_end_with_the_hand(name: str):
    robot = make_robot(ROBOTS[name])
    model = pinocchio.buildModelFromXML(robot.urdf)
    data, moving = model.createData(), [i for i, joint in enumerate(robot.chain) if joint.kind != "fixed"]
    for angles in sample_angles(robot, 5):
        elbows = robot.compute_elbows(tuple(angles.tolist()))
        np.testing.assert_allclose(elbows[-1], robot.compute_hand(angles), rtol=0, atol=1e-9)
        move_joints(model, data, robot, angles)
        for i in moving:
            if robot.chain[i].kind != "prismatic":  # its own frame slides
                place = data.oMi[model.getJointId(robot.chain[i].name)].translation
                np.testing.assert_allclose(elbows[i], place, rtol=0, atol=1e-6)


def test_hand_of_one_configuration_is_that_of_many_at_once():
    robot = make_robot(ROBOTS["kuka-iiwa"])
    angles = sample_angles(robot, 20)
    alone = np.array([robot.compute_hand(row) for row in angles])
    np.testing.assert_allclose(robot.compute_hand(angles), alone, rtol=0, atol=1e-15)
    np.testing.assert_allclose(robot.compute_hand(angles.reshape(4, 5, -1)).reshape(20, 3), alone, rtol=0, atol=1e-15)


def test_generated_arm_at_home_stretches_ahead_of_its_mount():
    robot = make_robot(RobotConfig(joints=3, link_length=0.4, mount_forward=0.2, body_height=0.9))
    np.testing.assert_allclose(robot.compute_hand((0.0, 0.0, 0.0)), (1.4, 0.0, 0.9), atol=1e-15)
    # first joint: yaw to the left; second: pitch up (table of joints in the generated arm)
    np.testing.assert_allclose(robot.compute_hand((math.pi / 2, 0.0, 0.0)), (0.2, 1.2, 0.9), atol=1e-15)
    np.testing.assert_allclose(robot.compute_hand((0.0, math.pi / 2, 0.0)), (0.6, 0.0, 1.7), atol=1e-15)


def test_robot_without_an_arm_has_its_hand_at_the_base():
    robot = make_robot(RobotConfig())
    assert (robot.joint_names, robot.hand_link) == ((), BASE_LINK)
    np.testing.assert_array_equal(robot.compute_hand(()), np.zeros(3))
    np.testing.assert_array_equal(sample_hand_positions(robot, 10), np.zeros((1, 3)))


# --- the lattice of joint steps --------------------------------------------------------------


@pytest.mark.parametrize("name", ROBOTS)
def test_step_range_is_every_whole_step_within_the_limits(name: str):
    robot = make_robot(ROBOTS[name])
    ranges = zip(robot.step_low, robot.step_high, robot.home, robot.limits, strict=True)
    for least, most, home, (low, high) in ranges:
        inside = [n for n in range(-400, 401) if low - 1e-6 <= home + n * robot.step <= high + 1e-6]
        assert (least, most) == (inside[0], inside[-1]) and 0 in inside


def test_limit_a_whole_number_of_steps_away_can_be_reached():
    for limit in (30.0, 60.0, 70.0, 110.0):
        robot = make_robot(RobotConfig(joints=2, joint_limit_deg=limit))
        assert robot.step_high == (limit // 10,) * 2 and robot.step_low == (-(limit // 10),) * 2


def test_home_is_the_middle_of_limits_that_leave_out_zero():
    robot = make_robot(ROBOTS["user's"])
    assert robot.home == pytest.approx((0.0, 0.0, 0.4, 1.0))
    assert robot.rest == {"f": 0.0}


def test_hand_positions_of_a_small_lattice_are_all_of_them():
    robot = make_robot(RobotConfig(joints=2, joint_step_deg=20.0))
    steps = itertools.product(range(-3, 4), repeat=2)
    every = {tuple(np.round(robot.compute_hand(robot.compute_angles(q)), 12)) for q in steps}
    assert {tuple(row) for row in np.round(sample_hand_positions(robot, 49), 12)} == every
    assert sample_hand_positions(robot, 49).shape == (49, 3)
    assert sample_hand_positions(robot, 48).shape == (48, 3)


def test_sampled_hand_positions_lie_on_the_lattice_and_spread_over_it():
    robot = make_robot(RobotConfig(joints=3, joint_step_deg=20.0))
    every = {tuple(np.round(robot.compute_hand(robot.compute_angles(q)), 9) + 0.0)
             for q in itertools.product(range(-3, 4), repeat=3)}
    sampled = {tuple(row + 0.0) for row in np.round(sample_hand_positions(robot, 300), 9)}
    assert sampled <= every and len(sampled) > 150


@pytest.mark.nightly
def test_sampled_hand_positions_are_the_same_in_every_process():
    code = ("from hrl_escape.env.config import RobotConfig;"
            "from hrl_escape.env.robot import make_robot, sample_hand_positions;"
            "print(sample_hand_positions(make_robot(RobotConfig(joints=7)), 500).tobytes().hex())")
    assert run_here(code) == run_fork(code, check=True).stdout


# --- a user's URDF ---------------------------------------------------------------------------


def test_last_link_is_the_hand_unless_one_is_named():
    config = RobotConfig(kind="urdf", joints=2, urdf=USER_URDF)
    assert make_robot(config).hand_link == "lamp"
    assert make_robot(dataclasses.replace(config, hand_link="wrist")).hand_link == "wrist"


@pytest.mark.parametrize(("change", "message"), [
    ({"hand_link": "claw"}, "no link 'claw' in the URDF; valid are mobile-base, base, turned"),
    ({"joints": 5, "hand_link": "tool"}, "robot.joints = 5: only 4 independent joints move 'tool'"),
    ({"urdf": "not XML"}, "not XML"),
    ({"urdf": "<sdf/>"}, "not a URDF"),
    ({"urdf": USER_URDF.replace("</robot>", '<link name="x"/></robot>')}, "one root link, got ['base', 'x']"),
    ({"urdf": USER_URDF.replace('parent link="base"', 'parent link="y"')}, "no joints lead from the URDF's root link"),
    ({"urdf": USER_URDF.replace('"base"', f'"{BASE_LINK}"')}, "Rename it"),
    ({"urdf": USER_URDF.replace("1 2 2", "0 0 0")}, "joint 'a' of the URDF has the axis 0 0 0"),
    ({"urdf": USER_URDF.replace("1 2 2", "1 2")}, "`xyz` of <axis> must be 3 finite numbers, got '1 2'"),
    ({"urdf": USER_URDF.replace('lower="-1" upper="2"', 'lower="3" upper="2"')}, "lower limit 3 is above upper 2"),
    ({"urdf": USER_URDF.replace("continuous", "floating")}, "joint 'b' of the URDF is 'floating'; valid are fixed"),
])
def test_urdf_that_lacks_something_gives_one_clear_error(change: dict, message: str):
    config = RobotConfig(**{"kind": "urdf", "joints": 2, "urdf": USER_URDF} | change)
    with pytest.raises(RobotError) as error:
        make_robot(config)
    assert message in str(error.value)


def test_hand_link_of_a_generated_arm_is_checked_too():
    with pytest.raises(RobotError, match="no link 'claw'"):
        make_robot(RobotConfig(joints=2, hand_link="claw"))


def test_user_s_robot_without_a_urdf_is_no_room_configuration():
    with pytest.raises(ConfigError, match=r"robot\.urdf"):
        RobotConfig(kind="urdf", joints=2)


def test_circle_of_joints_is_refused():
    circle = """<robot name="o"><link name="a"/><link name="b"/><link name="c"/>
      <joint name="1" type="continuous"><parent link="b"/><child link="c"/></joint>
      <joint name="2" type="continuous"><parent link="c"/><child link="b"/></joint></robot>"""
    with pytest.raises(RobotError, match="no joints lead from the URDF's root link to 'c'"):
        make_robot(RobotConfig(kind="urdf", joints=1, urdf=circle))


def test_load_urdf_says_what_it_cannot_read(tmp_path: Path):
    with pytest.raises(RobotError, match=r"cannot read the URDF .*missing\.urdf"):
        load_urdf(tmp_path / "missing.urdf")
    (tmp_path / "broken.urdf").write_text("<robot>")
    with pytest.raises(RobotError, match=r"broken\.urdf is not XML"):
        load_urdf(tmp_path / "broken.urdf")


@pytest.mark.parametrize(("body", "words"), [
    ("<a>" * 5000 + "</a>" * 5000, "nested more than 100 levels deep"),
    ("<link/>" * 1001, "has 1,001 links; at most 1,000 are read"),
    ('<link name="a"/><link name="b"/><link name="a"/>', "has 2 links named 'a'"),
    ("<link>" + "<collision/>" * 1001 + "</link>", "has 1,001 collision shapes; at most 1,000 are read"),
    ('<link name="a"/><link name="b"/><joint name="j"><parent link="b"/><child link="b"/></joint>', "to 'b', because"),
    ('<link name="a"/><joint name="j"/><joint name="j"/>', "has 2 joints named 'j'"),
])
def test_a_urdf_that_libraries_cannot_take_is_refused(body: str, words: str, tmp_path: Path):
    text = f'<robot name="r">{body}</robot>'
    (tmp_path / "r.urdf").write_text(text)
    with pytest.raises(RobotError, match=words):
        load_urdf(tmp_path / "r.urdf")
    with pytest.raises(RobotError, match=words):
        make_robot(RobotConfig(kind="urdf", joints=1, urdf=text))


def test_load_urdf_finds_meshes_beside_it_and_in_the_package_above(tmp_path: Path):
    (tmp_path / "arm_description" / "meshes").mkdir(parents=True)
    mesh = tmp_path / "arm_description" / "meshes" / "link.stl"
    mesh.touch()
    (tmp_path / "arm_description" / "urdf").mkdir()
    file = tmp_path / "arm_description" / "urdf" / "arm.urdf"
    for name in ("package://arm_description/meshes/link.stl", "../meshes/link.stl", f"file://{mesh}"):
        file.write_text(f'<robot name="r"><link name="l"><collision><geometry><mesh filename="{name}"/></geometry>'
                        "</collision></link></robot>")
        found = load_urdf(file).split('filename="')[1].split('"')[0]
        assert Path(found).resolve() == mesh
    file.write_text(file.read_text().replace("link.stl", "gone.stl"))
    with pytest.raises(RobotError, match=r"gone\.stl"):
        load_urdf(file)


@pytest.mark.parametrize(("name", "content", "words"), [
    ("faces.stl", b"\0" * 80 + (3_000_000).to_bytes(4, "little"), "at most"),
    ("bomb.zip", b"PK", "must end in one of"),
    ("bomb.3mf", b"PK", "must end in one of"),
    ("folder.obj", None, "a folder"),
    ("pipe.dae", "pipe", "a device or a pipe"),
])
def test_absurd_meshes_are_refused_before_they_are_opened(tmp_path: Path, name: str, content, words: str):
    path = tmp_path / name
    if content is None:
        path.mkdir()
    elif content == "pipe":
        os.mkfifo(path)
    else:
        path.write_bytes(content)
        if name == "faces.stl":
            os.truncate(path, 84 + 50 * 3_000_000)  # three million faces; the file has holes
    with pytest.raises((FileReadError, RobotError), match=words) as caught:
        make_robot(RobotConfig(kind="urdf", urdf=MESH_ARM.format(meshes=make_collision(path)), joints=1))
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("name", ["9" * 5000, "package://" + "9" * 5000, "package://tool/" + "9" * 5000 + ".obj"])
def test_a_name_that_no_mesh_can_have_is_refused(tmp_path: Path, name: str):
    mesh = make_collision(Path("NAME")).replace("NAME", name)
    (tmp_path / "r.urdf").write_text(MESH_ARM.format(meshes=mesh))
    with pytest.raises(RobotError, match="gives link 'base' the collision mesh '.*9.*', which was not found"):
        load_urdf(tmp_path / "r.urdf")
    with pytest.raises(FileReadError, match="no such mesh"):
        load_mesh(name)


@pytest.mark.parametrize("space", [" ", "\n"])
def test_an_obj_of_too_many_words_is_refused_before_it_is_split(tmp_path: Path, space: str):
    (tmp_path / "m.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2{space * 8_000_000} 3\n")
    with pytest.raises(FileReadError, match="has some 8,000,016 words; at most 8,000,000 are read"):
        load_mesh(tmp_path / "m.obj")


def test_many_meshes_are_too_large_together(tmp_path: Path):
    paths = [tmp_path / f"{number}.stl" for number in range(3)]
    for path in paths:
        path.touch()
        os.truncate(path, LARGEST_MESHES // 2)
    with pytest.raises(FileReadError, match="together"):
        make_robot(RobotConfig(kind="urdf", urdf=MESH_ARM.format(meshes="".join(map(make_collision, paths))), joints=1))
    two = "".join(map(make_collision, paths[:2]))
    assert make_robot(RobotConfig(kind="urdf", urdf=MESH_ARM.format(meshes=two), joints=1)).joint_names == ("turn",)


MESH_ARM = """<robot name="r"><link name="base">{meshes}</link><link name="tip"/>
<joint name="turn" type="revolute"><parent link="base"/><child link="tip"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


def make_collision(path: Path) -> str:
    return f'<collision><geometry><mesh filename="{path}"/></geometry></collision>'
