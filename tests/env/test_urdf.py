"""URDF files as they are published: packages, encodings, shapes, limits and joints that follow others."""

# pyright: reportAttributeAccessIssue=false
# (Pinocchio is compiled and carries no types)

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio
import pybullet
import pytest

from benchmarks.conformance import compare
from hrl_escape.env.bullet.physics import PhysicsDynamics
from hrl_escape.env.config import DynamicsConfig, RoomConfig
from hrl_escape.env.geometry import Solid
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.robot import make_robot
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.urdf import load_urdf
from hrl_escape.errors import RobotError
from hrl_escape.planning.arm.model import ArmKinematics
from tests.planning.arm.robots import make_arm, make_config, place_arm

MESH = '<mesh filename="{}"/>'
CUBE = """v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"""


def read_mesh_name(text: str, part: str = "collision") -> str:
    mesh = ElementTree.fromstring(text).find(f"link/{part}/geometry/mesh")
    assert mesh is not None
    return mesh.get("filename", "")


def write(path: Path, text: str | bytes) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


# --- meshes of packages ----------------------------------------------------------------------


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    """A URDF that names a mesh of the package `arm_meshes`."""
    return write(tmp_path / "work" / "src" / "robot" / "urdf" / "arm.urdf", make_arm(MESH.format("package://arm_meshes/parts/a.obj")))


def make_package(folder: Path, name: str | None = None) -> Path:
    if name is not None:
        write(folder / "package.xml", f'<?xml version="1.0"?><package format="3"><name>{name}</name></package>')
    return write(folder / "parts" / "a.obj", CUBE).resolve()


@pytest.mark.parametrize(("folder", "name"), [
    ("robot/arm_meshes", None), ("arm_meshes", None), ("robot/other", "arm_meshes"), ("robot", "arm_meshes"),
    ("packages/checkout-2", "arm_meshes")])
def test_a_package_is_found_by_its_folder_or_its_package_xml_near_the_urdf(tmp_path: Path, arm: Path, folder, name):
    mesh = make_package(arm.parents[2] / folder, name)
    make_package(arm.parents[1] / "decoy", "another")
    assert Path(read_mesh_name(load_urdf(arm))).resolve() == mesh


def test_packages_are_given_by_name_or_as_folders_that_hold_them(tmp_path: Path, arm: Path):
    with pytest.raises(RobotError, match=r"link 'boom'.*package_paths=\{'arm_meshes': FOLDER\}"):
        load_urdf(arm)
    far = tmp_path / "a" / "b" / "c" / "d"
    one, two = make_package(far / "src" / "x", "arm_meshes"), make_package(far / "elsewhere")
    assert Path(read_mesh_name(load_urdf(arm, [far]))).resolve() == one
    assert Path(read_mesh_name(load_urdf(arm, {"arm_meshes": far / "elsewhere"}))).resolve() == two
    with pytest.raises(RobotError, match="not found"):
        load_urdf(arm, {"another": far / "elsewhere"})


@pytest.mark.parametrize(("variable", "folder", "name"), [
    ("ROS_PACKAGE_PATH", "src/x", "arm_meshes"), ("ROS_PACKAGE_PATH", "arm_meshes", None),
    ("AMENT_PREFIX_PATH", "share/arm_meshes", None)])
def test_packages_of_the_environment_of_ros_are_found(tmp_path: Path, arm: Path, monkeypatch, variable, folder, name):
    far = tmp_path / "a" / "b" / "c" / "d"
    mesh = make_package(far / folder, name)
    make_package(arm.parents[2] / "arm_meshes" / "copy", "arm_meshes")
    monkeypatch.setenv(variable, f"/nowhere:{far}")
    assert Path(read_mesh_name(load_urdf(arm))).resolve() == mesh


