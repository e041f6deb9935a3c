"""Trajectories press what plans press, keep their limits and the room's solids, and take the times of closed forms."""

from __future__ import annotations

import csv
import dataclasses
import itertools
import json
import math

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from benchmarks.trajectories import check, list_configs, list_faults, list_presses, measure_peaks, solve
from hrl_escape.env.config import DynamicsConfig, RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.continuous import EscapeRoomContinuousEnv
from hrl_escape.env.geometry import compute_distance_many, stack_footprints
from hrl_escape.env.kinematics import EpisodeEnd
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.robot import make_robot
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError, UnsupportedError
from hrl_escape.planning.arm.arm_planner import ArmPlanner
from hrl_escape.planning.motion.legs import PRESS_SECONDS
from hrl_escape.planning.motion.limits import MotionLimits, compute_duration, compute_rest_to_rest
from hrl_escape.planning.motion.trajectory import TimedTrajectory, make_trajectory, track
from hrl_escape.planning.paths.problem import MotionPath
from hrl_escape.planning.planner import RoomPlanner

LIMITS = MotionLimits()


def make_plan(preset: str, seed: int):
    return solve(generate(get_preset(preset), seed))


def make_path(points, names=("x", "y", "heading"), margin=0.05, **more) -> MotionPath:
    points = np.array(points, dtype=float)
    return MotionPath(names, points, np.ones(points.shape[1]), margin, "test", **more)


def make_boom(effort: float, mass: float = 2.0) -> RobotConfig:
    """A bar of 1 m, of a given mass in its middle, that one joint lifts."""
    urdf = f"""<robot name="boom"><link name="foot"/>
    <link name="bar"><inertial><origin xyz="0.5 0 0"/><mass value="{mass}"/>
    <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link><link name="tip"/>
    <joint name="lift" type="revolute"><parent link="foot"/><child link="bar"/><axis xyz="0 -1 0"/>
    <limit lower="-1" upper="1" effort="{effort}" velocity="0.4"/></joint>
    <joint name="end" type="fixed"><parent link="bar"/><child link="tip"/><origin xyz="1 0 0"/></joint></robot>"""
    return RobotConfig(kind="urdf", urdf=urdf, joints=1, hand_link="tip", body_radius=0.4, body_height=0.8)


# --- presses ---------------------------------------------------------------------------------


@pytest.mark.nightly_for("lights-out, differential-0", "potions-0", "arm-two-button-0")
@pytest.mark.parametrize(("name", "seed"), [
    ("potions", 0), pytest.param("pin-pad", 0, marks=pytest.mark.slow),
    pytest.param("deep-sea", 0, marks=pytest.mark.slow), ("arm-two-button", 0), ("lights-out, differential", 0)])
def test_trajectories_press_what_their_plans_press_and_keep_every_limit(name, seed):
    plan = solve(generate(list_configs()[name], seed))
    assert list_faults(plan, make_trajectory(plan), LIMITS) == []


@pytest.mark.slow
def test_trajectories_of_every_puzzle_body_and_hand_are_right():
    found = list(check(100))
    assert [row for row in found if row[2] and not row[2][0].startswith(("refused", "no plan"))] == []
    assert sum(not faults for _, _, faults in found) >= 97


@pytest.mark.nightly
def test_faults_are_found():
    """The check is no formality: the way to one target only, and limits halved."""
    plan = make_plan("paper-two-button", 0)
    trajectory = make_trajectory(plan)
    leg = RoomPlanner(plan.instance).plan(plan.states[0], "press-button-1")
    assert any("presses" in fault for fault in list_faults(plan, make_trajectory(leg), LIMITS))
    assert any("of a limit" in fault for fault in list_faults(plan, trajectory, MotionLimits(acceleration=0.5)))
    assert any("of a limit" in fault for fault in list_faults(plan, trajectory, MotionLimits(jerk=5.0)))


