"""The engines agree: random primitives in every kind of room, batched engine against scalar rules and Bullet.

A small version of `benchmarks/conformance.py`, which has the full one.
"""

import numpy as np
import pytest
import torch

from benchmarks.conformance import compare
from hrl_escape.env.bullet_room import BulletRoom
from hrl_escape.env.generation import generate
from hrl_escape.env.tensor_room import TensorRoom
from tests.env.rooms import all_schematics

KINEMATIC = sorted(name for name, config in all_schematics().items() if config.dynamics.kind == "kinematic")


@pytest.mark.parametrize("name", KINEMATIC)
def test_the_batched_engine_agrees_with_the_scalar_rules(name):
    instances = [generate(all_schematics()[name], seed) for seed in range(1 if name == "largest" else 3)]
    found = compare(instances, 1500, copies=15)
    assert found.primitives >= 1500
    assert not found.disagreements, found.disagreements[0]
    assert found.close_calls <= 1
    assert found.worst < 1e-9


@pytest.mark.parametrize("name", ["paper-two-button", "arm-two-button", "clutter", "noisy"])
def test_the_batched_engine_agrees_with_the_bullet_engine(name):
    instance = generate(all_schematics()[name], 1)
    batch, bullet = TensorRoom([instance], 1, autoreset="disabled"), BulletRoom(instance)
    batch.reset(torch.tensor([4]))
    bullet.set_state(batch.get_room_state(0))
    for action in np.random.default_rng(0).integers(batch.actions, size=300).tolist():
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
