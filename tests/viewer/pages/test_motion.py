"""Trajectories as pages: the robot goes where the trajectory says, and when."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from hrl_escape.cli import main
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError
from hrl_escape.planning.motion.legs import PRESS_SECONDS
from hrl_escape.planning.motion.trajectory import make_trajectory
from hrl_escape.planning.planner import RoomPlanner
from hrl_escape.viewer.pages.offline import make_motion
from tests.viewer.pages.test_replay import read_recorded


def read_line(content: dict, buffers: list[bytes], name: str) -> np.ndarray:
    """Segments of a line, shape (segments, 2, 3)."""
    lines = [message["props"] for _, message in content["messages"]
             if message["type"] == "LineSegmentsMessage" and message["name"] == f"/room/{name}"]
    return np.frombuffer(buffers[lines[-1]["points"]["__binary_index"]], dtype=np.float32).reshape(-1, 2, 3)


@pytest.mark.nightly
def test_a_page_moves_base_and_hand_along_the_trajectory_in_its_time():
    room = generate(get_preset("arm-two-button"), 3)
    planner = RoomPlanner(room)
    plan = planner.plan(planner.rules.make_state(room.starts[0]), "press-button-1")
    trajectory = make_trajectory(plan)
    content, buffers = read_recorded(make_motion(trajectory, room, plan.states[0]))
    moves = [(seconds, message["position"]) for seconds, message in content["messages"]
             if message["type"] == "SetPositionMessage" and message["name"] == "/room/robot"]
    times = np.array([seconds for seconds, _ in moves[-50:]])
    places = trajectory.evaluate(times)[:, :2]
    np.testing.assert_allclose(np.array([place[:2] for _, place in moves[-50:]]), places, atol=1e-3)
    assert times[-1] == pytest.approx(trajectory.duration - PRESS_SECONDS, abs=1e-3), "it rests after the press"
    hand = read_line(content, buffers, "hand-path")[-1, 1]
    np.testing.assert_allclose(hand, planner.rules.get_hand(plan.states[-1]), atol=1e-3)
    assert math.hypot(*(read_line(content, buffers, "path")[-1, 1, :2] - places[-1])) < 1e-3


def test_a_trajectory_of_another_robot_is_refused_by_the_names_of_its_joints(two_buttons):
    room = generate(get_preset("arm-two-button"), 3)
    planner = RoomPlanner(room)
    trajectory = make_trajectory(planner.plan(planner.rules.make_state(room.starts[0]), "press-button-1"))
    with pytest.raises(ConfigError, match="coordinates of this room's robot: x, y, heading"):
        make_motion(trajectory, two_buttons)


@pytest.mark.nightly
def test_the_command_writes_a_plan_as_motion(tmp_path: Path, capfd):
    assert main(["solve", "--room", "paper-one-button", "--draw", str(tmp_path / "way.html")]) == 0
    assert "<title>paper-one-button: " in (tmp_path / "way.html").read_text()
    assert main(["solve", "--room", "push-block", "--draw", str(tmp_path / "way.html")]) == 2
    assert "hrl-escape record" in capfd.readouterr().err
