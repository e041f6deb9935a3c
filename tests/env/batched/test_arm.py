"""The hand in tensors against the robot's own kinematics, for every arm there is."""

import numpy as np
import pytest
import torch

from hrl_escape.env.batched.poses import compute_hand
from hrl_escape.env.config import RobotConfig
from hrl_escape.env.robot import make_robot

ARMS = [RobotConfig(joints=joints, link_length=0.4, mount_forward=0.2) for joints in range(8)]
ARMS += [RobotConfig(kind="kuka-iiwa", joints=7), RobotConfig(kind="franka-panda", joints=5)]
SLIDE = """<robot name="slide"><link name="foot"/><link name="tray"/><link name="tip"/>
<joint name="lift" type="prismatic"><parent link="foot"/><child link="tray"/><origin xyz="0.1 0 0.2" rpy="0.3 0 0"/>
<axis xyz="0 1 1"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint>
<joint name="spin" type="continuous"><parent link="tray"/><child link="tip"/><origin xyz="0 0.3 0" rpy="0 0.5 1"/>
<axis xyz="1 2 3"/></joint></robot>"""
ARMS += [RobotConfig(kind="urdf", urdf=SLIDE, joints=joints) for joints in (1, 2)]
FOLLOWING = SLIDE.replace('xyz="1 2 3"/>', 'xyz="1 2 3"/><mimic joint="lift" multiplier="-2" offset="0.3"/>')
ARMS.append(RobotConfig(kind="urdf", urdf=FOLLOWING, joints=1))


@pytest.mark.parametrize("config", ARMS, ids=lambda config: f"{config.kind}-{config.joints}")
def test_the_hand_is_where_the_robot_says(config):
    robot = make_robot(config)
    angles = np.random.default_rng(0).uniform(-1.5, 1.5, size=(100, config.joints))
    hand = compute_hand(robot, torch.from_numpy(angles.T.copy()))
    found = np.stack([np.broadcast_to(side, 100) for side in hand], axis=-1)
    assert np.abs(found - robot.compute_hand(angles)).max() < 1e-12
