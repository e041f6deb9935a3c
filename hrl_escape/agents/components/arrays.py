"""Arrays and random draws of a batch of decisions: NumPy in one environment, tensors on a device in many.

The same code serves both libraries, because the functions used on `Arrays.library` have the same names in both. For a
batch of one, NumPy takes a twentieth of the time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import torch

from hrl_escape.agents.components.exploration import sample_index
from hrl_escape.agents.state import Stateful


class Arrays(Stateful):
    """A library of arrays, with a random generator of its own type.

    Args:
        rng: generator of the draws; with tensors it draws the seed of theirs.
        device: device of tensors, or None for NumPy.

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
        """Return `count` consecutive numbers from `first`, int64 (count,)."""
        return self.library.arange(first, first + count, device=str(self.device))

    def take(self, rows: Any, which: Any) -> Any:
        """Return some rows, int64 (n,), of an array; several times faster than indexing."""
        return rows.take(which, axis=0) if self.library is np else rows.index_select(0, which)

    def draw_numbers(self, below: int, count: int) -> Any:
        """Draw numbers from 0 to `below` - 1, int64 (count,)."""
        if self.library is np:
            return self._generator.integers(below, size=count)
        return torch.randint(below, (count,), generator=self._generator, device=self.device)

    def draw_normal(self, *shape: int) -> Any:
        """Draw standard normal numbers, float32 of a shape."""
        if self.library is np:
            return self._generator.standard_normal(shape, dtype=np.float32)
        return torch.randn(shape, generator=self._generator, device=self.device)

    def draw_uniform(self, *shape: int) -> Any:
        """Draw numbers from [0, 1), float32 of a shape."""
        if self.library is np:
            return self._generator.random(shape, dtype=np.float32)
        return torch.rand(shape, generator=self._generator, device=self.device)

    def draw_choices(self, probabilities: Any) -> Any:
        """Draw an index from each row of probabilities, int64 (n,) from (n, choices).

        An index of probability 0 is never drawn. Tensors are drawn by `draw_rows`; NumPy takes the minimum of
        exponential clocks.
        """
        if self.library is np and len(probabilities) == 1:
            return np.array([sample_index(probabilities[0], self._generator)])
        if self.library is np:
            waits = self._generator.standard_exponential(probabilities.shape)
            return (probabilities / np.maximum(waits, 1e-30)).argmax(1)
        return draw_rows(probabilities, self._generator)

    def join(self, parts: Sequence[Any]) -> torch.Tensor:
        """Concatenate arrays, as a tensor on the device."""
        return torch.from_numpy(np.concatenate(parts)) if self.library is np else torch.cat(list(parts))

    def restore(self, saved: Any) -> Any:
        """Return an array from a checkpoint."""
        array = np.array(saved)
        return array if self.library is np else torch.from_numpy(array).to(self.device)


def draw_rows(probabilities: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Draw an index from each row of probabilities, int64 (n,) from (n, choices).

    An index of probability 0 is never drawn. Inverts the cumulative distribution, with a number a row.
    """
    sums = probabilities.t().contiguous().cumsum(0)  # column by column, a fifth of the time of row by row
    total = sums[-1]
    drawn = total * torch.rand(len(total), generator=generator, device=total.device, dtype=total.dtype)
    drawn = torch.minimum(drawn, total.nextafter(torch.zeros_like(total)))  # the product may round up
    return (sums <= drawn).sum(0)


def draw_minibatches(rng: np.random.Generator, units: int, size: int, epochs: int) -> Iterator[torch.Tensor]:
    """Shuffle the units in every epoch and split them into minibatches, int64 (at most `size`,) each."""
    for _ in range(epochs):
        yield from torch.from_numpy(rng.permutation(units)).split(size)