def test_a_given_package_goes_before_one_near_the_urdf(tmp_path: Path, arm: Path, monkeypatch):
    make_package(arm.parents[1], "arm_meshes")
    given = make_package(tmp_path / "given")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "nowhere"))
    assert Path(read_mesh_name(load_urdf(arm, {"arm_meshes": tmp_path / "given"}))).resolve() == given


# --- the text --------------------------------------------------------------------------------


@pytest.mark.parametrize(("content", "encoding"), [
    ('<?xml version="1.0" encoding="ISO-8859-1"?>', "latin-1"), ("\ufeff", "utf-8"),
    ('\ufeff<?xml version="1.0" encoding="utf-8"?>', "utf-8"),
    ('<?xml version="1.0" encoding="utf-16"?>', "utf-16")])
def test_the_declared_encoding_is_read(tmp_path: Path, content: str, encoding: str):
    path = write(tmp_path / "arm.urdf", (content + make_arm().replace("boom", "Ausleger-für-A")).encode(encoding))
    assert make_robot(make_config(load_urdf(path), "Ausleger-für-A")).hand_link == "Ausleger-für-A"


def test_text_with_a_byte_order_mark_is_a_robot():
    assert make_robot(make_config("\ufeff" + make_arm())).joint_names == ("turn",)


@pytest.mark.parametrize(("change", "words"), [
    (("<link name=\"foot\"/>", '<link name="foot"/><xacro:macro name="m" xmlns:xacro="http://wiki.ros.org/xacro"/>'),
     "<xacro:macro>"), (('name="turn"', 'name="${prefix}turn"'), r"\${prefix}turn"),
    (("0 0 0.3", "0 0 $(arg height)"), r"0 0 \$\(arg height\)")])
def test_xacro_is_refused_and_expansion_named(tmp_path: Path, change, words):
    text = make_arm().replace(*change)
    with pytest.raises(RobotError, match=rf"xacro file that was not expanded \({words}\).*xacro FILE > robot.urdf"):
        load_urdf(write(tmp_path / "arm.urdf", text))
    with pytest.raises(RobotError, match="xacro"):
        make_robot(make_config(text))


# --- shapes ----------------------------------------------------------------------------------


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["package://nothing/there.stl", "gone.obj", "rock.glb"])
def test_a_link_without_its_visual_mesh_is_drawn_by_its_collision_shape(tmp_path: Path, name: str):
    write(tmp_path / "rock.glb", "glTF")
    text = make_arm().replace("</collision>", f'</collision><visual><geometry>{MESH.format(name)}</geometry></visual>')
    robot = make_robot(make_config(load_urdf(write(tmp_path / "arm.urdf", text))))
    boom = next(link for link in ElementTree.fromstring(robot.urdf).iter("link") if link.get("name") == "boom")
    shown, solid = boom.find("visual"), boom.find("collision")
    assert shown is not None and solid is not None and len(boom.findall("visual")) == 1
    assert [ElementTree.tostring(each) for each in shown] == [ElementTree.tostring(each) for each in solid]
    text = text.replace("</visual>", '</visual><visual><geometry><sphere radius="0.1"/></geometry></visual>')
    boom = ElementTree.fromstring(make_robot(make_config(load_urdf(write(tmp_path / "arm.urdf", text)))).urdf)
    assert [shape[0].tag for shape in boom.iterfind("link[@name='boom']/visual/geometry")] == ["sphere"]


RADIUS, LENGTH, POSE = 0.08, 0.5, ((0.6, 0.1, 0.05), (0.3, 1.2, 0.5))
CAPSULE = make_arm(f'<capsule radius="{RADIUS}" length="{LENGTH}"/>',
                   place='xyz="{} {} {}" rpy="{} {} {}"'.format(*POSE[0], *POSE[1]))


def find_capsule_ends(turn: float) -> np.ndarray:
    """Ends of the capsule's axis in the frame of the arm's foot, (2, 3), m."""
    middle, rotation = np.array(POSE[0]) + (0.0, 0.0, 0.3), pinocchio.rpy.rpyToMatrix(*POSE[1])
    along = LENGTH / 2 * rotation[:, 2]
    return np.array([middle - along, middle + along]) @ pinocchio.rpy.rpyToMatrix(0.0, 0.0, turn).T