@pytest.mark.nightly
def test_a_way_goes_round_targets_that_its_plan_does_not_press():
    """The plan's own moves cross the corner of a pad between the ends of two primitives."""
    plan = make_plan("pin-pad", 0)
    pressed = [contact.target for contact in make_trajectory(plan).contacts]
    states = itertools.pairwise(plan.states)
    assert pressed == [k for a, b in states for k in range(8) if (b.touching & ~a.touching) >> k & 1]


@pytest.mark.nightly
def test_a_trajectory_that_would_press_more_than_its_plan_is_refused():
    """A differential drive follows the plan's own lines, which here cross a pad between the ends of two primitives."""
    config = get_preset("pin-pad")
    robot = dataclasses.replace(config.robot, drive="differential")
    plan = solve(generate(dataclasses.replace(config, robot=robot), 0))
    with pytest.raises(UnsupportedError, match="leg 'press-pad-1' .* presses pad-1 and nothing else"):
        make_trajectory(plan)


@pytest.mark.nightly
def test_targets_that_a_plan_touches_in_one_primitive_are_pressed_with_the_same_effect():
    """Here the shortest way touches button 6 before button 3, which it locks, so that the exit stays shut."""
    plan = solve(generate(get_preset("dead-ends"), 78))
    assert (2, 5) in list_presses(plan)
    puzzle, pressed = plan.instance.puzzle, [contact.target for contact in make_trajectory(plan).contacts]
    state = puzzle.make_state()
    for target in pressed:
        state = puzzle.update(state, Contacts((target,)))
    assert puzzle.is_solved(state) and pressed == [target for each in list_presses(plan) for target in each]


def test_under_physics_nothing_is_pressed_by_a_margin():
    """The plan ends within the press margin of a second digit, which takes force."""
    config = get_preset("code-lock")
    room = generate(dataclasses.replace(config, dynamics=dataclasses.replace(config.dynamics, kind="physics")), 1)
    plan = solve(room)
    assert [contact.target for contact in make_trajectory(plan).contacts] == [k for k, in list_presses(plan)]


@pytest.mark.nightly
def test_the_base_rests_after_each_press():
    trajectory = make_trajectory(make_plan("paper-two-button", 0))
    for contact in trajectory.contacts:
        slow = trajectory.times[1:][np.isclose(np.diff(trajectory.times), PRESS_SECONDS)]
        assert any(0.0 <= time - contact.time < 1.0 for time in slow)


@pytest.mark.nightly_for("blocks-world-6", "sokoban-3")
@pytest.mark.parametrize(("preset", "seed"), [
    ("taxi", 0), ("blocks-world", 6), ("door-key", 2), ("sokoban", 3),
    *(pytest.param(preset, seed, marks=pytest.mark.slow) for seed in range(7, 15)
      for preset in ("taxi", "blocks-world", "door-key", "key-corridor", "multi-room", "sokoban"))])
def test_plans_that_grip_or_push_are_driven_to_their_ends(preset, seed):
    plan = make_plan(preset, seed)
    trajectory, actions = make_trajectory(plan), plan.instance.robot.actions.primitives
    assert [grip.action for grip in trajectory.grips] == [
        actions[action].name for action in plan.primitives if actions[action].grip]
    rests = [trajectory.evaluate([grip.time, grip.time + 0.9 * PRESS_SECONDS], 1) for grip in trajectory.grips]
    assert np.abs([0.0, *np.ravel(rests)]).max() < 1e-9, "it rests there"
    assert max(measure_peaks(trajectory, LIMITS).values()) <= 1.0 + 1e-6
    for time_step in (0.05, 1.0 if preset == "blocks-world" else 0.4):  # a step over the whole rest, and away
        env = EscapeRoomContinuousEnv(instance=plan.instance, time_step=time_step, time_limit=1e4)
        env.reset(options={"state": plan.states[0]})
        tracking = track(trajectory, env)
        puzzles = [key for key, _ in itertools.groupby(state.puzzle for state in tracking.states)]
        planned = [key for key, _ in itertools.groupby(state.puzzle for state in plan.states)]
        assert tracking.end is EpisodeEnd.ESCAPED and puzzles == planned
    assert json.loads(json.dumps(trajectory.to_dict()))["grips"] == [grip._asdict() for grip in trajectory.grips]


