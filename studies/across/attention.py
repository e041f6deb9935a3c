"""A candidate for learning across rooms: attention over pairs of buttons, trained on orders that search has found.

Every button is a token: the sum of learned embeddings of its symbol, colour, plug, direction, number, and place in the
order so far. Self-attention (Vaswani et al. 2017) relates buttons to each other, so that a button can be the next one
because of what another showed. The loss is the cross entropy of the button that was turned on next. Weights decay, and
training stops early by the loss in `valid` rooms.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from hrl_escape.benchmark.references.count_cues import CUE_SECTORS, RoomOrder
from hrl_escape.env.puzzles.cues import COLOURS, MOST_SYMBOLS

__all__ = ["AttentionSettings", "OrderNetwork", "fit"]

MOST_BUTTONS = 16
"""Most buttons of a room."""
INITIAL = 0.05
"""Standard deviation of new embeddings. Small ones leave symbols neutral that training has not shown."""


@dataclasses.dataclass(frozen=True)
class AttentionSettings:
    """Settings of the network and its training."""

    width: int = 48
    """Numbers of a token. More fit more, and overfit sooner."""
    heads: int = 4
    """Heads of attention."""
    layers: int = 2
    """Layers of attention."""
    learning_rate: float = 3e-3
    """Step size of AdamW."""
    weight_decay: float = 0.05
    """Decay of all weights, embeddings included. More of it trusts few rooms less."""
    epochs: int = 300
    """Most passes over the training rooms."""
    patience: int = 30
    """Passes without a lower loss in `valid` rooms before training stops."""


class OrderNetwork(nn.Module):
    """Network from what a room shows to a logit for each button."""

    def __init__(self, settings: AttentionSettings, generator: torch.Generator) -> None:
        super().__init__()
        plugs = MOST_SYMBOLS // len(COLOURS)
        sizes = (MOST_SYMBOLS + 1, len(COLOURS) + 1, plugs + 1, CUE_SECTORS, MOST_BUTTONS, MOST_BUTTONS + 1)
        self.embeddings = nn.ModuleList(nn.Embedding(size, settings.width) for size in sizes)
        self.place = nn.Embedding(MOST_BUTTONS + 1, settings.width)
        layer = nn.TransformerEncoderLayer(settings.width, settings.heads, 2 * settings.width, dropout=0.0,
                                           batch_first=True, norm_first=True)
        self.attention = nn.TransformerEncoder(layer, settings.layers, enable_nested_tensor=False)
        self.head = nn.Linear(settings.width, 1)
        small = {id(weight) for weight in (*self.embeddings.parameters(), self.place.weight, self.head.weight)}
        with torch.no_grad():
            for weight in self.parameters():
                if weight.dim() > 1:
                    spread = INITIAL if id(weight) in small else 0.5 * weight.shape[1] ** -0.5
                    weight.normal_(std=spread, generator=generator)

    def forward(self, tokens: Tensor) -> Tensor:
        """Return logits, float32 (rooms, buttons), of tokens, int64 (rooms, buttons, 6); -inf where a button is on."""
        orders = tokens[..., -1]
        states = sum(embed(tokens[..., number]) for number, embed in enumerate(self.embeddings))
        states = states + self.place((orders > 0).sum(dim=1))[:, None]
        return self.head(self.attention(states))[..., 0].masked_fill(orders > 0, -torch.inf)


def make_tokens(room: RoomOrder, place: int) -> list[list[int]]:
    """Return the tokens of a room's buttons after the first `place` of its order were turned on."""
    when = {target: number + 1 for number, target in enumerate(room.order[:place])}
    return [[*((room.cues[target] + 1, room.cues[target] % len(COLOURS) + 1, room.cues[target] // len(COLOURS) + 1)
               if room.cues else (0, 0, 0)), sector, target, when.get(target, 0)]
            for target, sector in enumerate(room.sectors)]


def fit(rooms: Sequence[RoomOrder], valid: Sequence[RoomOrder], seed: int,
        settings: AttentionSettings | None = None) -> OrderNetwork:
    """Train a network on the orders of rooms with equal numbers of buttons, and return its best weights in `valid`."""
    settings = settings or AttentionSettings()
    network = OrderNetwork(settings, torch.Generator().manual_seed(seed))
    optimiser = torch.optim.AdamW(network.parameters(), settings.learning_rate, weight_decay=settings.weight_decay)
    train_in, test_in = (_batch(own) for own in (rooms, valid))
    best, kept, waited = np.inf, copy.deepcopy(network.state_dict()), 0
    for _ in range(settings.epochs):
        network.train()
        loss = nn.functional.cross_entropy(network(train_in[0]), train_in[1])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        network.eval()
        with torch.no_grad():
            found = float(nn.functional.cross_entropy(network(test_in[0]), test_in[1]))
        if found < best - 1e-4:
            best, kept, waited = found, copy.deepcopy(network.state_dict()), 0
        else:
            waited += 1
            if waited >= settings.patience:
                break
    network.load_state_dict(kept)
    return network.eval()


def _batch(rooms: Sequence[RoomOrder]) -> tuple[Tensor, Tensor]:
    """Return tokens and next button of every step of the rooms."""
    steps = [(make_tokens(room, place), room.order[place]) for room in rooms for place in range(len(room.order))]
    tokens, following = zip(*steps, strict=True)
    return torch.tensor(tokens), torch.tensor(following)


def weigh(network: OrderNetwork, room: RoomOrder, off: Sequence[int]) -> list[float]:
    """Return the probability that each of the buttons that are off is next, by a trained network."""
    with torch.no_grad():
        logits = network(torch.tensor([make_tokens(room, len(room.order))]))[0]
    return torch.softmax(logits[list(off)], dim=0).tolist()
