"""Distributions of stochastic policies: categorical over legal actions, Gaussian, and Gaussian through tanh.

`CategoricalHead` and `GaussianHead` have one interface, so PPO is written once for both action spaces. The squashed
Gaussian of SAC follows Haarnoja et al. (2018), appendix C.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from hrl_escape.agents.components.arrays import Arrays
from hrl_escape.agents.components.box_actions import BoxActions
from hrl_escape.agents.components.networks import Network
from hrl_escape.agents.components.policy_gradient import compute_entropy, compute_log_policy, take_column

_HALF_LOG_TWO_PI = math.log(2 * math.pi) / 2


class _Rows(nn.Module):
    """The same learned numbers for every row of a batch."""

    def __init__(self, values: Tensor) -> None:
        super().__init__()
        self.values = nn.Parameter(values)

    def forward(self, input: Tensor) -> Tensor:
        return self.values.expand(len(input), -1)


def make_constant(count: int, value: float) -> Network:
    """Make a network whose outputs are learned numbers, (n, count) for any n inputs, with an initial value."""
    return Network(_Rows(torch.full((count,), value)))


class CategoricalHead:
    """Softmax over legal actions.

    Attributes:
        networks: further networks that are learned, by name: none.
    """

    networks: dict[str, Network] = {}

    def draw(self, logits: Any, mask: Any, arrays: Arrays) -> tuple[Any, Any, Any]:
        """Draw from policies: the action for the environment, the choice that is learned from, its log probability.

        Args:
            logits: (n, actions), array or tensor.
            mask: bool (n, actions), legal actions.
            arrays: source of randomness.
        """
        log_policy = compute_log_policy(logits, mask)
        action = arrays.draw_choices(arrays.library.exp(log_policy))
        return action, action, take_column(log_policy, action)

    def measure(self, logits: Tensor, mask: Tensor, choice: Tensor) -> tuple[Tensor, Tensor]:
        """Return log probabilities of choices, (n,), and the mean entropy, ()."""
        log_policy = compute_log_policy(logits, mask)
        return take_column(log_policy, choice), compute_entropy(log_policy, mask)


def _measure_normal(noise: Any, log_std: Any) -> Any:
    """Return the log density of each component of mu + sigma noise, of the noise's shape."""
    return -(noise**2 / 2 + log_std + _HALF_LOG_TWO_PI)


class GaussianHead:
    """Normal distribution with a learned standard deviation for each component, the same in all states.

    Choices are points around [-1, 1]^n; the environment receives them clipped and scaled, and the log probability is
    that of the unclipped point.

    Args:
        box: bounds of the actions.
        log_std: initial logarithm of the standard deviation.

    Attributes:
        networks: the logarithms of the standard deviations, as `spread`.
    """

    def __init__(self, box: BoxActions, log_std: float) -> None:
        self._box = box
        self.networks = {"spread": make_constant(box.size, log_std)}

    def draw(self, mean: Any, mask: Any, arrays: Arrays) -> tuple[Any, Any, Any]:
        """Draw from policies; see `CategoricalHead.draw`. Means are (n, size), masks are ignored."""
        log_std: Any = self.networks["spread"].weights
        if isinstance(mean, np.ndarray):
            log_std = log_std.numpy()
        noise = arrays.draw_normal(*mean.shape)
        choice = mean + arrays.library.exp(log_std) * noise
        return self._box.scale(choice), choice, _measure_normal(noise, log_std).sum(-1)

    def measure(self, mean: Tensor, mask: Tensor, choice: Tensor) -> tuple[Tensor, Tensor]:
        """Return log densities of choices, (n,), and the entropy, ()."""
        log_std = self.networks["spread"](mean)
        noise = (choice - mean) * (-log_std).exp()
        return _measure_normal(noise, log_std).sum(-1), (log_std + 0.5 + _HALF_LOG_TWO_PI).sum(-1).mean()


LOG_STD_RANGE = -20.0, 2.0
"""Bounds of the logarithm of the standard deviation of a squashed Gaussian, as in Haarnoja et al. (2018)."""


def draw_squashed(outputs: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """Return a = tanh(mu + sigma eps) and log pi(a), with gradients through both.

    log pi(a) = sum of log N(u; mu, sigma) - log(1 - tanh(u)^2), u = mu + sigma eps, and
    log(1 - tanh(u)^2) = 2 (log 2 - u - softplus(-2u)), which is exact for large u.

    Args:
        outputs: means, then logarithms of standard deviations, (n, 2 size).
        noise: eps, standard normal, (n, size).

    Returns:
        Actions in (-1, 1), (n, size), and log densities, (n,).
    """
    mean, log_std = outputs.chunk(2, dim=-1)
    log_std = log_std.clamp(*LOG_STD_RANGE)
    raw = mean + log_std.exp() * noise
    log_slope = 2 * (math.log(2) - raw - functional.softplus(-2 * raw))
    return raw.tanh(), (_measure_normal(noise, log_std) - log_slope).sum(-1)
