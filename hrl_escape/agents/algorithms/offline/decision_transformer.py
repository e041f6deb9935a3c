"""Decision transformer over options: a choice as a continuation of a trajectory of high return (Chen et al. 2021).

A token is one decision: the state, the return still to come, and the option before it with its duration, without which
what it cost could not be told from what it was. Published tokens are one primitive each, three in a row.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.agents.components.exploration import choose_best
from hrl_escape.agents.components.networks import Network, ObservationEncoder, make_linear
from hrl_escape.agents.components.offline import Decisions, OfflineAgent, OfflineSettings, Primitives, encode_all
from hrl_escape.agents.components.replay import Experience
from hrl_escape.agents.state import Kept
from hrl_escape.settings import Range

HEADS = 4


@dataclass(frozen=True)
class DecisionTransformerSettings(OfflineSettings):
    """Size of the transformer and the return it is asked for, beside the settings of every offline agent."""

    context: Annotated[int, Range(1)] = 12
    """Decisions that it sees, the present one included."""
    width: Annotated[int, Range(1)] = 16
    """Units of a token for each of the four heads of attention."""
    layers: Annotated[int, Range(1)] = 2
    """Layers of attention."""
    target: Annotated[float, Range(0, 1)] = 0.95
    """Quantile of the returns of whole trajectories that it is asked for."""
    batch_size: Annotated[int, Range(1)] = 64


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
    """From tokens (batch, length, numbers), the last number 1 where there is one, to logits of actions."""

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
    """pi(o_t | s_t, G_t, and the decisions before), G_t the plain return that is still wanted.

    In evaluation G falls by what was earned; the history is that of the episode, told apart by its generator.
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

    def begin(self, data: Decisions, primitives: Primitives | None = None) -> None:
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
        """One decision as numbers: the state, the return wanted, the option before and its duration."""
        before = np.zeros(self._actions)
        if option >= 0:
            before[option] = 1.0
        scale = self.settings.reward_scale
        return np.concatenate([encoded, before, [left * scale, np.log1p(duration), 1.0]]).astype(np.float32)

    def make_networks(self, encoder: ObservationEncoder, action_space: gymnasium.Space, settings: Any,
                      generator: torch.Generator) -> dict[str, Network]:
        """One network, the policy: from tokens (batch, length, numbers) to logits (batch, length, actions)."""
        numbers = int(np.prod(encoder.shape)) + self._actions + 3
        return {"policy": Network(_Transformer(numbers, self._actions, settings, generator))}

    def compute_loss(self, batch: Experience, rows: NDArray[np.int64]) -> tuple[Tensor, dict[str, float]]:
        """Cross entropy with the choices of windows that end at the batch's decisions."""
        window = rows[:, None] - np.arange(self.settings.context)[None, ::-1]
        present = window >= self._starts[rows][:, None]
        tokens = np.where(present[:, :, None], self._rows[np.maximum(window, 0)], 0.0).astype(np.float32)
        index = torch.from_numpy(np.maximum(window, 0))
        logits = self.networks["policy"](torch.from_numpy(tokens)).masked_fill(~self._data.mask[index], -1e9)
        kept = torch.from_numpy(present)
        return functional.cross_entropy(logits[kept], self._data.action[index][kept]), {}

    def compute_preferences(self, observation: Any) -> NDArray:
        """Logits at an observation as the first of an episode, (actions,)."""
        return self._ask([self._make_token(self._encoder.encode(observation), self._wanted, -1, 0)])

    def _ask(self, tokens: list[NDArray[np.float32]]) -> NDArray:
        window = np.zeros((self.settings.context, len(tokens[0])), np.float32)
        recent = tokens[-self.settings.context :]
        window[-len(recent) :] = recent
        return self.networks["policy"].compute(window)[-1]

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The likeliest legal choice, given the episode so far."""
        if rng is not self._episode:
            self._episode, self._tokens, self._left, self._before = rng, [], self._wanted, (-1, 0)
        self._tokens.append(self._make_token(self._encoder.encode(observation), self._left, *self._before))
        del self._tokens[: -self.settings.context]
        return choose_best(self._ask(self._tokens), action_mask)

    def note_outcome(self, transition: SMDPTransition, rng: np.random.Generator) -> None:
        """Take what was earned off the return that is wanted."""
        if rng is self._episode:
            self._left -= transition.summed_reward
            self._before = (transition.action, transition.duration)
