"""Rainbow: `dqn` with distributions of returns, dueling streams, priorities and, if asked for, noisy weights.

Hessel et al. (2018), on SMDP backups. Its parts are those of Bellemare, Dabney and Munos (2017), Wang et al. (2016),
Schaul et al. (2016) and Fortunato et al. (2018); double estimation and backups of n decisions are `dqn`'s own. With all
four off it is `dqn` to the bit.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from hrl_escape.agents.agent import GoalRule, count_actions
from hrl_escape.agents.algorithms.dqn import DQN, DQNSettings
from hrl_escape.agents.components.exploration import make_rng
from hrl_escape.agents.components.networks import (
    NoisyLinear,
    ObservationEncoder,
    make_generator,
    make_linear,
    make_network,
)
from hrl_escape.agents.components.replay import Experience, Priorities
from hrl_escape.errors import AgentSettingsError
from hrl_escape.settings import Range


@dataclass(frozen=True)
class RainbowSettings(DQNSettings):
    """The parts that `dqn` does not have.

    Defaults are those of the paper but for the support, `importance` and the noise, which costs networks of this size
    more than it explores (`benchmarks/README.md`).
    """

    noise: Annotated[float, Range(0)] = 0.0
    """sigma_0 of the noise in the weights, drawn for each decision in place of epsilon: its standard deviation at the
    beginning, times the square root of a layer's inputs; 0.5 in the paper. 0 has none, and explores as `dqn` does."""
    dueling: bool = True
    """Separate streams for the state and for the advantages of actions."""
    atoms: Annotated[int, Range(1)] = 51
    """Returns whose probabilities are learned, evenly spaced from `lowest_return` to `highest_return`; 1 learns the
    mean alone, without bounds."""
    lowest_return: float | None = None
    """The lowest atom, in units of return. None is -1 / (1 - gamma), that of a reward of -1 for ever."""
    highest_return: float = 100.0
    """The highest atom, in units of return: the reward of an exit. Returns beyond the atoms count as the nearest."""
    priority_exponent: Annotated[float, Range(0)] = 0.5
    """omega: decisions are drawn from replay in proportion to their latest loss to this power; 0 draws uniformly."""
    importance: Annotated[float, Range(0, 1)] = 0.4
    """beta at the beginning, the power to which weights undo the priorities; it rises linearly to 1."""
    importance_steps: Annotated[int, Range(1)] = 100_000
    """Steps of the clock over which `importance` rises."""

    @property
    def bounds(self) -> tuple[float, float]:
        """Lowest and highest atom, in units of return."""
        low = -1 / max(1 - self.gamma, 1e-12) if self.lowest_return is None else self.lowest_return
        return low, self.highest_return

    @property
    def has_own_network(self) -> bool:
        """Dueling, atoms or noise ask for layers that a network of one number an action does not have."""
        return self.dueling or self.atoms > 1 or self.noise > 0

    def check(self) -> None:
        """Refuse bounds that are none, and rows of objects in the network's own layers."""
        low, high = self.bounds
        if self.atoms > 1 and (not low < high or self.gamma == 1 and self.lowest_return is None):
            raise AgentSettingsError("RainbowSettings.lowest_return", self.lowest_return,
                                     f"a number below highest_return = {high:g}; gamma = 1 gives none")
        if self.has_own_network and (self.network != "mlp" or not self.hidden):
            raise AgentSettingsError("RainbowSettings.network", f"{self.network}, hidden = {self.hidden}", "mlp of at "
                                     "least one hidden layer; or dueling = False, atoms = 1, noise = 0")


