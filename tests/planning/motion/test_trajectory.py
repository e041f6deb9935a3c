"""Trajectories keep their limits and the room's solids, end where plans end, and take the times of the closed form."""

from __future__ import annotations

import csv
import json
import math
import sys

import numpy as np
import pytest

from hrl_escape.env.geometry import compute_distance_many, stack_footprints
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError, MissingExtraError, UnsupportedError
from hrl_escape.planning.arm.arm_planner import ArmPlanner
from hrl_escape.planning.motion.limits import MotionLimits, compute_duration, compute_rest_to_rest
from hrl_escape.planning.motion.path import MotionPath, round_corners
from hrl_escape.planning.motion.trajectory import make_trajectory
from hrl_escape.planning.planner import RoomPlanner

METHODS = ("trapezoid", "toppra")


def make_plan(preset: str, seed: int):
    planner = RoomPlanner(generate(get_preset(preset), seed))
    return planner.solve(planner.rules.make_state(planner.instance.starts[0]))


def make_path(points, names=("x", "y", "heading"), margin=0.05) -> MotionPath:
    points = np.array(points, dtype=float)
    return MotionPath(names, points, np.ones(points.shape[1]), margin, "test")


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("preset", "seed"), [("clutter", 3), ("arm-two-button", 0)])
def test_trajectories_of_plans_keep_limits_and_solids_and_meet_the_ends_of_all_legs(preset, seed, method):
    plan, limits = make_plan(preset, seed), MotionLimits(speed=1.2, acceleration=0.7)
    trajectory = make_trajectory(plan, limits, method=method)
    times = np.linspace(0.0, trajectory.duration, 20_000)
    speeds, accelerations = trajectory.evaluate(times, 1), trajectory.evaluate(times, 2)
    slack = 1.01
    assert np.hypot(*speeds[:, :2].T).max() <= slack * limits.speed
    assert np.hypot(*accelerations[:, :2].T).max() <= slack * limits.acceleration
    assert np.abs(speeds[:, 2]).max() <= slack * limits.turn_speed
    assert np.abs(accelerations[:, 2]).max() <= slack * limits.turn_acceleration
    assert np.abs(speeds[:, 3:]).max(initial=0) <= slack * limits.joint_speed
    assert np.abs(accelerations[:, 3:]).max(initial=0) <= slack * limits.joint_acceleration
    shapes = stack_footprints([solid.footprint for solid in plan.instance.solids])
    assert compute_distance_many(trajectory.evaluate(times)[:, :2], shapes).min() > plan.instance.robot.body_radius
    places = trajectory.evaluate(times)[:, :2]
    for part in plan.parts:
        assert np.hypot(*(places - plan.path[part.stop]).T).min() < 0.005
    assert np.allclose(trajectory.positions[-1, :2], plan.path[-1]) and not trajectory.velocities[[0, -1]].any()


def test_a_straight_line_takes_the_time_of_the_closed_form():
    for length in (0.2, 5.0):
        path, limits = make_path([(0, 0, 0), (0.6 * length, 0.8 * length, 0)]), MotionLimits()
        expected = compute_rest_to_rest(length, 1.0, 1.0)
        assert make_trajectory(path, limits).duration == pytest.approx(expected, rel=1e-12)
        assert make_trajectory(path, limits, method="toppra").duration == pytest.approx(expected, rel=0.02)


def test_coordinates_wait_for_the_slowest():
    path = make_path([(0, 0, 0), (1, 0, 3)])
    trajectory = make_trajectory(path, MotionLimits(turn_speed=0.5, turn_acceleration=0.5))
    assert trajectory.duration == pytest.approx(3 / 0.5 + 0.5 / 0.5)
    middle = trajectory.evaluate(trajectory.duration / 2)
    assert middle == pytest.approx([0.5, 0.0, 1.5])


def test_primitives_one_by_one_take_as_long_as_the_formula_says():
    planner = RoomPlanner(generate(get_preset("paper-two-button"), 0))
    plan = planner.plan(planner.rules.make_state(planner.instance.starts[0]), "3,0")
    robot, limits = plan.instance.robot, MotionLimits()
    seconds = compute_duration(plan.states, limits, math.radians(robot.turn_step_deg), math.radians(10))
    assert seconds == pytest.approx(make_trajectory(plan, limits).duration), "one straight line"


def test_rounded_corners_stay_within_the_margin_and_are_smooth():
    path = make_path([(0, 0, 0), (2, 0, 0), (2, 2, 0.5), (0, 2, 0.5)], margin=0.1)
    curve = round_corners(path)
    at = np.linspace(0, curve.x[-1], 4000)
    places = curve(at)
    lines = np.concatenate([np.linspace(a, b, 4000) for a, b in zip(path.points, path.points[1:], strict=False)])
    away = [np.abs(lines - place).sum(axis=1).min() for place in places[::20]]
    assert 0.04 < max(away) <= 0.1 + 1e-3
    assert np.abs(np.diff(curve(at, 1), axis=0)).max() < 0.02, "its direction never jumps"
    assert np.allclose(places[[0, -1]], path.points[[0, -1]])


