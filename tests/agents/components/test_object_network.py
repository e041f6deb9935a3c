"""Deep sets over rows of objects: exact equivariance, other numbers of objects, and use by dqn and ppo."""

import copy
import gc
import pickle
import weakref

import numpy as np
import pytest
import torch
from gymnasium import spaces

from hrl_escape.agents.algorithms.dqn import DQNSettings
from hrl_escape.agents.algorithms.ppo import PPOSettings
from hrl_escape.agents.components.networks import (
    MOST_KNOWN,
    ObservationEncoder,
    make_action_network,
    make_generator,
    make_state_network,
)
from hrl_escape.agents.making import make_agent
from hrl_escape.errors import UnsupportedSpaceError
from hrl_escape.spaces import ObjectsBox, PointingDiscrete

WORDS = ("present", "ahead", "left", "lit")
ROWS = ("a", "b", "c", "d", "exit")
ABOUT = (None, None, "a", "b", "c", "d", "exit", "b")


def make_space(rows=ROWS, context=2):
    high = np.ones(len(rows) * len(WORDS) + context, np.float32)
    return ObjectsBox(-high, high, rows, WORDS)


def make_observation(rng, batch=7):
    """Random rows, some of them absent, and a random context."""
    rows = rng.uniform(-1, 1, (batch, len(ROWS), len(WORDS))).astype(np.float32)
    rows[:, :, 0] = 1.0
    rows[: batch // 2, 2] = 0.0
    return rows, rng.uniform(-1, 1, (batch, 2)).astype(np.float32)


def flatten(rows, context):
    return torch.from_numpy(np.concatenate([rows.reshape(len(rows), -1), context], axis=1))


@pytest.mark.parametrize("settings", [DQNSettings(network="objects", hidden=(16, 16, 8)),
                                      PPOSettings(network="objects", hidden=(12,))])
def test_permuting_the_objects_permutes_the_values_of_actions_about_them(settings):
    rng = np.random.default_rng(0)
    encoder, generator = ObservationEncoder(make_space(), True), make_generator(rng)
    network = make_action_network(encoder, PointingDiscrete(len(ABOUT), ABOUT), settings, generator)
    critic = make_state_network(encoder, settings, generator)
    rows, context = make_observation(rng)
    order = [3, 0, 1, 2, 4]  # row i of the new observation is the old row order[i]
    with torch.no_grad():
        before, after = (network(flatten(each, context)).numpy() for each in (rows, rows[:, order]))
        values = [critic(flatten(each, context)).numpy() for each in (rows, rows[:, order])]
    np.testing.assert_allclose(after[:, 2:7], before[:, 2:7][:, order], atol=1e-6)
    np.testing.assert_allclose(after[:, :2], before[:, :2], atol=1e-6)
    np.testing.assert_allclose(values[0], values[1], atol=1e-6)
    assert np.ptp(before, axis=1).min() > 1e-3, "actions differ"
    assert np.abs(before[:, 3] - before[:, 7]).min() > 1e-5, "two actions about one object differ"


def test_absent_objects_change_nothing_and_weights_fit_any_number_of_objects():
    rng = np.random.default_rng(1)
    settings = DQNSettings(network="objects", hidden=(16, 16))
    few, many = (make_action_network(ObservationEncoder(make_space(rows), True),
                                     PointingDiscrete(len(rows), rows), settings, make_generator(rng))
                 for rows in (ROWS[2:], ROWS))
    many.blend(few, 1.0)
    rows, context = make_observation(rng)
    rows[:, :2] = 0.0
    with torch.no_grad():
        np.testing.assert_allclose(many(flatten(rows, context))[:, 2:], few(flatten(rows[:, 2:], context)), atol=1e-6)


def test_values_hang_on_the_other_objects_and_on_the_context():
    rng = np.random.default_rng(2)
    network = make_action_network(ObservationEncoder(make_space(), True), PointingDiscrete(5, ROWS),
                                  DQNSettings(network="objects"), make_generator(rng))
    rows, context = make_observation(rng)
    other = rows.copy()
    other[:, 1, 3] += 0.5
    with torch.no_grad():
        before = network(flatten(rows, context)).numpy()
        assert (np.abs(network(flatten(other, context)).numpy() - before)[:, 0] > 1e-5).all()
        assert (np.abs(network(flatten(rows, -context)).numpy() - before)[:, 0] > 1e-5).all()


@pytest.mark.parametrize("name", ["dqn", "ppo"])
def test_other_observations_are_refused_with_the_remedy(name):
    with pytest.raises(UnsupportedSpaceError, match="observation='objects'"):
        make_agent(name, spaces.Box(-1, 1, (4,)), spaces.Discrete(2), 0, network="objects")


@pytest.mark.parametrize("kind", ["objects", "mlp"])
def test_a_copy_computes_by_its_own_weights_and_a_network_is_freed_with_its_last_user(kind):
    rng = np.random.default_rng(3)
    network = make_action_network(ObservationEncoder(make_space(), True), PointingDiscrete(len(ABOUT), ABOUT),
                                  PPOSettings(network=kind, hidden=(12, 12)), make_generator(rng))
    seen = flatten(*make_observation(rng))[0].numpy().copy()
    before = network.compute(seen)
    for own in (copy.deepcopy(network), pickle.loads(pickle.dumps(network))):
        assert np.array_equal(own.compute(seen), before)
        with torch.no_grad():
            for parameter in own.parameters():
                parameter.zero_()
        assert not own.compute(seen).any() and np.array_equal(network.compute(seen), before)
    gone = weakref.ref(network)
    gc.disable()
    try:
        del network
        assert gone() is None
    finally:
        gc.enable()


@pytest.mark.nightly
def test_outputs_that_are_remembered_are_those_of_the_weights_now_and_nobody_else_s():
    rng = np.random.default_rng(2)
    settings = PPOSettings(network="objects", hidden=(12, 12))
    network = make_action_network(ObservationEncoder(make_space(), True), PointingDiscrete(len(ABOUT), ABOUT), settings,
                                  make_generator(rng))
    forward, calls = network.compute, []
    network.register_forward_hook(lambda *_: calls.append(1))
    rows, context = make_observation(rng)
    seen = [row.numpy().copy() for row in flatten(rows, context)]

    def compute(observation):
        with torch.no_grad():
            return network(torch.from_numpy(observation)[None])[0].numpy()

    first = [forward(each) for each in seen]
    first[0][:] = 0.0  # the caller's own array
    count = len(calls)
    assert all(np.array_equal(forward(each), compute(each)) for each in seen)
    assert len(calls) == count + len(seen), "of each pair only one is computed"
    for change in (lambda: network.weights.mul_(1.5), lambda: network.weights.copy_(torch.zeros_like(network.weights))):
        change()
        assert all(np.array_equal(forward(each), compute(each)) for each in seen)
    network.weights.add_(1.0)
    calls.clear()
    for number in range(MOST_KNOWN + 1):
        forward(seen[0] + np.float32(number))
    forward(seen[0] + np.float32(number))
    assert len(calls) == MOST_KNOWN + 1
    forward(seen[0])
    assert len(calls) == MOST_KNOWN + 2, "only so many are kept"
