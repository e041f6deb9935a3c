"""The engines agree: random primitives in every kind of room, batched engine against scalar rules and Bullet.

A small version of `benchmarks/conformance.py`, which has the full one.
"""

import dataclasses
import math

import numpy as np
import pytest
import torch

from benchmarks.conformance import compare
from hrl_escape.env.batched.engine import TensorRoom
from hrl_escape.env.batched.rooms import Rooms
from hrl_escape.env.bullet.engine import BulletRoom
from hrl_escape.env.config import CONTACT_SKIN, DynamicsConfig, RoomConfig
from hrl_escape.env.geometry import Solid
from hrl_escape.env.instance import Start
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import PRESETS, get_preset
from hrl_escape.env.sampling.generation import generate
from tests.covering import thin
from tests.env.rooms import all_configs

KINEMATIC = sorted(name for name, config in all_configs().items() if config.dynamics.kind == "kinematic")


@pytest.mark.nightly_for("puddle-world", "arm-two-button", "light-box", "noisy", "recipes", "twenty-button")
@pytest.mark.parametrize("name", thin(KINEMATIC, 4))
def test_the_batched_engine_agrees_with_the_scalar_rules(name):
    found = compare([generate(all_configs()[name], 0)], 200, copies=10)
    assert found.primitives >= 200
    assert not found.disagreements, found.disagreements[0]
    assert found.close_calls <= 1
    assert found.worst < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in PRESETS if get_preset(name).puzzle.kind != "buttons" and
                                  name != "push-block"])
def test_the_engines_agree_on_every_puzzle_over_a_hundred_thousand_primitives(name):
    """`pytest -m slow tests/env/test_engines_agree.py`, some ten seconds a puzzle."""
    found = compare([generate(get_preset(name), seed) for seed in range(4)], 25_000, copies=250)
    assert found.primitives == 100_000
    assert not found.disagreements, found.disagreements[0]
    assert found.is_good and found.worst < 1e-9


@pytest.mark.nightly_for("arm-two-button", "clutter", "noisy")
@pytest.mark.parametrize("name", ["paper-two-button", "arm-two-button", "clutter", "noisy"])
def test_the_batched_engine_agrees_with_the_bullet_engine(name):
    instance = generate(all_configs()[name], 1)
    batch, bullet = TensorRoom(Rooms(instance=instance), autoreset="disabled"), BulletRoom(instance)
    batch.reset(torch.tensor([4]))
    bullet.set_state(batch.get_room_state(0))
    for action in np.random.default_rng(0).integers(batch.actions, size=150).tolist():
        outcome, transition = batch.step(torch.tensor([action])), bullet.step(action)
        found, state = batch.get_room_state(0), transition.state
        assert abs(found.x - state.x) < 1e-9 and abs(found.y - state.y) < 1e-9
        assert (found.heading_steps, found.joint_steps, found.puzzle, found.touching, found.primitives) == (
            state.heading_steps, state.joint_steps, state.puzzle, state.touching, state.primitives)
        assert (outcome.reward.item(), bool(outcome.terminated), bool(outcome.truncated)) == transition[1:4]
        assert tuple(outcome.info.pressed[0].nonzero().flatten().tolist()) == transition.pressed
        if transition.terminated:
            break
    bullet.close()


def test_of_two_solids_that_touch_the_one_that_truly_does_stops_the_body():
    """Seven micrometres from a wall, which single precision takes for touching, and against a cylinder."""
    wall = Solid(x=0, y=1, half_x=10, half_y=0.1)
    pillar = Solid("cylinder", x=-1.2, y=-0.8, half_x=0.8, half_y=0.8)
    empty = generate(RoomConfig(dynamics=DynamicsConfig(noise=0.1)), 0)
    instance = dataclasses.replace(empty, solids=(*empty.solids, wall, pillar), starts=(Start(0.0, 5.0),))
    scalar, room = Kinematics(instance), TensorRoom(Rooms(instance=instance))
    room.reset(torch.tensor([0]))
    radius = instance.robot.body_radius + CONTACT_SKIN
    y = 0.9 - radius - 7e-6
    x = pillar.x + math.sqrt((pillar.half_x + radius) ** 2 - (y - pillar.y) ** 2)
    heading = math.radians(177)
    state = scalar.make_state(Start(x, y), 1)._replace(
        heading_steps=round(heading // scalar.turn_step), heading_offset=heading % scalar.turn_step)
    for noise_key in range(10):
        room.set_room_state(0, state._replace(noise_key=noise_key))
        room.step(torch.tensor([0]))  # forward
        found, expected = room.get_room_state(0), scalar.step(state._replace(noise_key=noise_key), 0).state
        assert abs(found.x - expected.x) < 1e-5 and abs(found.y - expected.y) < 1e-5


def test_a_wall_that_the_body_leaves_does_not_hold_it():
    """Nearly as far behind it as it moves, so that the contact is near the share that no solid limits.

    It is the first solid, which is the one whose contact is refined where none limits.
    """
    wall = Solid(x=0, y=1, half_x=10, half_y=0.1)
    empty = generate(RoomConfig(), 0)
    instance = dataclasses.replace(empty, solids=(wall, *empty.solids), starts=(Start(0.0, 5.0),))
    scalar, room = Kinematics(instance), TensorRoom(Rooms(instance=instance))
    room.reset(torch.tensor([0]))
    away = round(math.radians(270) / scalar.turn_step)
    for behind in (0.9992, 0.9995, 0.9999):
        y = 0.9 - instance.robot.body_radius - CONTACT_SKIN - behind
        room.set_room_state(0, scalar.make_state(Start(0.0, y), 1)._replace(heading_steps=away))
        room.step(torch.tensor([0]))  # forward
        assert room.get_room_state(0).y == pytest.approx(y - instance.robot.move_step, abs=1e-9)