# --- limits ----------------------------------------------------------------------------------


def test_a_straight_line_takes_the_time_of_the_closed_form():
    for length, (speed, acceleration, jerk) in itertools.product(
            (1e-4, 0.01, 0.2, 5.0), [(1.0, 1.0, 10.0), (0.3, 2.0, 4.0), (2.0, 0.5, 0.5)]):
        path = make_path([(0, 0, 0), (0.6 * length, 0.8 * length, 0)])
        expected = compute_rest_to_rest(length, speed, acceleration, jerk)
        limits = MotionLimits(speed=speed, acceleration=acceleration, jerk=jerk)
        assert make_trajectory(path, limits).duration == pytest.approx(expected, rel=1e-9)


def test_coordinates_wait_for_the_slowest():
    path = make_path([(0, 0, 0), (1, 0, 3)])
    trajectory = make_trajectory(path, MotionLimits(turn_speed=0.5, turn_acceleration=0.5, turn_jerk=1.0))
    assert trajectory.duration == pytest.approx(3 / 0.5 + 0.5 / 0.5 + 0.5 / 1.0)
    assert trajectory.evaluate(trajectory.duration / 2) == pytest.approx([1 / 2, 0.0, 1.5])


def test_places_and_derivatives_between_knots_are_scipys_to_the_bit():
    rng = np.random.default_rng(0)
    for count in (2, 3, 12):
        times = np.concatenate([[0.0], np.cumsum(rng.uniform(1e-3, 2.0, count - 1))])
        positions, velocities = rng.normal(size=(2, count, 4))
        motion = TimedTrajectory(("a", "b", "c", "d"), times, positions, velocities, MotionLimits())
        spline, at = CubicHermiteSpline(times, positions, velocities), np.append(times, rng.uniform(0, times[-1], 50))
        for order in range(4):
            assert np.array_equal(motion.evaluate(at, order), spline(at, order)), (count, order)


def test_primitives_one_by_one_take_as_long_as_the_formula_says():
    planner = RoomPlanner(generate(get_preset("paper-two-button"), 0))
    plan = planner.plan(planner.rules.make_state(planner.instance.starts[0]), "3,0")
    seconds = compute_duration(plan.states, LIMITS, planner.rules.robot, planner.rules.turn_step)
    assert seconds == pytest.approx(make_trajectory(plan, LIMITS).duration), "one straight line"


@pytest.mark.parametrize("names", [("x", "y", "heading"), ("joint-1", "joint-2", "joint-3")])
def test_motion_keeps_every_limit_at_every_moment_and_its_path(names):
    rng = np.random.default_rng(0)
    for _ in range(30):
        points = rng.uniform(-1, 1, size=(rng.integers(3, 7), 3)) * rng.choice([1.0, 0.1, 0.01])
        margin = float(rng.choice([0.0, 0.005, 0.02, 0.1]))
        trajectory = make_trajectory(make_path(points, names, margin))
        assert max(measure_peaks(trajectory, LIMITS).values()) <= 1.0 + 1e-6
        lines = np.concatenate([np.linspace(a, b, 400) for a, b in itertools.pairwise(points)])
        places = trajectory.evaluate(np.linspace(0, trajectory.duration, 60))
        spacing = np.abs(np.diff(points, axis=0)).sum(axis=1).max() / 400
        assert max(np.abs(lines - place).sum(axis=1).min() for place in places) <= margin + spacing
        assert np.allclose(trajectory.positions[[0, -1]], points[[0, -1]]) and not trajectory.velocities[[0, -1]].any()