def measure_from_segment(ends: np.ndarray, point: np.ndarray) -> float:
    along = ends[1] - ends[0]
    share = np.clip((point - ends[0]) @ along / (along @ along), 0.0, 1.0)
    return float(np.linalg.norm(ends[0] + share * along - point))


def test_a_capsule_meets_what_a_segment_with_its_radius_meets():
    post = Solid("cylinder", 0.9, 0.2, 0.05, 0.05, height=3.0)
    planner, state = place_arm(CAPSULE, [post])
    rng, answers = np.random.default_rng(0), []
    for _ in range(300):
        turn, x, y = rng.uniform((-0.4, 0.0, -0.1), (0.4, 0.3, 0.2)).tolist()
        away = measure_from_segment(find_capsule_ends(turn)[:, :2], np.array([post.x - x, post.y - y])) - 0.05 - RADIUS
        if abs(away) > 1e-6:
            answers.append(away > 0.0)
            assert planner.is_free(state._replace(x=x, y=y), [turn]) == answers[-1]
    assert 0.2 < np.mean(answers) < 0.8


def test_bullet_loads_a_capsule_with_the_same_extents(tmp_path: Path):
    client = pybullet.connect(pybullet.DIRECT)
    try:
        file = write(tmp_path / "arm.urdf", make_robot(make_config(CAPSULE)).urdf)
        body = pybullet.loadURDF(str(file), flags=pybullet.URDF_USE_IMPLICIT_CYLINDER, physicsClientId=client)
        links = {pybullet.getJointInfo(body, j, physicsClientId=client)[12].decode(): j
                 for j in range(pybullet.getNumJoints(body, physicsClientId=client))}
        place, turned = pybullet.getLinkState(body, links["boom"], physicsClientId=client)[4:6]
        rotation = np.array(pybullet.getMatrixFromQuaternion(turned)).reshape(3, 3)
        ends = (find_capsule_ends(0.0) - (0.0, 0.0, 0.3)) @ rotation.T + place
        probe = pybullet.createMultiBody(0, pybullet.createCollisionShape(
            pybullet.GEOM_SPHERE, radius=0.01, physicsClientId=client), physicsClientId=client)
        rng = np.random.default_rng(1)
        for _ in range(100):
            at = rng.uniform(ends.min(axis=0) - 0.5, ends.max(axis=0) + 0.5)
            expected = measure_from_segment(ends, at) - RADIUS - 0.01
            if expected > 0.02:
                pybullet.resetBasePositionAndOrientation(probe, at.tolist(), (0, 0, 0, 1), physicsClientId=client)
                points = pybullet.getClosestPoints(body, probe, 5.0, links["boom"], physicsClientId=client)
                assert min(point[8] for point in points) == pytest.approx(expected, abs=1e-3)
    finally:
        pybullet.disconnect(client)


@pytest.mark.parametrize(("geometry", "words"), [
    ('<ellipsoid radii="1 1 1"/>', "is <ellipsoid>; valid are box, cylinder, sphere, capsule and mesh"),
    ("", "has 0 geometries"), ('<box size="1 1 1"/><sphere radius="1"/>', "has 2 geometries"),
    ('<cilinder radius="1" length="1"/>', "is <cilinder>"), ('<box size="0 1 1"/>', "size of <box> must be 3 numbers"),
    ('<cylinder radius="0.1"/>', "length of <cylinder> must be a number above 0, got None"),
    ('<sphere radius="-1"/>', "above 0, got '-1'"), ('<box size="1 1"/>', "got '1 1'"),
    ('<capsule radius="nan" length="1"/>', "radius of <capsule>"), ('<mesh filename="a.stl"/>', "is no file here"),
    ('<mesh filename="/nowhere/a.stl"/>', "no such mesh"),
    ('<mesh filename="/nowhere/a.stl" scale="1 0 1"/>', "the scale of a mesh")])
