"""Arrays and random draws of a batch of decisions: NumPy in one environment, tensors on a device in many.

One text serves both libraries, because what is called on `Arrays.library` has one name in both. NumPy takes a
twentieth of the time for a batch of one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import torch

from hrl_escape.agents.components.exploration import sample_index
from hrl_escape.agents.state import Stateful


class Arrays(Stateful):
    """A library of arrays, and a generator of its own kind.

    Args:
        rng: generator of the draws; of tensors it draws the seed.
        device: device of tensors; None for NumPy.

    Attributes:
        library: `numpy` or `torch`.
        device: device of tensors; the CPU with NumPy.
    """

    STATE = ("_generator",)

    def __init__(self, rng: np.random.Generator, device: torch.device | None = None) -> None:
        self.library: Any = np if device is None else torch
        self.device = device or torch.device("cpu")
        self._generator: Any = rng if device is None else torch.Generator(device).manual_seed(
            int(rng.integers(2**63)))

    def zeros(self, shape: tuple[int, ...], dtype: str = "float32") -> Any:
        """Return zeros of a shape."""
        return self.library.zeros(shape, dtype=getattr(self.library, dtype), device=str(self.device))

    def arange(self, first: int, count: int) -> Any:
        """Return the numbers from `first` on, int64 (count,)."""
        return self.library.arange(first, first + count, device=str(self.device))

    def take(self, rows: Any, which: Any) -> Any:
        """Return some rows, int64 (n,), of an array; several times faster than by an index."""
        return rows.take(which, axis=0) if self.library is np else rows.index_select(0, which)

    def draw_numbers(self, below: int, count: int) -> Any:
        """Draw numbers from 0 to `below` - 1, int64 (count,)."""
        if self.library is np:
            return self._generator.integers(below, size=count)
        return torch.randint(below, (count,), generator=self._generator, device=self.device)

    def draw_choices(self, probabilities: Any) -> Any:
        """Draw an index from each row of probabilities, int64 (n,) from (n, choices).

        One of probability 0 is never drawn. The winner is the first of exponential clocks to ring.
        """
        if self.library is np and len(probabilities) == 1:
            return np.array([sample_index(probabilities[0], self._generator)])
        if self.library is np:
            waits = self._generator.standard_exponential(probabilities.shape)
            return (probabilities / np.maximum(waits, 1e-30)).argmax(1)
        waits = torch.empty_like(probabilities).exponential_(generator=self._generator).clamp_(min=1e-30)
        return (probabilities / waits).argmax(1)

    def join(self, parts: Sequence[Any]) -> torch.Tensor:
        """Concatenate arrays, as a tensor on the device."""
        return torch.from_numpy(np.concatenate(parts)) if self.library is np else torch.cat(list(parts))

    def restore(self, saved: Any) -> Any:
        """Return an array that a checkpoint holds."""
        array = np.array(saved)
        return array if self.library is np else torch.from_numpy(array).to(self.device)


def draw_minibatches(rng: np.random.Generator, units: int, size: int, epochs: int) -> Iterator[torch.Tensor]:
    """Shuffle the units' numbers anew in each epoch and cut them into minibatches, int64 (at most `size`,) each."""
    for _ in range(epochs):
        yield from torch.from_numpy(rng.permutation(units)).split(size)
