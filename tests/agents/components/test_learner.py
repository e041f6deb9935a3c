"""Gradient descent says where it diverges, also where the run would go on to its end."""

import math
import pickle
import warnings

import numpy as np
import pytest
import torch

from hrl_escape.agents.algorithms.dqn import DQNSettings
from hrl_escape.agents.components.networks import Learner, Network
from hrl_escape.errors import DivergenceError


def make(**settings):
    torch.manual_seed(0)
    network = Network(torch.nn.Linear(2, 1))
    return network, Learner("dqn", {"values": network}, ["values"], DQNSettings(**{"learning_rate": 1e-3} | settings))


def test_a_loss_that_has_diverged_is_told_once_with_its_gradient():
    network, learner = make(max_grad_norm=0.0)
    with pytest.warns(UserWarning, match=r"dqn diverges: its loss is .*e\+\d+ and the norm of its gradient .*Lower"):
        learner.minimise(1e9 * network(torch.ones(1, 2)).square().mean())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        learner.minimise(1e9 * network(torch.ones(1, 2)).square().mean())


def test_a_gradient_that_is_not_finite_moves_no_weight():
    network, learner = make()
    before = network.weights.clone()
    with pytest.raises(DivergenceError, match="the gradient of dqn is no longer finite, of norm nan") as raised:
        learner.minimise((network(torch.ones(1, 2)) * 0).sqrt().sum())
    assert torch.equal(network.weights, before) and math.isnan(raised.value.gradient_norm)
    again = pickle.loads(pickle.dumps(raised.value))
    assert str(again) == str(raised.value)


def test_an_ordinary_loss_is_not_warned_of():
    network, learner = make(learning_rate=0.1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        losses = [learner.minimise((network(torch.ones(1, 2)) - 3).square().mean()) for _ in range(200)]
    assert losses[-1] < 1e-3 < losses[0] and np.isfinite(losses).all()