def project(reward: Tensor, bootstrap: Tensor, shares: Tensor, support: Tensor) -> Tensor:
    """Probabilities of R + b Z on the atoms of Z, each moved atom shared by its two neighbours (C51, algorithm 1).

    R and b, the product of gamma^k of the decisions joined, are (batch,), the probabilities `shares` of Z (batch,
    atoms), as the result, whose rows sum to 1; `support` are the atoms, evenly spaced. What lies beyond them counts as
    their end.
    """
    moved = (reward[:, None] + bootstrap[:, None] * support).clamp(support[0], support[-1])
    place = (moved - support[0]) / (support[1] - support[0])
    # A triangle of width 1 round each atom, so that a place on an atom is no case of its own.
    near = (1 - (place[:, :, None] - torch.arange(len(support), device=support.device)).abs()).clamp(min=0)
    return torch.einsum("bi,bij->bj", shares, near)


class ReturnLayers(nn.Module):
    """Layers from encoded observations to the returns of all actions: dueling, by atoms, under noise, as settings say.

    Attributes:
        support: atoms in scaled rewards, (atoms,).
    """

    support: Tensor

    def __init__(self, encoder: ObservationEncoder, actions: int, settings: RainbowSettings,
                 generator: torch.Generator) -> None:
        super().__init__()
        self._actions, is_tanh = actions, settings.initialisation == "orthogonal"
        activation = nn.Tanh if is_tanh else nn.ReLU
        shared = replace(settings, hidden=settings.hidden[:-1], dueling=False, atoms=1, noise=0.0)
        made: Any = make_network(encoder, 1, shared, generator)
        *body, last = made
        width = int(last.weight.shape[1])
        gain = nn.init.calculate_gain("tanh" if is_tanh else "relu")

        def make(inputs: int, outputs: int, factor: float) -> nn.Module:
            linear = make_linear(inputs, outputs, settings.initialisation, generator, factor)
            return NoisyLinear(linear, settings.noise) if settings.noise else linear

        def make_stream(outputs: int) -> nn.Module:
            units = settings.hidden[-1]
            return nn.Sequential(make(width, units, gain), activation(), make(units, outputs, 1.0))

        self.body, self.advantage = nn.Sequential(*body), make_stream(actions * settings.atoms)
        self.state = make_stream(settings.atoms) if settings.dueling else None
        low, high = (bound * settings.reward_scale for bound in settings.bounds)
        self.register_buffer("support", torch.linspace(low, high, settings.atoms), persistent=False)

    def compute_logits(self, observation: Tensor) -> Tensor:
        """Logits of the atoms, or values where there is one, (n, actions, atoms)."""
        hidden = self.body(observation)
        advantage = self.advantage(hidden).unflatten(1, (self._actions, -1))
        if self.state is None:
            return advantage
        return self.state(hidden)[:, None] + advantage - advantage.mean(dim=1, keepdim=True)

    def forward(self, observation: Tensor) -> Tensor:
        """Means of the returns, in scaled rewards, (n, actions)."""
        logits = self.compute_logits(observation)
        return logits.squeeze(2) if logits.shape[2] == 1 else logits.softmax(dim=2) @ self.support


