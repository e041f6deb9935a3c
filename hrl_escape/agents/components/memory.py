"""Recurrent memory: a summary of the episode so far as input of a network, in addition to the current observation.

A gated recurrent unit (Cho et al. 2014) maps the encoded observation and the previous state to the next state, which is
zero before an episode's first decision. Over rows of objects, every row has a unit with the same weights and its own
state, which makes the memory equivariant under permutation of objects. Gradients flow through stretches of at most
`memory_span` decisions, which begin in the stored state.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from hrl_escape.agents.components.arrays import Arrays, draw_minibatches
from hrl_escape.agents.components.networks import Network, ObservationEncoder
from hrl_escape.agents.components.policy import Memory
from hrl_escape.agents.state import Stateful
from hrl_escape.errors import UnsupportedSpaceError
from hrl_escape.spaces import ObjectsBox


class GatedCell(nn.Module):
    """Gated recurrent unit from concatenated observations and states to states."""

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
        """Return states (n, rows x units) from (n, numbers + rows x units)."""
        observation, state = given[:, : self._numbers], given[:, self._numbers :]
        own = observation[:, : self._rows * self._words].unflatten(1, (self._rows, self._words))
        context = observation[:, None, self._rows * self._words :].expand(-1, self._rows, -1)
        inputs = torch.cat([own, context], dim=2).flatten(0, 1)
        return self.cell(inputs, state.reshape(-1, self._units)).view(len(given), self._rows * self._units)


class GatedMemory(Memory):
    """A gated recurrent unit over encoded observations.

    Args:
        network: network of one `GatedCell`.
        size: size of a state.
        span: most decisions that a gradient flows through.
    """

    def __init__(self, network: Network, size: int, span: int) -> None:
        self.network, self.size, self._span = network, size, span
        self._latest: NDArray | None = None

    @property
    def networks(self) -> dict[str, Network]:
        """Networks that are learned, by name."""
        return {"memory": self.network}

    def read(self, observation: Tensor, state: Tensor) -> Tensor:
        """Update states with observations; return observations and new states, (n, numbers + size)."""
        return torch.cat([observation, self.network(torch.cat([observation, state], dim=1))], dim=1)

    def evaluate(self, observation: Any, state: Any) -> Any:
        """Return `read` without gradients; arrays give arrays."""
        with torch.no_grad():
            if not isinstance(observation, np.ndarray):
                return self.read(observation, state)
            both = (torch.from_numpy(part).to(self.network.weights.device) for part in (observation, state))
            seen = self.read(*both).cpu().numpy()
            self._latest = seen[0]
            return seen

    def get_state(self, read: Any) -> Any:
        """Return the states in the result of `read`, (n, size)."""
        return read[:, -self.size :]

    def recall(self, encoded: NDArray) -> NDArray:
        """Return inputs of the networks at one encoded observation: of the latest choice there, else a new episode."""
        if self._latest is not None and np.array_equal(self._latest[: len(encoded)], encoded):
            return self._latest
        return self.evaluate(encoded[None], np.zeros((1, self.size), np.float32))[0]

    def draw_batches(self, rollout: Any, size: int, rng: np.random.Generator, epochs: int
                     ) -> Iterator[tuple[Tensor, Tensor]]:
        """Shuffle stretches of a rollout in every epoch; gradients of the inputs flow through a stretch."""
        stretches = cut_stretches(rollout.stream, rollout.place, self._span)
        total, units = len(rollout.place), stretches.grid.shape[1]
        for columns in draw_minibatches(rng, units, max(1, size * units // total), epochs):
            part = stretches.pick(columns.to(rollout.place.device))
            yield part.rows, self.read_stretches(rollout.observation, rollout.memory, rollout.over, part)

    def read_stretches(self, observation: Tensor, state: Tensor, over: Tensor, stretches: Stretches) -> Tensor:
        """Run the memory over k decisions in stretches; return `read` in the order of `stretches.rows`.

        `observation` (n, numbers), `state` (n, size) before each decision, and `over`, bool (n,), whether an episode
        ended, refer to all decisions. Each stretch begins with the stored state of its first decision.
        """
        places, _ = stretches.grid.shape
        now = state[stretches.grid[0]]
        found = []
        for place in range(places):
            rows = stretches.grid[place]
            seen = self.read(observation.index_select(0, rows), now)
            found.append(seen)
            now = torch.where(over[rows, None], 0.0, self.get_state(seen))
        return torch.stack(found)[stretches.is_real]


class Recollections(Stateful):
    """States of a memory in the running episodes, by environment.

    Attributes:
        now: current states, (environments, size); 0 before an episode's first decision.
        before: states before the latest decision.
    """

    STATE = ("now", "before")

    def __init__(self, memory: Memory, num_envs: int, arrays: Arrays) -> None:
        self._memory = memory
        self.now, self.before = (arrays.zeros((num_envs, memory.size)) for _ in range(2))

    def see(self, env: Any, observation: Any) -> Any:
        """Update the states of some environments with encoded observations; return the networks' inputs."""
        before = self.now[env]
        seen = self._memory.evaluate(observation, before)
        self.before[env], self.now[env] = before, self._memory.get_state(seen)
        return seen

    def end(self, env: Any, over: Any) -> Any:
        """Return states before decisions that ended, (n, size); reset states of episodes that are `over`, bool (n,)."""
        self.now[env[over]] = 0.0
        return self.before[env]

    def begin_episodes(self) -> None:
        """Reset the states of all episodes."""
        self.now[:] = 0.0


