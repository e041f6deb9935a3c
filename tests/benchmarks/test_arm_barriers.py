"""Proofs that motions do not exist."""

from __future__ import annotations

import numpy as np

from benchmarks import arm_barriers
from hrl_escape.planning import Arm, Obstacle

LIMIT = '<limit lower="-2" upper="2" effort="9" velocity="1"/>'
BOX = '<collision><origin xyz="0.25 0 0"/><geometry><box size="0.5 0.1 0.1"/></geometry></collision>'
ARM = (f'<robot name="r"><link name="foot"/><link name="upper">{BOX}</link><link name="lower">{BOX}</link>'
       '<joint name="turn" type="revolute"><parent link="foot"/><child link="upper"/><axis xyz="0 0 1"/>'
       f'<origin xyz="0 0 0.5"/>{LIMIT}</joint>'
       '<joint name="bend" type="revolute"><parent link="upper"/><child link="lower"/><axis xyz="0 0 1"/>'
       f'<origin xyz="0.55 0 0"/>{LIMIT}</joint></robot>')


def test_a_post_separates_postures_where_no_angle_of_the_other_joint_passes_it(monkeypatch):
    """A post within the upper link's reach does so; one that only the lower link reaches is passed with it bent."""
    monkeypatch.setattr(arm_barriers, "SAMPLES", 0)  # the proof alone
    posts = [Obstacle.cylinder("post", 0.06, 2.0, (x, 0.0, 0.0)) for x in (0.3, 0.95)]
    near, far = (arm_barriers.label_cells(Arm.from_urdf(ARM, hand="lower", obstacles=[post]), 0.5) for post in posts)
    assert near[0, 4] == near[2, 4] != near[5, 4] == near[7, 4]  # turned by -2, -1, 0.5 and 1.5 rad
    assert far[0, 4] == far[7, 4]


def test_a_box_is_blocked_only_if_all_its_postures_are(monkeypatch):
    """At the middle of both boxes the post is in the upper link; at the ends of the wide one, the link is clear."""
    monkeypatch.setattr(arm_barriers, "SAMPLES", 0)
    arm = Arm.from_urdf(ARM, hand="lower", obstacles=[Obstacle.cylinder("post", 0.06, 2.0, (0.3, 0.0, 0.0))])
    for turn, expected in ((0.05, True), (1.5, False)):
        assert arm_barriers.is_blocked(arm, np.array([-turn, -2.0]), np.array([turn, 2.0])) == expected