class Rainbow(DQN):
    """Minimise the mean of w KL(projected R + b Z_target(s', o*) || Z_theta(s, o)), o* as in `dqn`.

    Z are distributions of returns over `atoms`, Q their means; w undoes the priorities with which decisions are drawn.
    R and b are those of an SMDP backup of `n_step` decisions, so that an option shrinks the support by its own gamma^k.
    With one atom the loss is that of `dqn`. Evaluation follows the means of noisy weights.
    """

    Settings: ClassVar[type] = RainbowSettings
    settings: Any
    STATE = ("_priorities", "_noise_rng")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: RainbowSettings | None = None, goal_rule: GoalRule | None = None,
                 network: nn.Module | None = None) -> None:
        settings = settings or RainbowSettings()
        if settings.has_own_network:
            if network is not None:
                raise AgentSettingsError("network", type(network).__name__, "none, with dueling, atoms or noise")
            network = ReturnLayers(ObservationEncoder(observation_space, settings.scale_observations),
                                   count_actions(action_space, self.name), settings,
                                   make_generator(make_rng(seed, "weights")))
        super().__init__(observation_space, action_space, seed, settings, goal_rule, network)
        self._priorities = Priorities(settings.priority_exponent)
        self._drawn: tuple[NDArray[np.int64], NDArray[np.float32]] | None = None
        self._noise_rng = make_generator(make_rng(seed, "noise"))

    @contextmanager
    def _draw_noise(self) -> Iterator[None]:
        """Noise in the online and the target network; afterwards there is none, and evaluation follows the means."""
        layers = [layer for network in (self.values.online, self.values.target) for layer in network.modules()
                  if isinstance(layer, NoisyLinear)]
        for layer in layers:
            layer.draw(self._noise_rng)
        yield
        for layer in layers:
            layer.draw(None)

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Explore as the settings say, by the online network."""
        with self._draw_noise():
            return super().act(observation, action_mask)

    def compute_scores(self, encoded: Tensor) -> Tensor:
        """Values of the online network under one noise, in units of return, (n, actions)."""
        with self._draw_noise():
            return super().compute_scores(encoded)

    def begin_streams(self, count: int, device: torch.device) -> None:
        """Begin episodes in all streams; their replay has priorities of its own."""
        before = self._streams
        super().begin_streams(count, device)
        if self._streams is not before:
            self._priorities = Priorities(self.settings.priority_exponent)

    def draw(self, replay: Any, batch: int, rng: Any) -> Experience:
        """A batch by priorities, whose rows and weights are noted for the update."""
        settings = self.settings
        if not settings.priority_exponent:
            return super().draw(replay, batch, rng)
        progress = min(self._schedule.steps / settings.importance_steps, 1.0)
        beta = settings.importance + progress * (1 - settings.importance)
        self._drawn = self._priorities.draw(replay, batch, beta, self._replay_rng)
        return replay.take(self._drawn[0])

    def compute_targets(self, batch: Experience) -> Tensor:
        """Projected distributions of R + b Z_target(s', o*), (batch, atoms); with one atom its value, (batch,)."""
        if self.settings.atoms == 1:
            return super().compute_targets(batch)
        layers: Any = self.values.target[0]
        shares = layers.compute_logits(batch.next_observation).softmax(dim=2)
        best = self.choose_next(batch, shares @ layers.support)
        return project(batch.reward, batch.bootstrap, shares[torch.arange(len(best)), best.squeeze(1)], layers.support)

    def compute_losses(self, batch: Experience, targets: Tensor) -> tuple[Tensor, Tensor]:
        """Loss of each decision against its target, (batch,), and Q_theta(s, o), (batch,), without gradient."""
        if self.settings.atoms == 1:
            values = self.values.online(batch.observation).gather(1, batch.action.unsqueeze(1)).squeeze(1)
            if self.settings.loss == "huber":
                return functional.smooth_l1_loss(values, targets, reduction="none"), values.detach()
            return 0.5 * (values - targets) ** 2, values.detach()
        layers: Any = self.values.online[0]
        logits = layers.compute_logits(batch.observation)[torch.arange(len(targets)), batch.action]
        known = torch.special.xlogy(targets, targets) - targets * logits.log_softmax(dim=1)
        return known.sum(dim=1), logits.detach().softmax(dim=1) @ layers.support

    def update(self, batch: Experience, *known: Any) -> dict[str, float]:
        """One gradient step on a batch, weighted as it was drawn; returns numbers to log."""
        drawn, self._drawn = self._drawn, None
        if drawn is None and not self.settings.has_own_network:
            return super().update(batch)
        tensors = Experience(*map(torch.as_tensor, batch))
        with self._draw_noise():
            with torch.no_grad():
                targets = self.compute_targets(tensors)
            losses, values = self.compute_losses(tensors, targets)
            weights = 1.0 if drawn is None else torch.from_numpy(drawn[1]).to(losses.device)
            metrics = self.values.descend((losses * weights).mean(), values)
        if drawn is not None:
            self._priorities.set(drawn[0], losses.detach().cpu().numpy())
        return metrics
