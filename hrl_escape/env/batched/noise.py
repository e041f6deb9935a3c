"""Counter-based random numbers in tensors: the same numbers as `noise.py`, for every room at once.

Philox4x32-10 (Salmon et al. 2011) in 64-bit integer arithmetic, which every device has. A
number depends on a room's own key and count alone, never on the batch the room is in.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from hrl_escape.env.noise import CHANCE_PURPOSE, EPISODE_PURPOSE, MASK, PUZZLE_PURPOSE, Words, philox


def _run(key: Tensor, count: Tensor, purpose: int) -> Words:
    count = count.to(torch.int64)
    none = torch.zeros_like(count)
    return philox((count & MASK, (count >> 32) & MASK, none + purpose, none), (key & MASK, (key >> 32) & MASK))


def compute_noise(key: Tensor, primitive: Tensor) -> tuple[Tensor, Tensor]:
    """Return (standard normal, uniform in (0, 1)) for a primitive of each room's episode.

    Both are float64 (rooms,): single precision would round the tail of the normal away.
    """
    a, b, c, _ = _run(key, primitive, 0)
    scale = 1.0 / 2**32
    first, second, third = ((word.to(torch.float64) + 0.5) * scale for word in (a, b, c))
    return torch.sqrt(-2.0 * torch.log(first)) * torch.cos(2.0 * math.pi * second), third


def draw_chance(key: Tensor, primitive: Tensor) -> Tensor:
    """Return the uniform numbers in (0, 1) that decide the random outcomes of puzzles, float64 (rooms,)."""
    return (_run(key, primitive, CHANCE_PURPOSE)[0].to(torch.float64) + 0.5) / 2**32


def draw_puzzle_start(key: Tensor, starts: Tensor) -> Tensor:
    """Return the index of each episode's first puzzle state among the puzzle's starts, int64 (rooms,)."""
    return scale_word(_run(key, torch.zeros_like(key), PUZZLE_PURPOSE)[0], starts)


def draw_words(seed: Tensor, episode: Tensor) -> Words:
    """Return four 32-bit words that belong to an episode of a room, int64 (rooms,) each."""
    return _run(seed, episode, EPISODE_PURPOSE)


def scale_word(word: Tensor, count: Tensor | int) -> Tensor:
    """Turn a 32-bit word into a whole number from 0 to count - 1, int64 (multiply and shift)."""
    return (word * count) >> 32
