"""Observations in tensors against those of the scalar rules, layout by layout."""

import numpy as np
import pytest
import torch

from hrl_escape.env.batched.engine import TensorRoom
from hrl_escape.env.batched.rooms import Rooms
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.observations.base import list_observations, make_observer
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import UnknownNameError, UnsupportedError
from tests.covering import cover
from tests.env.rooms import all_configs

KINDS = sorted(observation.name for observation in list_observations() if observation.is_vector)
NAMES = ["paper-two-button", "arm-two-button", "clutter", "bit-flip", "noisy", "door", "sixty-four-buttons"]


@pytest.mark.nightly_for(
    "paper-two-button-egocentric", "clutter-objects", "noisy-egocentric", "sixty-four-buttons-objects",
    "door-features", "arm-two-button-features")
@pytest.mark.parametrize(("name", "kind"), cover(NAMES, KINDS))
def test_observations_are_those_of_the_scalar_rules(name, kind):
    instances = [generate(all_configs()[name], seed) for seed in range(2)]
    room = TensorRoom(Rooms(8, instance=instances, observation=kind))
    observers = [make_observer(kind, Kinematics(instance)) for instance in instances]
    room.reset(torch.arange(8))
    rng, blurred, total = np.random.default_rng(0), 0, 0
    for _ in range(60):
        seen = room.step(torch.from_numpy(rng.integers(room.actions, size=8))).observation
        for number, row in enumerate(seen.numpy()):
            expected = observers[number % 2].observe(room.get_room_state(number))
            assert row.dtype == expected.dtype == np.float32
            assert row.shape == expected.shape
            far = np.abs(row - expected) > 2e-5  # single precision; a lidar ray may pass an edge on either side
            blurred, total = blurred + far.sum(), total + far.size
            assert not far[: -16 if kind == "egocentric" else None].any()
    assert blurred <= total / 2000


def test_every_observation_has_a_tensor_form_or_a_clear_refusal():
    instance = generate(all_configs()["paper-one-button"], 0)
    for kind in KINDS:
        TensorRoom(Rooms(2, instance=instance, observation=kind))
    with pytest.raises(UnsupportedError, match="vectorization_mode='sync'"):
        TensorRoom(Rooms(2, instance=instance, observation="pixels"))
    with pytest.raises(UnknownNameError, match="features"):
        TensorRoom(Rooms(2, instance=instance, observation="feature"))


def test_standing_on_the_exits_centre_gives_a_direction():
    instance = generate(all_configs()["paper-two-button"], 0)
    room = TensorRoom(Rooms(instance=instance, observation="egocentric"))
    room.reset(torch.tensor([0]))
    x, y = instance.exit.centre
    state = room.get_room_state(0)._replace(x=x, y=y, heading_steps=3)
    room.set_room_state(0, state)
    expected = make_observer("egocentric", Kinematics(instance)).observe(state)
    assert np.abs(room.observe()[0].numpy() - expected).max() < 1e-6