def test_rounded_corners_are_faster_and_some_limit_is_met():
    rng = np.random.default_rng(1)
    for _ in range(5):
        points = np.cumsum(rng.uniform(0, 1, size=(5, 3)), axis=0)
        slow, fast = (make_trajectory(make_path(points, ("a", "b", "c"), margin)) for margin in (0.0, 0.05))
        assert fast.duration < slow.duration
        assert 0.99 < max(measure_peaks(fast, LIMITS).values())


@pytest.mark.nightly
def test_clearance_is_kept_where_there_is_a_way_with_it():
    plan = make_plan("clutter", 0)
    shapes = stack_footprints([solid.footprint for solid in plan.instance.solids])
    near = []
    for clearance in (0.0, 0.3):
        places = make_trajectory(plan, clearance=clearance).sample(50)[1][:, :2]
        gaps = compute_distance_many(places, shapes) - plan.instance.robot.body_radius
        ends = np.min([np.hypot(*(places - plan.path[k]).T) for k in (0, *(part.stop for part in plan.parts))], axis=0)
        near.append(gaps[ends > 1.2].min())
    assert near[1] >= 0.29 > near[0]


def test_each_joint_has_limits_of_its_own():
    path = make_path([(0, 0), (1, 1)], ("a", "b"))
    one = make_trajectory(path, MotionLimits(joint_speed=(1.0, 0.2)))
    assert one.duration == pytest.approx(compute_rest_to_rest(1.0, 0.2, 2.0, 20.0))
    with pytest.raises(ConfigError, match="one for each of 2 joints"):
        make_trajectory(path, MotionLimits(joint_speed=(1.0, 0.2, 0.3)))


def test_the_urdf_limits_speed_effort_and_position():
    robot = make_robot(make_boom(effort=20.0))
    path = make_path([(0.0,), (0.8,)], robot.joint_names, robot=robot)
    limits = MotionLimits(joint_acceleration=8.0, joint_jerk=1000.0)
    assert make_trajectory(path, limits).duration == pytest.approx(compute_rest_to_rest(0.8, 0.4, 8.0, 1000.0))
    strong, weak, weaker = (make_robot(make_boom(effort)) for effort in (1e3, 12.0, 9.0))
    free = make_trajectory(make_path([(0.0,), (0.8,)], strong.joint_names, robot=strong), limits)
    slow = make_trajectory(make_path([(0.0,), (0.8,)], weak.joint_names, robot=weak), limits)
    times = np.linspace(0, slow.duration, 5000)
    angles, accelerations = slow.evaluate(times)[:, 0], slow.evaluate(times, 2)[:, 0]
    torques = 2.0 * 0.5 * 9.81 * np.cos(angles) + 2.0 * 0.25 * accelerations  # m g r cos + m r^2
    assert slow.duration > free.duration and 11.5 < torques.max() <= 12.0 * 1.01
    with pytest.raises(ConfigError, match="postures that 9 N m hold"):
        make_trajectory(make_path([(0.0,), (0.8,)], weaker.joint_names, robot=weaker))
    with pytest.raises(ConfigError, match="angles from -1 to 1 rad"):
        make_trajectory(make_path([(0.0,), (1.2,)], robot.joint_names, robot=robot))


@pytest.mark.nightly
def test_arms_have_the_limits_of_their_own_urdf():
    config = RoomConfig(room=ShapeConfig(width=8, depth=8), dynamics=DynamicsConfig(press_with="hand"),
                        robot=RobotConfig(kind="franka-panda", joints=7, body_radius=0.4, body_height=0.5))
    planner = ArmPlanner(generate(config, 0))
    home = np.array(planner.rules.robot.home)
    assert planner.rules.robot.speeds == (2.175,) * 4 + (2.61,) * 3
    state = planner.rules.make_state(planner.instance.starts[0])
    trajectory = make_trajectory(planner.plan(state, home + np.array([0.5, -0.4, 0.3, -0.5, 0.2, 0.3, 0.4])),
                                 MotionLimits(joint_speed=9.0, joint_acceleration=60.0, joint_jerk=6000.0))
    speeds = np.abs(trajectory.sample(1000)[2]).max(axis=0)
    assert (speeds <= np.array(planner.rules.robot.speeds) * (1 + 1e-6)).all()