class Stretches(NamedTuple):
    """Stretches of consecutive decisions of one environment each, as columns of a grid."""

    grid: Tensor  # int64 (places, stretches), rows of the rollout; arbitrary beyond the end of a stretch
    is_real: Tensor  # bool, the same shape: whether the entry belongs to the stretch

    @property
    def rows(self) -> Tensor:
        """Valid rows in the grid, place by place, int64 (k,)."""
        return self.grid[self.is_real]

    def pick(self, columns: Tensor) -> Stretches:
        """Return some of the stretches."""
        return Stretches(self.grid[:, columns], self.is_real[:, columns])


def cut_stretches(stream: Tensor, place: Tensor, span: int) -> Stretches:
    """Cut decisions of streams, int64 (n,), at consecutive places, int64 (n,), into stretches of at most `span`."""
    pieces = int(place.max()) // span + 1
    key = stream * pieces + place // span
    names, column = torch.unique(key, return_inverse=True)
    grid = torch.zeros((min(span, int(place.max()) + 1), len(names)), dtype=torch.int64, device=stream.device)
    is_real = torch.zeros_like(grid, dtype=torch.bool)
    at = place % span, column
    grid[at] = torch.arange(len(stream), device=stream.device)
    is_real[at] = True
    return Stretches(grid, is_real)


def make_memory(encoder: ObservationEncoder, kind: str, units: int, span: int, by_objects: bool,
                generator: torch.Generator) -> Memory:
    """Make a memory.

    Args:
        encoder: encoder of the observations.
        kind: `none` or `gru`.
        units: size of the state.
        span: most decisions that a gradient flows through.
        by_objects: whether each row of objects has a state of its own.
        generator: generator of the weights.

    Raises:
        UnsupportedSpaceError: the observations are pictures.
    """
    if kind == "none":
        return Memory()
    if encoder.is_image:
        raise UnsupportedSpaceError("memory=gru supports vectors, not pictures. Make the environment with another "
                                    "observation")
    numbers = encoder.shape[0]
    rows, words = 1, numbers
    if by_objects and isinstance(encoder.space, ObjectsBox):
        rows, words = len(encoder.space.rows), len(encoder.space.words)
    return GatedMemory(Network(GatedCell(numbers, rows, words, units, generator)), rows * units, span)