def test_a_collision_shape_that_cannot_be_read_is_refused_by_its_link(geometry: str, words: str):
    with pytest.raises(RobotError) as error:
        make_robot(make_config(make_arm(geometry)))
    assert words in str(error.value) and "collision shape of link 'boom'" in str(error.value)


# --- joints ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("limit", "words"), [
    ("", 'is revolute and has no <limit>. Add one, or make it type="continuous"'),
    ('<limit lower="-1e16" upper="1e16"/>', "`lower` of <limit> must be within"),
    ('<limit lower="-1" upper="inf"/>', "`upper` of <limit> must be a finite number, got 'inf'"),
    ('<limit lower="-1" upper="1" velocity="-1"/>', "limits of velocity and effort")])
def test_limits_that_are_none_are_refused_by_their_joint(limit: str, words: str):
    with pytest.raises(RobotError) as error:
        make_robot(make_config(make_arm(limit=limit)))
    assert words in str(error.value) and "joint 'turn'" in str(error.value)


def test_limits_without_effort_and_velocity_load_in_every_engine(tmp_path: Path):
    robot = make_robot(make_config(make_arm(limit='<limit lower="-1" upper="0.5"/>')))
    assert robot.limits == ((-1.0, 0.5),) and robot.speeds == (math.inf,)
    hand = robot.compute_hand((0.3,))
    assert ArmKinematics(robot).compute_placement((0.3,))[:3, 3] == pytest.approx(hand)


# --- joints that follow others ---------------------------------------------------------------

FOLLOWING = """<robot name="m"><link name="foot"/><link name="one"/><link name="two"/><link name="three"/>
<link name="four"/><link name="finger"><collision><geometry><box size="0.02 0.02 0.02"/></geometry></collision></link>
<joint name="a" type="revolute"><parent link="foot"/><child link="one"/><origin xyz="0 0 0.5"/><axis xyz="0 1 0"/>
  <limit lower="-1.5" upper="1.5" effort="50" velocity="2"/></joint>
<joint name="b" type="revolute"><parent link="one"/><child link="two"/><origin xyz="0.3 0 0" rpy="0.2 0 0"/>
  <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="50" velocity="2"/>
  <mimic joint="a" multiplier="-0.5" offset="0.2"/></joint>
<joint name="c" type="revolute"><parent link="two"/><child link="three"/><origin xyz="0.3 0 0"/><axis xyz="0 0 1"/>
  <limit lower="-1.5" upper="1.5" effort="50" velocity="2"/></joint>
<joint name="d" type="prismatic"><parent link="three"/><child link="four"/><origin xyz="0.1 0 0"/><axis xyz="1 0 0"/>
  <limit lower="-3" upper="3" effort="50" velocity="2"/><mimic joint="b" multiplier="0.1"/></joint>
<joint name="e" type="revolute"><parent link="four"/><child link="finger"/><origin xyz="0 0.1 0"/><axis xyz="0 0 1"/>
  <limit lower="-3" upper="3" effort="50" velocity="2"/><mimic joint="c"/></joint></robot>"""
FOLLOWER = make_config(FOLLOWING, "four", 2)


def follow(a: float, c: float) -> dict[str, float]:
    """Joint positions as the URDF has them, by hand."""
    return {"a": a, "b": 0.2 - 0.5 * a, "c": c, "d": 0.02 - 0.05 * a, "e": c}


