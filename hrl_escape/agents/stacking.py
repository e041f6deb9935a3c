"""Several networks of the same layers as one batched network, and their gradient steps as one.

Weights become (trials, parameters), activations (trials, batch, units), each layer one batched matrix product. Every
agent keeps its own network, optimiser state and checkpoint: rows are copied together for an update, and Adam moves the
agents' own vectors. Perceptrons only.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from hrl_escape.agents.networks import Learner, Network
from hrl_escape.agents.updates import Metrics
from hrl_escape.errors import DivergenceError, UnsupportedSpaceError

__all__ = ["JointLearner", "NetworkStack", "finish_updates"]


class NetworkStack:
    """A function of (trials, batch, inputs) with the present weights of several networks.

    Args:
        networks: of the same layers, one a trial.
        with_gradient: whether `weights` collects a gradient.

    Attributes:
        weights: float32 (trials, parameters), a copy.
    """

    def __init__(self, networks: Sequence[Network], with_gradient: bool = False) -> None:
        self._layers = list(networks[0])
        self._sizes = networks[0].sizes
        self.weights = torch.stack([network.weights for network in networks]).requires_grad_(with_gradient)

    def __call__(self, values: Tensor) -> Tensor:
        """The outputs, (trials, batch, outputs)."""
        pieces = iter(self.weights.split(self._sizes, dim=1))
        for layer in self._layers:
            if isinstance(layer, nn.Linear):
                weight = next(pieces).unflatten(1, (layer.out_features, layer.in_features))
                values = torch.baddbmm(next(pieces).unsqueeze(1), values, weight.transpose(1, 2))
            else:
                values = layer(values)
        return values


class JointLearner:
    """One Adam over the networks of several learners, each with its own moments and count of steps.

    Args:
        learners: of the same settings, each training one network.

    Raises:
        UnsupportedSpaceError: the networks have other layers than linear ones, ReLU and tanh.
    """

    def __init__(self, learners: Sequence[Learner]) -> None:
        if not all(isinstance(layer, (nn.Linear, nn.ReLU, nn.Tanh)) for layer in learners[0].trained[0]):
            raise UnsupportedSpaceError("trials at once need vector observations: for pictures train each seed alone")
        self._learners = learners
        self._max_norm = learners[0].max_norm
        self._vectors = [learner.vectors[0] for learner in learners]
        self._optimiser = torch.optim.Adam(self._vectors, **learners[0].adam)
        for learner, vector in zip(learners, self._vectors, strict=True):
            self._optimiser.state[vector] = learner.optimiser.state[vector]  # shared: it stays the learner's own

    def minimise(self, losses: Tensor, stack: NetworkStack) -> list[float | DivergenceError]:
        """One step down the gradient of each learner's loss; returns the losses.

        Args:
            losses: (trials,), each a function of its own row of `stack.weights`.
            stack: the networks these learners train.
        """
        values = losses.tolist()
        (gradient,) = torch.autograd.grad(losses.sum(), stack.weights)
        if self._max_norm:
            gradient.mul_((self._max_norm / gradient.norm(dim=1, keepdim=True)).clamp_(max=1.0))
        results: list[float | DivergenceError] = []
        for learner, vector, row, value in zip(self._learners, self._vectors, gradient.unbind(), values, strict=True):
            if math.isfinite(value):
                vector.grad = row
                learner.updates += 1
                results.append(value)
            else:
                vector.grad = None  # Adam passes it over
                results.append(DivergenceError(learner.name, learner.updates))
        self._optimiser.step()
        for learner in self._learners:
            learner.reset_gradient()
        return results


def finish_updates(
    outcomes: Sequence[float | DivergenceError],
    values: Tensor,
    reward_scale: float,
    blend: Sequence[Callable[[], None]],
) -> list[Metrics | DivergenceError]:
    """Move each trial's target network and tell its metrics; a trial that diverged is left as it is.

    Args:
        outcomes: (trials,), what `JointLearner.minimise` gave.
        values: (trials, batch), the values that were trained, in scaled rewards.
        reward_scale: of the agents' settings.
        blend: moves a trial's target network.
    """
    results: list[Metrics | DivergenceError] = []
    for outcome, mean, move in zip(outcomes, values.mean(dim=-1).tolist(), blend, strict=True):
        if isinstance(outcome, DivergenceError):
            results.append(outcome)
            continue
        move()
        results.append({"loss": outcome, "value": mean / reward_scale})
    return results
