"""Box actions and their distributions against `torch.distributions`."""

import math

import numpy as np
import pytest
import torch
from gymnasium import spaces
from torch.distributions import Normal, TanhTransform

from hrl_escape.agents.components.arrays import Arrays
from hrl_escape.agents.components.box_actions import BoxActions
from hrl_escape.agents.components.distributions import GaussianHead, draw_squashed
from hrl_escape.errors import UnsupportedSpaceError

BOX = spaces.Box(np.array([-1.0, 0.0, 5.0], np.float32), np.array([1.0, 4.0, 6.0], np.float32))


def test_squashed_log_densities_are_those_of_torch():
    generator = torch.Generator().manual_seed(0)
    outputs = torch.randn((200, 6), generator=generator).double()
    noise = torch.randn((200, 3), generator=generator).double()
    points, log_density = draw_squashed(outputs, noise)
    mean, log_std = outputs[:, :3], outputs[:, 3:].clamp(max=2.0)
    raw = mean + log_std.exp() * noise
    exact = Normal(mean, log_std.exp()).log_prob(raw) - TanhTransform().log_abs_det_jacobian(raw, raw.tanh())
    assert torch.allclose(log_density, exact.sum(1)) and torch.allclose(points, raw.tanh())


def test_squashed_log_densities_are_finite_and_exact_where_tanh_is_one():
    outputs = torch.tensor([[20.0, 0.0]], requires_grad=True)
    point, log_density = draw_squashed(outputs, torch.zeros(1, 1))
    assert point.item() == 1.0
    assert log_density.item() == pytest.approx(-math.log(2 * math.pi) / 2 - 2 * (math.log(2) - 20), rel=1e-6)
    log_density.sum().backward()
    assert outputs.grad.isfinite().all()


@pytest.mark.parametrize("device", [None, torch.device("cpu")])
def test_a_gaussian_keeps_the_unclipped_choice_and_its_density(device):
    head = GaussianHead(BoxActions(BOX, "test"), 0.5)
    head.networks["spread"].weights += torch.tensor([0.0, -1.0, 1.0])
    mean = torch.linspace(-2, 2, 60).view(20, 3)
    given = mean.numpy() if device is None else mean
    action, choice, log_probability = map(torch.as_tensor, head.draw(given, None, Arrays(np.random.default_rng(0),
                                                                                        device)))
    exact = Normal(mean, head.networks["spread"].weights.exp())
    assert torch.allclose(log_probability, exact.log_prob(choice).sum(1), atol=1e-4)
    measured, entropy = head.measure(mean, None, choice)
    assert torch.allclose(measured, log_probability, atol=1e-4)
    assert entropy.item() == pytest.approx(exact.entropy().sum(1)[0].item(), rel=1e-5)
    assert (choice.abs() > 1).any() and all(map(BOX.contains, action.numpy()))


def test_boxes_are_scaled_back_and_forth_and_clipped():
    box, rng = BoxActions(BOX, "test"), np.random.default_rng(1)
    points = rng.uniform(-1, 1, (50, 3)).astype(np.float32)
    assert np.allclose(box.unscale(box.scale(points)), points, atol=1e-5)
    assert np.array_equal(box.scale(np.full((1, 3), 9.0, np.float32))[0], BOX.high)
    assert np.allclose(box.scale(torch.from_numpy(points)).numpy(), box.scale(points), atol=1e-6)


@pytest.mark.parametrize("space", [spaces.Discrete(3), spaces.Box(-np.inf, np.inf, (2,)), spaces.Box(1, 1, (2,))])
def test_other_spaces_are_refused(space):
    with pytest.raises(UnsupportedSpaceError, match="sac needs"):
        BoxActions(space, "sac")