# --- files -----------------------------------------------------------------------------------


@pytest.mark.nightly
def test_sampling_and_files_hold_the_same_motion(tmp_path):
    plan = make_plan("clutter", 3)
    trajectory = make_trajectory(plan)
    times, positions, velocities = trajectory.sample(20)
    assert times[1] == 0.05 and times[-1] == trajectory.duration
    assert np.allclose(np.diff(positions, axis=0)[:-1], 0.05 * (velocities[1:-1] + velocities[:-2]) / 2, atol=5e-3)
    trajectory.save(tmp_path / "way.csv", rate=20)
    rows = list(csv.DictReader((tmp_path / "way.csv").open()))
    assert [float(row["x"]) for row in rows] == positions[:, 0].tolist()
    trajectory.save(tmp_path / "way.json")
    saved = json.loads((tmp_path / "way.json").read_text())
    assert saved["positions"] == trajectory.positions.tolist()
    assert [contact["target"] for contact in saved["contacts"]] == [c.target for c in trajectory.contacts]
    message = trajectory.to_ros(20)
    base = message["multi_dof_joint_trajectory"]
    assert base["joint_names"] == ["base"] and len(base["points"]) == len(times)
    assert message["joint_trajectory"]["joint_names"] == message["joint_trajectory"]["points"] == []
    last = base["points"][-1]["time_from_start"]
    assert last["sec"] + 1e-9 * last["nanosec"] == pytest.approx(trajectory.duration)
    point, at = base["points"][40], trajectory.evaluate([2.0], 0)[0]
    turn = point["transforms"][0]["rotation"]
    assert 2 * math.atan2(turn["z"], turn["w"]) == pytest.approx(at[2])
    for order, kind in ((1, "velocities"), (2, "accelerations")):
        twist = point[kind][0]
        assert [twist["linear"]["x"], twist["linear"]["y"], twist["angular"]["z"]] == pytest.approx(
            trajectory.evaluate(2.0, order).tolist())
    trajectory.draw(plan.instance, tmp_path / "way.png")
    arm = make_trajectory(make_path([(0, 0), (1, 1)], ("a", "b"))).to_ros()
    assert arm["joint_trajectory"]["joint_names"] == ["a", "b"] and not arm["multi_dof_joint_trajectory"]["points"]
    assert len(arm["joint_trajectory"]["points"][3]["accelerations"]) == 2


def test_a_path_that_ends_at_its_start_is_one_knot_at_rest(tmp_path):
    rest = make_trajectory(make_path([(1, 2, 3), (1, 2, 3)]))
    times, positions, velocities = rest.sample(10)
    assert times.tolist() == [0.0] and positions.tolist() == [[1, 2, 3]] and not velocities.any()
    assert rest.evaluate([[0.0, 1.0]]).shape == (1, 2, 3) and not rest.evaluate(0.0, 2).any()
    rest.save(tmp_path / "rest.csv")
    assert len(rest.to_ros()["multi_dof_joint_trajectory"]["points"]) == 1


def test_wrong_arguments_are_named(tmp_path):
    path = make_path([(0, 0, 0), (1, 0, 0)])
    for call in (lambda: make_trajectory(path).sample(0), lambda: make_trajectory(path).save(tmp_path / "way.bag"),
                 lambda: MotionLimits(joint_jerk=(1.0, math.inf)),
                 lambda: make_trajectory(path, clearance=-1.0), lambda: make_trajectory(path, clearance=math.nan),
                 lambda: MotionLimits(speed=(1.0, 1.0))):  # type: ignore[arg-type]
        with pytest.raises(ConfigError):
            call()
