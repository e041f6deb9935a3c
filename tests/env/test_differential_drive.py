"""A differential drive: fewer primitives, the same rules in both engines, the certificate, the planner and options."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch

from benchmarks.conformance import compare
from benchmarks.options_conformance import compare_options
from benchmarks.reference_search import find_fewest_primitives
from hrl_escape.env.batched.engine import TensorRoom
from hrl_escape.env.batched.rooms import Rooms
from hrl_escape.env.bullet.engine import BulletRoom
from hrl_escape.env.config import DynamicsConfig, ObstaclesConfig, RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.sampling.primitive_proof import meets_condition
from hrl_escape.errors import ConfigError, UnsupportedError
from hrl_escape.options.degraded import OptionDegradation
from hrl_escape.planning.areas import compute_goal_area
from hrl_escape.planning.arm.arm_planner import ArmPlanner
from hrl_escape.planning.goals import PressGoal
from hrl_escape.planning.motion.limits import MotionLimits
from hrl_escape.planning.motion.trajectory import make_trajectory
from hrl_escape.planning.planner import RoomPlanner

SMALL = RoomConfig(room=ShapeConfig(width=8, depth=8), robot=RobotConfig(body_radius=0.4, turn_step_deg=15,
                                                                         drive="differential"),
                   puzzle=ButtonsConfig(count=2, buttons=Panels(width=0.6)), obstacles=ObstaclesConfig(count=3))


def change(config: RoomConfig, **robot) -> RoomConfig:
    return dataclasses.replace(config, robot=dataclasses.replace(config.robot, **robot))


def test_there_are_two_moves_and_two_turns_before_the_joints():
    robot = RobotConfig(joints=1, drive="differential")
    assert robot.actions.names == ("forward", "back", "turn-left", "turn-right", "joint-1-increment",
                                   "joint-1-decrement")
    assert [robot.actions.names[n] for n in (robot.actions.wait, *robot.actions.turns)] == [
        "turn-left", "turn-left", "turn-right"]


def test_a_drive_is_part_of_a_room_and_the_usual_one_changes_no_id():
    assert "drive" not in RobotConfig().to_dict()
    room = generate(SMALL, 0)
    assert RoomInstance.from_dict(room.to_dict()).robot.drive == "differential"
    assert room.id != dataclasses.replace(room, robot=dataclasses.replace(room.robot, drive="strafing")).id


def test_nothing_moves_sideways():
    room = generate(dataclasses.replace(SMALL, dynamics=DynamicsConfig(noise=0.2, slip=0.3, slip_kind="any")), 1)
    env, rng = EscapeRoomEnv(instance=room), np.random.default_rng(0)
    assert env.action_space.n == 4
    env.reset(seed=0)
    for action in rng.integers(4, size=300).tolist():
        before = env.get_state()
        _, _, terminated, truncated, _ = env.step(action)
        after, heading = env.get_state(), env.rules.get_heading(before)
        dx, dy = after.x - before.x, after.y - before.y
        assert abs(dy * math.cos(heading) - dx * math.sin(heading)) < 1e-12
        if terminated or truncated:
            env.reset()
    env.close()


@pytest.mark.nightly_for("dynamics1", "dynamics2")
@pytest.mark.parametrize("dynamics", [DynamicsConfig(), DynamicsConfig(noise=0.2, slip=0.2, slip_kind="any"),
                                      DynamicsConfig(slip=0.3, slip_kind="neighbour", blocked="stay")])
def test_the_batched_engine_agrees_with_the_scalar_rules(dynamics):
    config = change(dataclasses.replace(SMALL, dynamics=dynamics), joints=2)
    found = compare([generate(config, seed) for seed in range(2)], 600, copies=10)
    assert found.primitives >= 600 and not found.disagreements and found.close_calls <= 1 and found.worst < 1e-9


@pytest.mark.nightly
def test_the_batched_engine_agrees_with_the_bullet_engine():
    room = generate(SMALL, 1)
    batch, bullet = TensorRoom(Rooms(instance=room), autoreset="disabled"), BulletRoom(room)
    batch.reset(torch.tensor([4]))
    bullet.set_state(batch.get_room_state(0))
    for action in np.random.default_rng(0).integers(4, size=100).tolist():
        batch.step(torch.tensor([action]))
        found, state = batch.get_room_state(0), bullet.step(action).state
        assert abs(found.x - state.x) < 1e-9 and abs(found.y - state.y) < 1e-9
        assert (found.heading_steps, found.touching) == (state.heading_steps, state.touching)
    bullet.close()


def test_under_physics_a_primitive_moves_along_the_heading():
    physics = dataclasses.replace(change(get_preset("push-block"), drive="differential"))
    room = BulletRoom(generate(physics, 0))
    for action, name in enumerate(room.rules.actions.names):
        before = room.state
        after, heading = room.step(action).state, room.rules.get_heading(before)
        dx, dy = after.x - before.x, after.y - before.y
        along, aside = dx * math.cos(heading) + dy * math.sin(heading), dy * math.cos(heading) - dx * math.sin(heading)
        assert abs(aside) < 0.02 and (abs(along) < 0.02) == name.startswith("turn")
    room.close()


def test_slips_to_the_side_are_refused():
    with pytest.raises(ConfigError, match="sideways"):
        dataclasses.replace(SMALL, dynamics=DynamicsConfig(slip=0.1, slip_kind="lateral"))


@pytest.mark.nightly
def test_the_sufficient_condition_asks_for_headings_straight_at_the_walls():
    plain = dataclasses.replace(SMALL, obstacles=ObstaclesConfig(count=0), puzzle=ButtonsConfig(count=1))
    for turn, drive, holds in ((15, "differential", True), (12, "differential", False), (12, "strafing", True)):
        room = generate(change(plain, turn_step_deg=turn, drive=drive), 0)
        assert meets_condition(room) == holds
        assert RoomPlanner(room).solve(RoomPlanner(room).rules.make_state(room.starts[0])).cost > 0


def test_plans_are_within_a_few_percent_of_the_near_exact_reference():
    planned = fewest = 0
    for seed in range(4):
        room = generate(SMALL, seed)
        planner = RoomPlanner(room)
        state = planner.rules.make_state(room.starts[0])
        for target in range(2):
            area = compute_goal_area(PressGoal(target), room)
            found = find_fewest_primitives(planner.rules, state, PressGoal(target), *area)
            assert found is not None
            fewest, planned = fewest + len(found), planned + planner.plan(state, f"press-button-{target + 1}").cost
    assert fewest <= planned <= 1.04 * fewest


def test_escapes_come_true_and_take_longer_than_with_a_base_that_strafes():
    costs = {}
    for drive in ("differential", "strafing"):
        room = generate(change(SMALL, drive=drive), 2)
        planner = RoomPlanner(room)
        plan = planner.solve(planner.rules.make_state(room.starts[0]))
        env = EscapeRoomEnv(instance=room)
        env.reset(options={"state": plan.states[0]})
        run = plan.execute(env)
        assert run.escaped and run.as_predicted
        costs[drive] = plan.cost
        env.close()
    assert costs["differential"] > costs["strafing"]


def test_trajectories_turn_on_the_spot_and_drive_straight():
    planner = RoomPlanner(generate(SMALL, 2))
    plan = planner.solve(planner.rules.make_state(planner.instance.starts[0]))
    trajectory = make_trajectory(plan, MotionLimits(speed=1.0, acceleration=0.5))
    times = np.linspace(0.0, trajectory.duration, 3_000)
    (x, y, heading), (vx, vy, turning) = trajectory.evaluate(times)[:, :3].T, trajectory.evaluate(times, 1)[:, :3].T
    assert np.abs(vy * np.cos(heading) - vx * np.sin(heading)).max() < 1e-6
    assert np.minimum(np.hypot(vx, vy), np.abs(turning)).max() < 1e-6
    assert np.allclose((x[-1], y[-1]), plan.path[-1])


def test_base_and_arm_are_not_planned_as_if_the_base_strafed():
    planner = ArmPlanner(generate(change(SMALL, joints=2), 0))
    with pytest.raises(UnsupportedError, match="strafes"):
        planner.plan_whole_body(planner.rules.make_state(planner.instance.starts[0]), (0, 0, 0), (0.0, 0.0))


@pytest.mark.nightly
def test_options_of_both_kinds_reach_their_goals():
    found = compare_options([generate(dataclasses.replace(SMALL, obstacles=ObstaclesConfig(count=0)), 1)], 12)
    assert found.decisions >= 8 and not found.missed


def test_a_detour_is_made_of_this_robot_s_turns():
    room = generate(SMALL, 0)
    option = OptionDegradation(detour=2)(room)[0]
    state = RoomPlanner(room).rules.make_state(room.starts[0])
    option.start(state)
    rng = np.random.default_rng(0)
    assert [option.sample_action(state, rng) for _ in range(2)] == list(room.robot.actions.turns)
