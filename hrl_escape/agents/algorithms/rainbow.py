"""Rainbow: `dqn` with distributions of returns, dueling streams, priorities and, optionally, noisy weights.

Hessel et al. (2018), on SMDP backups. The parts come from Bellemare, Dabney and Munos (2017), Wang et al. (2016),
Schaul et al. (2016) and Fortunato et al. (2018); double estimation and backups of n decisions are part of `dqn`.
Without these four parts it equals `dqn` exactly.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from hrl_escape.agents.agent import AgentSettings, GoalRule, count_actions
from hrl_escape.agents.algorithms.dqn import DQN
from hrl_escape.agents.components.exploration import make_rng
from hrl_escape.agents.components.networks import (
    NoisyLinear,
    ObservationEncoder,
    make_generator,
    make_linear,
    make_network,
)
from hrl_escape.agents.components.replay import Experience, Priorities
from hrl_escape.agents.decisions import Moments
from hrl_escape.agents.state import Stateful
from hrl_escape.errors import AgentSettingsError
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class RainbowSettings(AgentSettings):
    """Settings of `rainbow`: its own parts, then the settings of `dqn`.

    Defaults follow the paper except for the support, `importance` and the noise. In networks of this size, noise costs
    more than it explores (`benchmarks/README.md`).
    """

    noise: Annotated[float, Range(0)] = 0.0
    """sigma_0, initial standard deviation of the noise in the weights, times the square root of a layer's inputs; 0.5
    in the paper. Noise is drawn for each decision and replaces epsilon. 0 explores as `dqn` does."""
    dueling: bool = True
    """Separate streams for the state and for the advantages of actions."""
    atoms: Annotated[int, Range(1)] = 51
    """Number of atoms: returns with learned probabilities, evenly spaced from `lowest_return` to `highest_return`. More
    are more precise; 1 learns the mean alone, without bounds."""
    lowest_return: float | None = None
    """Lowest atom, in units of return. By default -1 / (1 - gamma), the return of a reward of -1 forever."""
    highest_return: float = 100.0
    """Highest atom, in units of return: the reward of an exit. Returns beyond the atoms count as the nearest atom."""
    priority_exponent: Annotated[float, Range(0)] = 0.5
    """omega: the probability of a decision in replay is proportional to its latest loss to this power. More focuses on
    surprising decisions; 0 draws uniformly."""
    importance: Annotated[float, Range(0, 1)] = 0.4
    """beta at the beginning, the power of the weights that correct for priorities; it rises linearly to 1."""
    importance_steps: Annotated[int, Range(1)] = 100_000
    """Number of clock steps of the linear increase of `importance`."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive. Higher values look further ahead and learn more slowly."""
    discounting: Literal["primitive", "decision"] = "primitive"
    """`primitive` discounts k primitives by gamma^k. `decision` sums their rewards and discounts by gamma."""
    bootstrap_on_truncation: bool = True
    """Bootstrap from the last state of a truncated episode. False treats a truncation as a termination."""
    clock: Literal["primitive", "decision"] = "primitive"
    """Unit of warm-up, updates and epsilon. With primitives an agent over options updates as often as a flat one."""

    exploration: Literal["epsilon-greedy", "boltzmann"] = "epsilon-greedy"
    """`epsilon-greedy` draws evenly with probability epsilon. `boltzmann` draws by exp(q / temperature)."""
    epsilon_start: Annotated[float, Range(0, 1)] = 1.0
    """Epsilon at the beginning; 1 acts at random."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon from `epsilon_steps` on. More explores for longer and lowers the return of training episodes."""
    epsilon_steps: Annotated[int, Range(1)] = 5_000
    """Number of clock steps of the linear decrease of epsilon. More explores for longer."""
    temperature: Annotated[float, Range(0, open_low=True)] = 1.0
    """Temperature of `boltzmann`, in units of return. More explores more."""
    boltzmann_clip: Annotated[float, Range(0)] = 0.0
    """Bound on the size of q / temperature in `boltzmann`, as in keras-rl 0.4.2; 0 sets none."""
    bonus: Literal["counts", "distillation"] = "counts"
    """Novelty for `bonus_weight`: visits of a cell, or the error of a network that predicts a random one (Burda et al.
    2018)."""
    bonus_weight: Annotated[float, Range(0)] = 0.0
    """Largest cost of reaching known states, in units of return. More explores more; 0 turns novelty off."""
    bonus_bins: Annotated[int, Range(2)] = 5
    """Points to round a bounded component to for counting. More make finer cells with fewer visits each."""

    network: Literal["mlp", "objects"] = "mlp"
    """`mlp`: a perceptron over the whole observation. `objects`: deep sets over its rows of objects, for the
    observation `objects`."""
    hidden: tuple[Annotated[int, Range(1)], ...] = (64, 64)
    """Units of each hidden layer."""
    initialisation: Literal["torch", "glorot", "orthogonal"] = "torch"
    """Initial weights: U(+-1/sqrt(fan in)); Xavier uniform, as in Keras; or orthogonal, with tanh units."""
    scale_observations: bool = True
    """Map components with finite bounds to [-1, 1]."""
    reward_scale: Annotated[float, Range(0, open_low=True)] = 0.1
    """Factor on the rewards that networks learn. Smaller values suit larger returns."""
    learning_rate: Annotated[float, Range(0, open_low=True)] = 3e-4
    """Step size of Adam. Too large a step diverges."""
    adam_epsilon: Annotated[float, Range(0, open_low=True)] = 1e-8
    """Term in Adam's denominator; 1e-7 in Keras."""
    max_grad_norm: Annotated[float, Range(0)] = 10.0
    """Largest Euclidean norm of a gradient; larger ones are scaled down. 0 sets no limit."""
    loss: Literal["huber", "squared"] = "huber"
    """Huber loss with threshold 1 in scaled rewards, or half the squared error, which follows outliers."""

    double: bool = True
    """The online network chooses o* and the target network values it, which avoids overestimation. False takes the
    argmax of the target network."""
    n_step: Annotated[int, Range(1)] = 3
    """Decisions joined into one backup. More carry rewards back faster, and are off-policy by the share of
    exploration."""
    target_rate: Annotated[float, Range(0, 1, open_low=True)] = 1.0
    """Share of the online network blended into the target network at each of its updates; 1 copies it."""
    target_every: Annotated[int, Range(1)] = 200
    """Updates of the online network to one of the target network. Fewer follow faster and are less stable."""
    average_rate: Annotated[float, Range(0, 1)] = 0.005
    """Share of the online network blended at each update into the average that the greedy policy uses. 0 keeps no
    average."""

    replay_capacity: Annotated[int, Range(1)] = 50_000
    """Decisions kept for replay."""
    warmup: Annotated[int, Range(0)] = 500
    """Steps of the clock before the first update."""
    batch_size: Annotated[int, Range(1)] = 64
    """Decisions in an update."""
    updates_per_step: Annotated[float, Range(0)] = 0.25
    """Updates for each step of the clock. More learn more from the same experience and take longer."""
    max_updates: Annotated[int, Range(1)] = 16
    """Most updates after a step of many environments. Where more are due, minibatches grow instead. Few large ones
    learn less, because the target network follows updates."""
    replay_per_env: Annotated[int, Range(1)] = 128
    """Smallest replay capacity per environment with many environments, in decisions."""
    hindsight_goals: Annotated[int, Range(0)] = 0
    """Number of goals achieved later in its episode that each decision is stored with again (4 in Andrychowicz et al.
    2017). For environments with goals; 0 for none."""


    @property
    def bounds(self) -> tuple[float, float]:
        """Lowest and highest atom, in units of return."""
        low = -1 / max(1 - self.gamma, 1e-12) if self.lowest_return is None else self.lowest_return
        return low, self.highest_return

    @property
    def has_own_network(self) -> bool:
        """Return whether dueling, atoms or noise require more than a network of one number per action."""
        return self.dueling or self.atoms > 1 or self.noise > 0

    def check(self) -> None:
        """Check the bounds of returns, and that layers of its own are used with `mlp` only."""
        low, high = self.bounds
        if self.atoms > 1 and (not low < high or self.gamma == 1 and self.lowest_return is None):
            raise AgentSettingsError("RainbowSettings.lowest_return", self.lowest_return,
                                     f"a number below highest_return = {high:g}; gamma = 1 gives none")
        if self.has_own_network and (self.network != "mlp" or not self.hidden):
            raise AgentSettingsError("RainbowSettings.network", f"{self.network}, hidden = {self.hidden}", "mlp of at "
                                     "least one hidden layer; or dueling = False, atoms = 1, noise = 0")


