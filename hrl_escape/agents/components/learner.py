"""Gradient descent on networks: Adam, clipping, the check for divergence, and a checkpoint of it all."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Mapping

import numpy as np
import torch
from torch import nn

from hrl_escape.agents.components.networks import Network, NetworkSettings
from hrl_escape.agents.state import StateTree
from hrl_escape.errors import CheckpointError, DivergenceError

__all__ = ["Learner"]

WILD_LOSS = 1e6
"""Loss beyond which values have diverged: in scaled rewards, where losses are a few hundred at most."""
WILD_GROWTH, GROWTH_EVERY = 100.0, 50
"""Growth of the weights' norm beyond which steps are too long, and updates between two looks at it."""


class Learner:
    """Gradient descent on some networks: Adam, clipping, the check for divergence, and its checkpoint.

    Args:
        name: the algorithm's name, for messages.
        networks: named networks that the checkpoint holds.
        trained: those whose parameters this optimiser moves.
        settings: learning rate and clipping.

    Attributes:
        updates: steps made.
        gradient_norm: Euclidean norm of the last step's gradient, before it was clipped.
    """

    def __init__(
        self, name: str, networks: Mapping[str, Network], trained: Iterable[str], settings: NetworkSettings
    ) -> None:
        self.name, self.updates, self.gradient_norm, self._is_wild = name, 0, 0.0, False
        self._networks = networks
        self._max_norm = settings.max_grad_norm
        self._trained = [networks[key] for key in trained]
        self._first_norm = self._measure_weights()
        self._inputs = [parameter for network in self._trained for parameter in network.parameters()]
        self._settings = settings
        self._optimiser = self._make_optimiser()

    def _make_optimiser(self) -> torch.optim.Adam:
        vectors = [nn.Parameter(network.weights) for network in self._trained]
        for vector, network in zip(vectors, self._trained, strict=True):
            vector.grad = network.gradient
        return torch.optim.Adam(vectors, lr=self._settings.learning_rate, eps=self._settings.adam_epsilon, fused=True)

    def move(self, device: torch.device) -> None:
        """Move networks and optimiser to a device."""
        if all(network.weights.device == device for network in self._networks.values()):
            return
        state = self.state_dict()
        for network in self._networks.values():
            network.move(device)
        self._inputs = [parameter for network in self._trained for parameter in network.parameters()]
        self._optimiser = self._make_optimiser()
        self.load_state_dict(state)

    def minimise(self, loss: torch.Tensor) -> float:
        """One step down the gradient; returns the loss.

        Raises:
            DivergenceError: the loss or its gradient is NaN or infinite; the weights are left alone.
        """
        value = loss.item()
        if not math.isfinite(value):
            raise DivergenceError(self.name, self.updates, loss=value)
        for network in self._trained:
            network.gradient.zero_()
        loss.backward(inputs=self._inputs)
        self.gradient_norm = norm = math.hypot(*(network.gradient.norm().item() for network in self._trained))
        if not math.isfinite(norm):
            raise DivergenceError(self.name, self.updates, loss=value, gradient_norm=norm)
        if not self._is_wild and (reason := self._find_divergence(value)) is not None:
            self._is_wild = True
            warnings.warn(f"{self.name} diverges: {reason}its loss is {value:.3g} and the norm of its gradient "
                          f"{norm:.3g} (update {self.updates}). Lower learning_rate, or reward_scale where rewards are "
                          "large", stacklevel=2)
        if self._max_norm and norm > self._max_norm:
            for network in self._trained:
                network.gradient.mul_(self._max_norm / norm)
        self._optimiser.step()
        self.updates += 1
        return value

    def minimise_each(self, losses: Iterable[Mapping[str, torch.Tensor]]) -> dict[str, float]:
        """One step down the first part of each, taken before the next is asked for; returns the means of all parts."""
        totals: dict[str, torch.Tensor] = {}
        count = 0
        for parts in losses:
            self.minimise(next(iter(parts.values())))
            totals = {name: totals.get(name, 0.0) + part.detach() for name, part in parts.items()}
            count += 1
        return {name: float(total) / count for name, total in totals.items()}

    def _measure_weights(self) -> float:
        return math.hypot(*(network.weights.norm().item() for network in self._trained))

    def _find_divergence(self, loss: float) -> str | None:
        """Reason to say that learning diverges, as the beginning of a sentence; None if there is none."""
        if abs(loss) > WILD_LOSS:
            return ""
        if self.updates % GROWTH_EVERY or not self._first_norm:
            return None
        growth = self._measure_weights() / self._first_norm
        return f"its weights have grown {growth:.0f} times since they were drawn, " if growth > WILD_GROWTH else None

    def state_dict(self) -> StateTree:
        """Weights, optimiser moments and the counter, as arrays."""
        moments = self._optimiser.state_dict()["state"]
        return {
            "updates": self.updates,
            "weights": {name: network.weights.cpu().numpy() for name, network in self._networks.items()},
            "moments": [{key: tensor.cpu().numpy() for key, tensor in moments[index].items()}
                        for index in sorted(moments)],
        }

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`.

        Raises:
            CheckpointError: it belongs to networks of another size.
        """
        self.updates = int(state["updates"])
        for name, network in self._networks.items():
            weights = torch.from_numpy(state["weights"][name])
            if weights.shape != network.weights.shape:
                raise CheckpointError(
                    f"the checkpoint's {name} network of {self.name} has {len(weights)} weights; "
                    f"this agent's has {len(network.weights)}"
                )
            network.weights.copy_(weights)
        moments = {
            index: {key: torch.from_numpy(np.asarray(value)) for key, value in group.items()}
            for index, group in enumerate(state["moments"])
        }
        groups = self._optimiser.state_dict()["param_groups"]
        self._optimiser.load_state_dict({"state": moments, "param_groups": groups})
