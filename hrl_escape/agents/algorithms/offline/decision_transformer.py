"""Decision transformer over options: a choice as a continuation of a trajectory of high return (Chen et al. 2021).

A token is one decision: the state, the remaining return, and the previous option with its duration, which explains its
cost. Published tokens are one primitive each, three in a row.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from hrl_escape.agents.agent import AgentSettings, SMDPTransition
from hrl_escape.agents.components.exploration import choose_best
from hrl_escape.agents.components.networks import Network, ObservationEncoder, make_linear
from hrl_escape.agents.components.offline import OfflineAgent, Primitives, RecordedDecisions, encode_all
from hrl_escape.agents.components.replay import Experience
from hrl_escape.agents.state import Kept
from hrl_escape.settings import Range

HEADS = 4


@dataclass(frozen=True, kw_only=True)
class DecisionTransformerSettings(AgentSettings):
    """Settings of `decision-transformer`: its size, the requested return, and the settings of every offline agent."""

    bins: Annotated[int, Range(2)] = 11
    """Number of evenly spaced points, both bounds included, to round bounded components to: 11 over a 20 m room is 2 m.
    More points make more, finer states. Binary components are unchanged."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """Unit to round unbounded components to multiples of. Smaller values make more, finer states."""
    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive, or per decision if `discounting` is `decision`. Higher values look further ahead and
    learn more slowly."""
    discounting: Literal["primitive", "decision"] = "primitive"
    """`primitive` discounts k primitives by gamma^k. `decision` sums their rewards and discounts by gamma, as the
    paper's agents did."""
    bootstrap_on_truncation: bool = True
    """Bootstrap from the last state of a truncated episode. False treats a truncation as a termination, as in the
    paper's agents."""
    clock: Literal["primitive", "decision"] = "primitive"
    """Unit of warm-up, updates and epsilon. With primitives an agent over options updates as often as a flat one."""
    hidden: tuple[Annotated[int, Range(1)], ...] = (64, 64)
    """Units of each hidden layer."""
    initialisation: Literal["torch", "glorot", "orthogonal"] = "torch"
    """Initial weights: U(+-1/sqrt(fan in)); Xavier uniform with zero bias, as in Keras; or orthogonal with zero bias,
    usual for PPO."""
    learning_rate: Annotated[float, Range(0, open_low=True)] = 3e-4
    """Step size of Adam. Too large a step diverges."""
    max_grad_norm: Annotated[float, Range(0)] = 10.0
    """Largest Euclidean norm of a gradient; larger ones are scaled down. 0 sets no limit."""
    adam_epsilon: Annotated[float, Range(0, open_low=True)] = 1e-8
    """Term in Adam's denominator; 1e-7 in Keras."""
    scale_observations: bool = True
    """Map components with finite bounds to [-1, 1]."""
    reward_scale: Annotated[float, Range(0, open_low=True)] = 0.1
    """Factor on the rewards that networks learn. Smaller values suit larger returns. Temperatures and logged values
    keep units of return."""
    epsilon_start: Annotated[float, Range(0, 1)] = 1.0
    """Epsilon at the beginning; 1 acts at random."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon from `epsilon_steps` on. More explores for longer and lowers the return of training episodes."""
    epsilon_steps: Annotated[int, Range(1)] = 5_000
    """Number of clock steps of the linear decrease of epsilon. More explores for longer."""
    loss: Literal["huber", "squared"] = "huber"
    """Huber loss with threshold 1 in scaled rewards, or half the squared error, which follows outliers."""
    batch_size: Annotated[int, Range(1)] = 64
    """Decisions in an update."""
    warmup: Annotated[int, Range(0)] = 500
    """Steps of the clock before the first update."""
    updates_per_step: Annotated[float, Range(0)] = 0.25
    """Updates for each step of the clock. More learn more from the same experience and take longer."""
    max_updates: Annotated[int, Range(1)] = 16
    """Most updates after a step of many environments. Where more are due, minibatches grow instead. Few large ones
    learn less, because the target network follows updates."""
    replay_per_env: Annotated[int, Range(1)] = 128
    """Smallest replay capacity per environment with many environments, in decisions."""
    passes: Annotated[int, Range(1)] = 50
    """Passes over the data, if `train` has no budget."""
    values: Literal["auto", "table", "network"] = "auto"
    """`table`: exact backups over the states of the data. `auto`: a table if each state occurs at least ten times on
    average and the observation has no rows of objects, which let networks generalise to other rooms."""
    network: Literal["mlp", "objects"] = "objects"
    """`objects`: deep sets over the observation's rows of objects. `mlp`: a perceptron over the whole observation."""
    target_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.01
    """Share of a network blended into its target at each update. Smaller rates are slower and more stable."""
    context: Annotated[int, Range(1)] = 12
    """Number of decisions in its context, including the current one. More see longer dependencies and take longer."""
    width: Annotated[int, Range(1)] = 16
    """Units of a token for each of the four heads of attention."""
    layers: Annotated[int, Range(1)] = 2
    """Layers of attention."""
    target: Annotated[float, Range(0, 1)] = 0.95
    """Quantile of the returns of whole trajectories that it is conditioned on."""