def project(reward: Tensor, bootstrap: Tensor, shares: Tensor, support: Tensor) -> Tensor:
    """Project the distribution of R + b Z onto the atoms of Z; each moved atom is shared by its two neighbours.

    This is algorithm 1 of C51. R and b, the product of gamma^k of the joined decisions, are (batch,). The probabilities
    `shares` of Z and of the result are (batch, atoms), with rows of sum 1. `support` are the evenly spaced atoms.
    Values beyond them count as the nearest end.
    """
    moved = (reward[:, None] + bootstrap[:, None] * support).clamp(support[0], support[-1])
    place = (moved - support[0]) / (support[1] - support[0])
    # A triangle of width 1 around each atom, which needs no special case for values on an atom.
    near = (1 - (place[:, :, None] - torch.arange(len(support), device=support.device)).abs()).clamp(min=0)
    return torch.einsum("bi,bij->bj", shares, near)


class ReturnLayers(nn.Module):
    """Layers from encoded observations to the returns of all actions: dueling, atoms and noise as configured.

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
        """Return logits of the atoms, or values with a single atom, (n, actions, atoms)."""
        hidden = self.body(observation)
        advantage = self.advantage(hidden).unflatten(1, (self._actions, -1))
        if self.state is None:
            return advantage
        return self.state(hidden)[:, None] + advantage - advantage.mean(dim=1, keepdim=True)

    def forward(self, observation: Tensor) -> Tensor:
        """Return means of the returns, in scaled rewards, (n, actions)."""
        logits = self.compute_logits(observation)
        return logits.squeeze(2) if logits.shape[2] == 1 else logits.softmax(dim=2) @ self.support


class Rainbow(DQN):
    """Minimise the mean of w KL(projected R + b Z_target(s', o*) || Z_theta(s, o)), o* as in `dqn`.

    Z are distributions of returns over `atoms`, Q their means; w corrects for the priorities of sampling. R and b
    belong to an SMDP backup of `n_step` decisions, and an option therefore shrinks the support by its own gamma^k. With
    one atom the loss is the same as in `dqn`. Evaluation uses the means of noisy weights.
    """

    Settings: ClassVar[type] = RainbowSettings
    settings: Any
    STATE = ("_noise_rng", "_replay_rng")

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
        super().__init__(observation_space, action_space, seed, settings, goal_rule, network)  # type: ignore[arg-type]
        self._drawn: tuple[NDArray[np.int64], NDArray[np.float32]] | None = None
        self._noise_rng = make_generator(make_rng(seed, "noise"))

    @contextmanager
    def _draw_noise(self) -> Iterator[None]:
        """Use noise in the online and the target network during the block; evaluation uses the means."""
        layers = [layer for network in (self.values.online, self.values.target) for layer in network.modules()
                  if isinstance(layer, NoisyLinear)]
        for layer in layers:
            layer.draw(self._noise_rng)
        yield
        for layer in layers:
            layer.draw(None)

    def act(self, batch: Moments) -> Any:
        """Explore by the online network, with one noise for all rows, int64 (n,)."""
        with self._draw_noise():
            return super().act(batch)

    def get_exploration(self) -> dict[str, float]:
        """Return parameters of exploration; epsilon is 0 if noise in the weights explores."""
        return super().get_exploration() | ({"epsilon": 0.0} if self.settings.noise else {})

    def make_replay(self, num_envs: int, device: torch.device | None) -> None:
        """Make an empty replay with priorities of its rows."""
        super().make_replay(num_envs, device)
        self._priorities = Priorities(self.settings.priority_exponent)
        self._replay_rng = make_rng(self._seed, "replay")

    def list_running(self) -> dict[str, Stateful]:
        """Return parts that belong to the current environments, by their names in a checkpoint."""
        return super().list_running() | {"priorities": self._priorities}

    def draw(self, size: int) -> Experience:
        """Draw a batch by priorities; its rows and weights are stored for the update."""
        settings = self.settings
        if not settings.priority_exponent:
            return super().draw(size)
        progress = min(self._schedule.steps / settings.importance_steps, 1.0)
        self._drawn = self._priorities.draw(self.replay, size,
                                            settings.importance + progress * (1 - settings.importance),
                                            self._replay_rng)
        return self.replay.take(self._arrays.restore(self._drawn[0]))

    def compute_targets(self, batch: Experience) -> Tensor:
        """Return projected distributions of R + b Z_target(s', o*), (batch, atoms), or values (batch,) for one atom."""
        if self.settings.atoms == 1:
            return super().compute_targets(batch)
        layers: Any = self.values.target[0]
        shares = layers.compute_logits(batch.next_observation).softmax(dim=2)
        best = self.choose_next(batch, shares @ layers.support)
        return project(batch.reward, batch.bootstrap, shares[torch.arange(len(best)), best.squeeze(1)], layers.support)

    def compute_losses(self, batch: Experience, targets: Tensor) -> tuple[Tensor, Tensor]:
        """Return each decision's loss against its target, (batch,), and Q_theta(s, o), (batch,), without gradient."""
        if self.settings.atoms == 1:
            values = self.values.online(batch.observation).gather(1, batch.action.unsqueeze(1)).squeeze(1)
            if self.settings.loss == "huber":
                return functional.smooth_l1_loss(values, targets, reduction="none"), values.detach()
            return 0.5 * (values - targets) ** 2, values.detach()
        layers: Any = self.values.online[0]
        logits = layers.compute_logits(batch.observation)[torch.arange(len(targets)), batch.action]
        known = torch.special.xlogy(targets, targets) - targets * logits.log_softmax(dim=1)
        return known.sum(dim=1), logits.detach().softmax(dim=1) @ layers.support

    def update(self, batch: Experience) -> Mapping[str, float]:
        """Make one gradient step on a batch with its sampling weights; return numbers to log."""
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
