"""Presses by hand along planned paths: joint steps near a path, and an arm among posts under real physics."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
import pytest

from hrl_escape.env.config import DynamicsConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.geometry import Solid
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import PlanningFailed
from hrl_escape.planning.arm import reacher
from hrl_escape.planning.arm.reacher import follow_path
from hrl_escape.planning.planner import RoomPlanner


def test_joint_steps_follow_a_path_round_what_blocks_the_straight_way():
    corner = np.concatenate([np.stack([np.zeros(33), np.linspace(0, 4, 33)], 1),
                             np.stack([np.linspace(0, 4, 33), np.full(33, 4.0)], 1)])

    def can_step(a, b):
        return b[0] == 0 or b[1] >= 4 or b == (4, 0)

    found = follow_path(corner, (0, 0), (4, 4), can_step)
    assert found == ((0, 1), (0, 2), (0, 3), (0, 4), (1, 4), (2, 4), (3, 4), (4, 4))
    assert follow_path(corner, (0, 0), (4, 4), lambda a, b: b != (0, 2) and can_step(a, b)) is None


def make_pen() -> RoomInstance:
    """A base that low walls hold, and an arm between two posts as high as its hand; it must go over one of them."""
    room = generate(get_preset("arm-two-button"), 1)
    x, y, side, away = 0.0, -4.6, 0.445, 1.05 * math.sqrt(0.5)
    walls = [Solid("box", x + dx * side, y + dy * side, half_x=0.04 if dx else 0.5, half_y=0.04 if dy else 0.5,
                   height=0.4) for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    posts = [Solid("box", x + away, y + dy * away, half_x=0.15, half_y=0.15, height=1.3) for dy in (-1, 1)]
    return dataclasses.replace(
        room, robot=dataclasses.replace(room.robot, joint_limit_deg=120.0), solids=(*room.solids, *walls, *posts),
        targets=(dataclasses.replace(room.targets[0], x=0.0, y=-5.95, z=0.9, yaw=0.0),
                 dataclasses.replace(room.targets[1], x=4.0)),
        starts=(dataclasses.replace(room.starts[0], x=x, y=y, heading_steps=0),),
        dynamics=DynamicsConfig(press_with="hand", kind="physics"))


def press_in_bullet(planner: RoomPlanner, primitives: Sequence[int]):
    """Execute primitives under physics; the last state."""
    env = EscapeRoomEnv(instance=planner.instance)
    env.reset(seed=0)
    for primitive in primitives:
        env.step(primitive)
    state = env.get_state()
    env.close()
    return state


@pytest.mark.nightly
def test_an_arm_among_posts_presses_by_joint_steps_along_a_path_under_physics():
    planner = RoomPlanner(make_pen())
    start, reacher = planner.rules.make_state(planner.instance.starts[0]), planner.routes.get_reacher()
    posture = reacher.get_configuration(start.x, start.y, start.heading_steps, start.joint_steps, 0)
    assert posture is not None and reacher.order_steps(start, (), posture, 0) is None, "no order of few steps is free"
    primitives = reacher.plan_steps(start, posture, others=~1)
    assert primitives is not None and len(primitives) > sum(map(abs, posture))
    end = press_in_bullet(planner, primitives)
    assert end.touching & 1 and end.joint_steps == posture


@pytest.mark.slow  # a base so hemmed in takes the finest grids
def test_a_plan_among_posts_comes_true_under_physics(monkeypatch):
    planner = RoomPlanner(make_pen())
    start = planner.rules.make_state(planner.instance.starts[0])
    plan = planner.plan(start, "press-button-1")
    end, expected = press_in_bullet(planner, plan.primitives), plan.states[-1]
    assert end.touching & 1 and end.joint_steps == expected.joint_steps
    assert math.hypot(end.x - expected.x, end.y - expected.y) < 1e-4
    monkeypatch.setattr(reacher, "PATH_TESTS", 1)
    with pytest.raises(PlanningFailed):
        planner.plan(start._replace(primitives=1, x=start.x + 1e-6), "press-button-1")