@pytest.mark.parametrize("names", [("x", "y", "heading"), ("joint-1", "joint-2", "joint-3")])
def test_time_optimal_motion_keeps_every_limit_at_every_moment(names):
    rng, limits = np.random.default_rng(0), MotionLimits()
    speed, acceleration = np.array([(1.0, 1.0), (1.5, 3.0)] if "x" in names else [(1.0, 2.0)] * 3).T
    for _ in range(40):
        points = rng.uniform(-1, 1, size=(rng.integers(3, 7), 3))
        trajectory = make_trajectory(make_path(points, names, rng.choice([0.005, 0.02, 0.1])), limits, method="toppra")
        edges = np.concatenate([trajectory.times[1:] - 1e-9, trajectory.times[:-1] + 1e-9])
        times = np.concatenate([np.linspace(0, trajectory.duration, 5_000), edges])
        for order, largest in ((1, speed), (2, acceleration)):
            rates = trajectory.evaluate(times, order)
            sizes = np.column_stack([np.hypot(*rates[:, :2].T), np.abs(rates[:, 2])]) if "x" in names else np.abs(rates)
            assert (sizes.max(axis=0) <= largest * (1 + 1e-5)).all()


def test_time_optimal_motion_is_nearly_as_fast_as_its_limits_allow():
    """On the way round corners some limit is met almost always, so that no motion could be much faster."""
    rng, limits, met = np.random.default_rng(1), np.array([1.0, 2.0]), []
    for _ in range(10):
        path = make_path(rng.uniform(-1, 1, size=(5, 3)), ("joint-1", "joint-2", "joint-3"), 0.02)
        trajectory = make_trajectory(path, method="toppra")
        times = np.linspace(0, trajectory.duration, 5_000)
        rates = [np.abs(trajectory.evaluate(times, order)).max(axis=1) for order in (1, 2)]
        met.append((np.array(rates).T / limits).max(axis=1) > 0.98)
    assert np.mean(met) > 0.9


@pytest.mark.parametrize("preset", ["deep-sea", "recipes", "factored"])
def test_a_trajectory_that_would_lose_presses_of_its_plan_is_refused(preset):
    """The plan leaves a target and touches it again; the straight way in between stays on it."""
    plan = make_plan(preset, 0)
    with pytest.raises(UnsupportedError, match="would press .* where the plan presses"):
        make_trajectory(plan)


def test_a_trajectory_may_press_what_is_lit_already():
    plan = make_plan("ten-button", 0)
    trajectory = make_trajectory(plan)
    puzzle, rules, touched = plan.instance.puzzle, Kinematics(plan.instance), plan.states[0].touching
    state, number = plan.states[0].puzzle, 0
    for x, y, heading in trajectory.evaluate(np.linspace(0, trajectory.duration, 40_000)).tolist():
        touching = rules.compute_touching(x, y, 0, heading, (), ())
        if begun := touching & ~touched:
            number += 1
            state = puzzle.update(state, Contacts(tuple(i for i in range(10) if begun >> i & 1)))
        touched = touching
    assert number >= 5 and state == plan.states[-1].puzzle


def test_time_optimal_motion_is_faster_and_arms_can_have_it():
    planner = ArmPlanner(generate(get_preset("arm-two-button"), 0))
    state = planner.rules.make_state(planner.instance.starts[0])
    path = planner.plan(state, (0.9, 0.5, -0.8))
    bent = MotionPath(path.names, np.array([[0, 0, 0], [0.5, 0.6, 0.0], [0.9, 0.5, -0.8]]), path.scale, 0.1, "")
    slow, fast = (make_trajectory(bent, method=method) for method in METHODS)
    assert fast.duration < slow.duration and fast.names == planner.rules.robot.joint_names
    speeds = fast.evaluate(np.linspace(0, fast.duration, 5000), 1)
    assert 0.95 < np.abs(speeds).max() <= 1.01, "a limit is met somewhere"


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
    assert json.loads((tmp_path / "way.json").read_text())["positions"] == trajectory.positions.tolist()
    message = trajectory.to_ros(20)
    assert message["joint_names"] == ["x", "y", "heading"] and len(message["points"]) == len(times)
    last = message["points"][-1]["time_from_start"]
    assert last["sec"] + 1e-9 * last["nanosec"] == pytest.approx(trajectory.duration)
    trajectory.draw(plan.instance, tmp_path / "way.png")


def test_wrong_arguments_and_a_missing_library_are_named(monkeypatch, tmp_path):
    path = make_path([(0, 0, 0), (1, 0, 0)])
    for call in (lambda: make_trajectory(path, method="ruckig"), lambda: make_trajectory(path).sample(0),
                 lambda: make_trajectory(path).save(tmp_path / "way.bag"),
                 lambda: make_trajectory(make_path([(0, 0, 0)]))):
        with pytest.raises(ConfigError):
            call()
    monkeypatch.setitem(sys.modules, "toppra", None)
    with pytest.raises(MissingExtraError, match="toppra"):
        make_trajectory(path, method="toppra")
