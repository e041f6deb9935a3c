"""SRDF files as they are published: group states, several values, default collisions, and what is refused."""

from __future__ import annotations

import pytest

from hrl_escape.errors import ConfigError
from hrl_escape.planning.arm.arm_planner import ArmPlanner
from tests.planning.arm.robots import make_arm, place_arm

SECOND = """<link name="tip"><collision><geometry><sphere radius="0.02"/></geometry></collision></link>
<joint name="bend" type="revolute"><parent link="boom"/><child link="tip"/><origin xyz="0.7 0 0"/><axis xyz="0 1 0"/>
<limit lower="0.5" upper="1.5" effort="1" velocity="1"/></joint>"""
ARM = make_arm(rest=SECOND)


def read(body: str, urdf: str = ARM, hand: str = "tip", joints: int = 2) -> ArmPlanner:
    planner, _ = place_arm(urdf, hand=hand, joints=joints)
    return ArmPlanner(planner.instance, srdf=f'<robot name="r">{body}</robot>')


def write_state(name: str, group: str, **values: str) -> str:
    joints = "".join(f'<joint name="{joint}" value="{value}"/>' for joint, value in values.items())
    return f'<group_state name="{name}" group="{group}">{joints}</group_state>'


def test_joints_that_a_state_leaves_out_are_at_home():
    assert read(write_state("out", "arm", turn="0.7")).postures == {"out": (0.7, 1.0)}


def test_states_of_one_name_in_two_groups_are_two_postures():
    body = write_state("ready", "arm", turn="0.7") + write_state("ready", "wrist", bend="0.6")
    body += write_state("flat", "arm", turn="0")
    assert read(body).postures == {"arm/ready": (0.7, 1.0), "wrist/ready": (0.0, 0.6), "flat": (0.0, 1.0)}


def test_a_state_of_a_gripper_is_no_posture_of_the_arm():
    body = write_state("open", "hand", finger="0.04") + write_state("ready", "arm", turn="0.1")
    body += write_state("ready", "hand", finger="0.01")
    assert read(body).postures == {"ready": (0.1, 1.0)}


def test_a_root_joint_of_several_values_is_ignored():
    body = write_state("stand", "all", root_joint="0 0 1 0 0 0 1", turn="0.4")
    assert read(body).postures == {"stand": (0.4, 1.0)}


def test_rounded_angles_at_a_limit_are_brought_back_to_it():
    assert read(write_state("far", "arm", turn="1.0004", bend="0.4996")).postures == {"far": (1.0, 0.5)}


def test_a_continuous_joint_takes_any_angle():
    urdf = make_arm(kind="continuous", limit="")
    assert read(write_state("turned", "arm", turn="7.5"), urdf, "boom", 1).postures == {"turned": (7.5,)}


@pytest.mark.parametrize("value", ["1.7", "nan", "inf", "", "half", "0 0"])
def test_a_state_with_an_angle_that_the_joint_cannot_have_is_left_out(value: str):
    states = write_state("far", "arm", turn=value) + write_state("near", "arm", turn="0.5")
    with pytest.warns(RuntimeWarning, match=r"state 'far' is left out: the angle of joint 'turn' must be from -1 to 1"):
        assert list(read(states).postures) == ["near"]


def test_an_srdf_that_is_nested_too_deep_is_refused():
    with pytest.raises(ConfigError, match="nested more than 100 levels deep"):
        read("<a>" * 5000 + "</a>" * 5000)


def test_too_many_pairs_that_are_off_by_default_are_refused():
    rest = "".join(f'<link name="l{number}"/><joint name="f{number}" type="fixed"><parent link="foot"/>'
                   f'<child link="l{number}"/></joint>' for number in range(400))
    off = "".join(f'<disable_default_collisions link="l{number}"/>' for number in range(400))
    with pytest.raises(ConfigError, match="at most 100,000 pairs of links"):
        read(off, make_arm(rest=rest), "boom", 1)


THREE = """<link name="a"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
<joint name="ja" type="revolute"><parent link="foot"/><child link="a"/><origin xyz="0 0.5 0.3"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<link name="b"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
<joint name="jb" type="revolute"><parent link="foot"/><child link="b"/><origin xyz="0 -0.5 0.3"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>"""


def test_default_collisions_are_off_but_for_pairs_that_are_enabled():
    """The boom, which ends 0.6 m from its axis, meets a box on either side of it."""
    urdf = make_arm(rest=THREE, limit='<limit lower="-2" upper="2" effort="1" velocity="1"/>')
    never = '<disable_collisions link1="foot" link2="boom" reason="Adjacent"/>'
    free = {}
    for name, body in {"tested": never, "off": '<disable_default_collisions link="boom"/>',
                       "one on": '<disable_default_collisions link="boom"/>'
                                 '<enable_collisions link1="b" link2="boom"/>'}.items():
        planner = read(body, urdf, "boom", 1)
        state = planner.rules.make_state(planner.instance.starts[0])
        free[name] = [planner.is_free(state, [turn]) for turn in (0.0, 1.57, -1.57)]
    assert free == {"tested": [True, False, False], "off": [True, True, True], "one on": [True, True, False]}


@pytest.mark.parametrize(("text", "words"), [
    (ARM, "this is a URDF"), ("<srdf/>", "whose root is <robot>"), ("<robot", "its text or path"),
    ("none.srdf", "none.srdf"),
    ('<robot name="q"><disable_collisions link1="left" link2="right" reason="Never"/></robot>',
     "the SRDF of this robot: none of its links, such as 'left', is in the URDF"),
    ('<robot name="r" xmlns:xacro="http://wiki.ros.org/xacro"><xacro:include filename="a.xacro"/></robot>',
     "it contains <xacro:include>. Run `xacro FILE > robot.srdf`")])
def test_what_is_no_srdf_of_the_robot_is_refused(text: str, words: str):
    planner, _ = place_arm(ARM, hand="tip", joints=2)
    with pytest.raises(ConfigError) as error:
        ArmPlanner(planner.instance, srdf=text)
    assert error.value.field == "srdf" and words in str(error.value)


def test_an_srdf_file_is_read_in_its_encoding(tmp_path):
    body = write_state("zurück", "arm", turn="0.2")
    path = tmp_path / "arm.srdf"
    path.write_bytes(f'<?xml version="1.0" encoding="ISO-8859-1"?><robot name="r">{body}</robot>'.encode("latin-1"))
    planner, _ = place_arm(ARM, hand="tip", joints=2)
    assert ArmPlanner(planner.instance, srdf=path).postures == {"zurück": (0.2, 1.0)}
    assert ArmPlanner(planner.instance, srdf=f'\ufeff<robot name="r">{body}</robot>').postures
