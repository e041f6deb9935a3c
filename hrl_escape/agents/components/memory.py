"""Recurrent memory: what a network is told of the episode so far, beside the present observation.

A gated recurrent unit (Cho et al. 2014) turns the encoded observation and the state before it into the next state, zero
before an episode's first decision. Over rows of objects every row has a unit with the same weights and a state of its
own, so that what is remembered permutes with the objects. Gradients go back through stretches of at most `memory_span`
decisions, which begin in the state that was there when they were lived.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from hrl_escape.agents.components.networks import Network, ObservationEncoder
from hrl_escape.errors import UnsupportedSpaceError
from hrl_escape.spaces import ObjectsBox


class GatedCell(nn.Module):
    """Gated recurrent unit from observations and states, one after the other in a row, to states."""

    def __init__(self, numbers: int, rows: int, words: int, units: int, generator: torch.Generator) -> None:
        super().__init__()
        self._numbers, self._rows, self._words, self._units = numbers, rows, words, units
        cell: Any = nn.utils.skip_init(nn.GRUCell, words + numbers - rows * words, units)
        for weight in (cell.weight_ih, cell.weight_hh):
            for gate in weight.data.split(units):
                nn.init.orthogonal_(gate, generator=generator)
        nn.init.zeros_(cell.bias_ih)
        nn.init.zeros_(cell.bias_hh)
        self.cell = cell

    def forward(self, given: Tensor) -> Tensor:
        """States, (n, rows x units), from (n, numbers + rows x units)."""
        observation, state = given[:, : self._numbers], given[:, self._numbers :]
        own = observation[:, : self._rows * self._words].unflatten(1, (self._rows, self._words))
        context = observation[:, None, self._rows * self._words :].expand(-1, self._rows, -1)
        inputs = torch.cat([own, context], dim=2).flatten(0, 1)
        return self.cell(inputs, state.reshape(-1, self._units)).view(len(given), self._rows * self._units)


class Memory(NamedTuple):
    """A recurrent memory of encoded observations."""

    network: Network  # of one `GatedCell`
    size: int  # numbers in a state

    def read(self, observation: Tensor, state: Tensor) -> Tensor:
        """Remember an observation; returns it with the new state behind it, (n, numbers + size)."""
        return torch.cat([observation, self.network(torch.cat([observation, state], dim=1))], dim=1)

    def get_state(self, read: Tensor) -> Tensor:
        """The states in the result of `read`, (n, size)."""
        return read[:, -self.size :]

    def read_stretches(self, observation: Tensor, state: Tensor, over: Tensor, stretches: Stretches) -> Tensor:
        """Live through k decisions in stretches again; returns `read` of them, in the order of `stretches.rows`.

        Observations (n, numbers), the states (n, size) before them, when they were lived, of which the first of a
        stretch is taken, and `over`, bool (n,), where an episode ended, are those of all decisions.
        """
        places, _ = stretches.grid.shape
        now = state[stretches.grid[0]]
        found = []
        for place in range(places):
            rows = stretches.grid[place]
            seen = self.read(observation[rows], now)
            found.append(seen)
            now = torch.where(over[rows, None], 0.0, self.get_state(seen))
        return torch.stack(found)[stretches.is_real]


class Stretches(NamedTuple):
    """Stretches of decisions that follow each other in one stream, side by side."""

    grid: Tensor  # int64 (places, stretches), rows of the rollout; arbitrary ones where a stretch is shorter
    is_real: Tensor  # bool, the same shape

    @property
    def rows(self) -> Tensor:
        """Rows in the grid that are real, place by place, int64 (k,)."""
        return self.grid[self.is_real]

    def pick(self, columns: Tensor) -> Stretches:
        """Some of the stretches."""
        return Stretches(self.grid[:, columns], self.is_real[:, columns])


def cut_stretches(stream: Tensor, place: Tensor, span: int) -> Stretches:
    """Cut decisions of streams, int64 (n,), at places without gaps, int64 (n,), into stretches of at most `span`."""
    pieces = int(place.max()) // span + 1
    key = stream * pieces + place // span
    names, column = torch.unique(key, return_inverse=True)
    grid = torch.zeros((min(span, int(place.max()) + 1), len(names)), dtype=torch.int64, device=stream.device)
    is_real = torch.zeros_like(grid, dtype=torch.bool)
    at = place % span, column
    grid[at] = torch.arange(len(stream), device=stream.device)
    is_real[at] = True
    return Stretches(grid, is_real)


def make_memory(encoder: ObservationEncoder, settings: Any, by_objects: bool, generator: torch.Generator
                ) -> Memory | None:
    """Make the memory that settings ask for, if any; `by_objects` gives each row of objects a state of its own.

    Raises:
        UnsupportedSpaceError: a memory of pictures.
    """
    if settings.memory == "none":
        return None
    if encoder.is_image:
        raise UnsupportedSpaceError("memory=gru remembers vectors, not pictures: make the environment with another "
                                    "observation")
    numbers = encoder.shape[0]
    rows, words = 1, numbers
    if by_objects and isinstance(encoder.space, ObjectsBox):
        rows, words = len(encoder.space.rows), len(encoder.space.words)
    cell = GatedCell(numbers, rows, words, settings.memory_units, generator)
    return Memory(Network(cell), rows * settings.memory_units)