class _Layer(nn.Module):
    """Causal attention and a perceptron, each added to its input after layer normalisation."""

    def __init__(self, width: int, generator: torch.Generator) -> None:
        super().__init__()
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(2))
        sizes = ((width, 3 * width), (width, width), (width, 4 * width), (4 * width, width))
        self.parts = nn.ModuleList(make_linear(*size, "torch", generator) for size in sizes)

    def forward(self, tokens: Tensor, may_see: Tensor) -> Tensor:
        batch, length, width = tokens.shape
        ask, offer, out, back = self.parts
        heads = ask(self.norms[0](tokens)).view(batch, length, 3 * HEADS, width // HEADS).transpose(1, 2)
        seen = functional.scaled_dot_product_attention(*heads.chunk(3, dim=1), attn_mask=may_see)
        tokens = tokens + offer(seen.transpose(1, 2).reshape(batch, length, width))
        return tokens + back(functional.gelu(out(self.norms[1](tokens))))


class _Transformer(nn.Module):
    """From tokens (batch, length, numbers), whose last number is 1 for real tokens, to logits of actions."""

    places: Tensor

    def __init__(self, numbers: int, actions: int, settings: DecisionTransformerSettings, generator: torch.Generator
                 ) -> None:
        super().__init__()
        width = HEADS * settings.width
        self.enter = make_linear(numbers, width, "torch", generator)
        self.leave = make_linear(width, actions, "torch", generator)
        self.layers = nn.ModuleList(_Layer(width, generator) for _ in range(settings.layers))
        wave = torch.arange(settings.context)[:, None] / 100 ** (torch.arange(width)[None] / width)
        self.register_buffer("places", wave.sin(), persistent=False)

    def forward(self, tokens: Tensor) -> Tensor:
        length, present = tokens.shape[1], tokens[:, :, -1] > 0.5
        before = torch.ones(length, length, dtype=torch.bool).tril()
        may_see = (before & present[:, None, :]) | torch.eye(length, dtype=torch.bool)
        hidden = self.enter(tokens) + self.places[-length:]
        for layer in self.layers:
            hidden = layer(hidden, may_see[:, None])
        return self.leave(hidden)


class DecisionTransformer(OfflineAgent):
    """pi(o_t | s_t, G_t, and the decisions before), with G_t the plain return still requested.

    In evaluation, rewards are subtracted from G. The history belongs to the episode, identified by its generator.
    """

    acting: ClassVar[str] = "policy"
    has_table: ClassVar[bool] = False
    is_markov = False
    settings: DecisionTransformerSettings
    STATE = (Kept("_wanted", "wanted"),)

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: DecisionTransformerSettings | None = None) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        self._wanted, self._left = 0.0, 0.0
        self._episode: np.random.Generator | None = None
        self._tokens: list[NDArray[np.float32]] = []
        self._before = (-1, 0)

    def begin(self, data: RecordedDecisions, primitives: Primitives | None = None) -> None:
        """Make a token of every decision."""
        super().begin(data)
        first = np.concatenate([[True], data.trajectory[1:] != data.trajectory[:-1]])
        starts = np.maximum.accumulate(np.where(first, np.arange(len(first)), 0))
        sums = np.concatenate([[0.0], np.cumsum(data.summed_reward)])
        returns = np.bincount(data.trajectory, data.summed_reward)
        left = returns[data.trajectory] - (sums[:-1] - sums[starts])
        whole = np.unique(data.trajectory[data.terminated])
        self._wanted = float(np.quantile(returns[whole] if len(whole) else returns, self.settings.target))
        option = np.where(first, -1, np.roll(data.action, 1))
        duration = np.where(first, 0, np.roll(data.duration, 1))
        encoded = encode_all(self._encoder, data.observation).numpy()
        rows = zip(encoded, left, option, duration, strict=True)
        self._rows = np.stack([self._make_token(*row) for row in rows])
        self._starts = starts

    def _make_token(self, encoded: NDArray, left: float, option: int, duration: int) -> NDArray[np.float32]:
        """One decision as numbers: the state, the requested return, the previous option and its duration."""
        before = np.zeros(self._actions)
        if option >= 0:
            before[option] = 1.0
        scale = self.settings.reward_scale
        return np.concatenate([encoded, before, [left * scale, np.log1p(duration), 1.0]]).astype(np.float32)

    def make_networks(self, encoder: ObservationEncoder, action_space: gymnasium.Space, settings: Any,
                      generator: torch.Generator) -> dict[str, Network]:
        """Make the policy network: from tokens (batch, length, numbers) to logits (batch, length, actions)."""
        numbers = int(np.prod(encoder.shape)) + self._actions + 3
        return {"policy": Network(_Transformer(numbers, self._actions, settings, generator))}

    def compute_loss(self, batch: Experience, rows: NDArray[np.int64]) -> tuple[Tensor, dict[str, float]]:
        """Return the cross entropy with the choices of windows that end at the batch's decisions."""
        window = rows[:, None] - np.arange(self.settings.context)[None, ::-1]
        present = window >= self._starts[rows][:, None]
        tokens = np.where(present[:, :, None], self._rows[np.maximum(window, 0)], 0.0).astype(np.float32)
        index = torch.from_numpy(np.maximum(window, 0))
        logits = self.networks["policy"](torch.from_numpy(tokens)).masked_fill(~self._data.mask[index], -1e9)
        kept = torch.from_numpy(present)
        return functional.cross_entropy(logits[kept], self._data.action[index][kept]), {}

    def compute_preferences(self, observation: Any) -> NDArray:
        """Return the logits at an observation as the first of an episode, (actions,)."""
        return self._ask([self._make_token(self._encoder.encode(observation), self._wanted, -1, 0)])

    def _ask(self, tokens: list[NDArray[np.float32]]) -> NDArray:
        window = np.zeros((self.settings.context, len(tokens[0])), np.float32)
        recent = tokens[-self.settings.context :]
        window[-len(recent) :] = recent
        return self.networks["policy"].compute(window)[-1]

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Return the likeliest legal choice, given the episode so far."""
        if rng is not self._episode:
            self._episode, self._tokens, self._left, self._before = rng, [], self._wanted, (-1, 0)
        self._tokens.append(self._make_token(self._encoder.encode(observation), self._left, *self._before))
        del self._tokens[: -self.settings.context]
        return choose_best(self._ask(self._tokens), action_mask)

    def note_outcome(self, transition: SMDPTransition, rng: np.random.Generator) -> None:
        """Subtract the reward from the requested return."""
        if rng is self._episode:
            self._left -= transition.summed_reward
            self._before = (transition.action, transition.duration)