def test_hand_and_jacobian_of_an_arm_with_mimic_joints_are_those_of_pinocchio():
    robot = make_robot(FOLLOWER)
    assert robot.joint_names == ("a", "c")
    model = pinocchio.buildModelFromXML(FOLLOWING)
    data, frame, kinematics = model.createData(), model.getFrameId("four"), ArmKinematics(robot)
    for angles in np.random.default_rng(0).uniform(-1.5, 1.5, (30, 2)).tolist():
        values, q = follow(*angles), pinocchio.neutral(model)
        for name, value in values.items():
            q[model.joints[model.getJointId(name)].idx_q] = value
        pinocchio.framesForwardKinematics(model, data, q)
        expected = data.oMf[frame].translation + (0.0, 0.0, 0.4)  # the arm is mounted on the base
        assert robot.compute_values(angles) == pytest.approx(values)
        assert robot.compute_hand(angles) == pytest.approx(expected, abs=1e-12)
        assert robot.compute_elbows(tuple(angles))[-1] == pytest.approx(expected, abs=1e-12)
        assert kinematics.compute_placement(angles)[:3, 3] == pytest.approx(expected, abs=1e-9)
        columns = [(kinematics.compute_placement((angles + h).tolist())[:3, 3]
                    - kinematics.compute_placement((angles - h).tolist())[:3, 3]) / 2e-6 for h in 1e-6 * np.eye(2)]
        assert kinematics.compute_jacobian(angles)[:3] == pytest.approx(np.array(columns).T, abs=1e-6)


def make_following_room(kind: str = "kinematic"):
    dynamics = DynamicsConfig(press_with="hand", kind=kind)  # type: ignore[arg-type]
    return generate(RoomConfig(robot=dataclasses.replace(FOLLOWER, body_radius=0.5), dynamics=dynamics), 0)


def test_joints_follow_in_physics():
    room = make_following_room("physics")
    rules = Kinematics(room, is_still=True)
    physics, state = PhysicsDynamics(rules), rules.make_state(room.starts[0])
    numbers = {pybullet.getJointInfo(physics.scene.robot, j, physicsClientId=physics.client)[1].decode(): j
               for j in range(pybullet.getNumJoints(physics.scene.robot, physicsClientId=physics.client))}
    turned = set()
    for _ in range(3):
        for joint in (0, 1):
            action = next(number for number, each in enumerate(rules.actions.primitives) if each.joint == joint)
            state = physics.step(state, action).state
            angles = rules.get_angles(state)
            turned.add(angles)
            for name, value in follow(*angles).items():
                found = pybullet.getJointState(physics.scene.robot, numbers[name], physicsClientId=physics.client)[0]
                assert found == pytest.approx(value, abs=5e-3), name
    assert len(turned) == 6 and max(map(abs, next(iter(turned)))) > 0.05


def test_the_batched_engine_moves_an_arm_with_mimic_joints_as_the_scalar_rules():
    found = compare([make_following_room()], 200, copies=10)
    assert found.primitives >= 200 and not found.disagreements and found.worst < 1e-9


@pytest.mark.parametrize(("change", "words"), [
    (('<mimic joint="a"', '<mimic joint="d"'), "mimics itself: its <mimic> elements form a circle"),
    (('<mimic joint="c"/>', '<mimic joint="e"/>'), "joint 'e' of the URDF mimics itself"),
    (('<mimic joint="a"', '<mimic joint="z"'), "mimics 'z', which is no moving joint of it"),
    (('multiplier="-0.5"', 'multiplier="half"'), "joint 'b' of the URDF: <mimic> must be a finite number, got 'half'")])
def test_mimic_joints_that_follow_none_are_refused(change, words: str):
    with pytest.raises(RobotError) as error:
        make_robot(make_config(FOLLOWING.replace(*change), "four", 2))
    assert words in str(error.value)


def test_a_joint_that_follows_one_at_rest_stands_where_that_puts_it():
    robot = make_robot(dataclasses.replace(FOLLOWER, joints=1))
    assert robot.rest == {"c": 0.0, "e": 0.0} and robot.joint_names == ("a",)
    assert robot.mimics["d"] == pytest.approx((0, -0.05, 0.02))
