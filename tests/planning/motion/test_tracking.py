"""Tracked trajectories press what their plans press: in the exact rooms, under noise, and in Bullet's physics."""

from __future__ import annotations

import dataclasses

import pytest

from benchmarks.trajectories import list_configs, solve
from hrl_escape.env.continuous import EscapeRoomContinuousEnv
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.kinematics import EpisodeEnd
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import EscapeError
from hrl_escape.planning.motion.limits import MotionLimits
from hrl_escape.planning.motion.trajectory import make_trajectory, track

SLOWER = MotionLimits(speed=0.8, joint_speed=0.8)


def run(name: str, seed: int, time_step: float = 0.1, **dynamics):
    config = list_configs()[name]
    plan = solve(generate(dataclasses.replace(config, dynamics=dataclasses.replace(config.dynamics, **dynamics)), seed))
    trajectory = make_trajectory(plan, SLOWER)
    env = EscapeRoomContinuousEnv(instance=plan.instance, time_step=time_step)
    env.reset(options={"state": plan.states[0]})
    tracking = track(trajectory, env)
    env.close()
    return plan, trajectory, tracking


@pytest.mark.nightly_for("pin-pad-0.02", "arm-two-button-0.1", "lights-out, differential-0.1")
@pytest.mark.parametrize(("name", "time_step"), [("deep-sea", 0.1), ("pin-pad", 0.02), ("arm-two-button", 0.1),
                                                 ("lights-out, differential", 0.1)])
def test_exact_rooms_are_escaped_on_the_trajectory(name, time_step):
    _, trajectory, tracking = run(name, 0, time_step)
    assert tracking.pressed == tuple(contact.target for contact in trajectory.contacts)
    assert tracking.end is EpisodeEnd.ESCAPED and tracking.distance < 1e-6
    assert tracking.seconds <= trajectory.duration + 2 * time_step


@pytest.mark.nightly_for("arm-two-button-dynamics1-0.05", "paper-two-button-dynamics0-0.5")
@pytest.mark.parametrize(("name", "dynamics", "within"), [
    ("paper-two-button", {"kind": "physics"}, 0.5), ("arm-two-button", {"kind": "physics"}, 0.05),
    ("paper-two-button", {"noise": 0.1}, 0.05)])
def test_physics_and_noise_press_the_same(name, dynamics, within):
    _, trajectory, tracking = run(name, 0, **dynamics)
    assert tracking.pressed == tuple(contact.target for contact in trajectory.contacts) != ()
    assert tracking.end is EpisodeEnd.ESCAPED and 1e-6 < tracking.distance < within


@pytest.mark.nightly
def test_a_trajectory_of_another_place_or_environment_is_refused():
    plan = solve(generate(list_configs()["paper-two-button"], 0))
    trajectory = make_trajectory(plan)
    env = EscapeRoomContinuousEnv(instance=plan.instance)
    env.reset(options={"state": plan.states[3]})
    with pytest.raises(EscapeError, match="starts at"):
        track(trajectory, env)
    flat = EscapeRoomEnv(instance=plan.instance)
    flat.reset()
    with pytest.raises(EscapeError, match="EscapeRoomContinuous-v1"):
        track(trajectory, flat)
