"""Counter-based random numbers: noise is a pure function of (episode key, primitive number).

Philox4x32-10 (Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3"). Because
nothing is kept between primitives, a restored state meets the same noise, and a room
meets the same noise in whichever batch it is stepped: words are drawn for one room, or for many in tensors.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hrl_escape.errors import ConfigError

MASK = 0xFFFFFFFF
_MULTIPLIERS = (0xD2511F53, 0xCD9E8D57)
_WEYL = (0x9E3779B9, 0xBB67AE85)
_ROUNDS = 10
Words = tuple[Any, Any, Any, Any]
NOISE_PURPOSE, EPISODE_PURPOSE, CHANCE_PURPOSE, PUZZLE_PURPOSE = range(4)
"""Third word of the counter: for noise, an episode's start, a puzzle's random outcomes, and its first state."""


def philox(counter: Words, key: tuple[Any, Any]) -> Words:
    """Return four 32-bit words of Philox4x32-10, of such words: each a whole number, or an int64 tensor of them."""
    c0, c1, c2, c3 = counter
    k0, k1 = key
    for _ in range(_ROUNDS):
        p0, p1 = _MULTIPLIERS[0] * c0, _MULTIPLIERS[1] * c2  # of tensors modulo 2**64: both halves are right
        c0, c1 = ((p1 >> 32) & MASK) ^ c1 ^ k0, p1 & MASK
        c2, c3 = ((p0 >> 32) & MASK) ^ c3 ^ k1, p0 & MASK
        k0, k1 = (k0 + _WEYL[0]) & MASK, (k1 + _WEYL[1]) & MASK
    return c0, c1, c2, c3


def draw_words(key: Any, count: Any, purpose: int = EPISODE_PURPOSE) -> Words:
    """Return four 32-bit words for a 64-bit key and count; for int64 tensors of these, tensors.

    An episode's are those of the environment's seed and the episode's number.
    """
    return philox((count & MASK, count >> 32 & MASK, purpose, 0), (key & MASK, key >> 32 & MASK))


def scale_word(word: Any, count: Any) -> Any:
    """Turn 32-bit words into whole numbers from 0 to count - 1 (multiply and shift)."""
    return word * count >> 32


def check_seed(seed: Any) -> int:
    """The seed of an episode as an int; `ConfigError` where it is none."""
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise ConfigError("seed", seed, "a whole number of at least 0")
    return int(seed)


def check_instance_seed(seed: Any) -> int:
    """The seed of a room as an int, which files keep in 63 bits; `ConfigError` where it is none."""
    if check_seed(seed) >= 2**63:
        raise ConfigError("seed", seed, "a whole number from 0 to 2**63 - 1")
    return int(seed)


def fold_seed(seed: int) -> int:
    """64-bit key of a seed of any size: the seed itself if it is below 2**64, else a hash of it."""
    return seed if seed < 2**64 else int(np.random.SeedSequence(seed).generate_state(1, np.uint64)[0])


def draw_episode(seed: int, episode: int, starts: int) -> tuple[int, int]:
    """Return the number of an episode's start and the 63-bit key of its noise, by the environment's 64-bit seed."""
    first, second, third, _ = draw_words(seed, episode)
    return scale_word(first, starts), ((second << 32) | third) & (2**63 - 1)


def draw_puzzle_start(key: Any, starts: Any) -> Any:
    """Return the number of the puzzle's first state in an episode, by the 64-bit key of the episode's noise."""
    return scale_word(draw_words(key, 0, PUZZLE_PURPOSE)[0], starts)


def draw_chance(key: int, primitive: int) -> float:
    """Return the uniform number in (0, 1) that decides a puzzle's random outcome at a primitive of an episode."""
    return (draw_words(key, primitive, CHANCE_PURPOSE)[0] + 0.5) / 2**32


def compute_noise(key: int, primitive: int) -> tuple[float, float]:
    """Return (standard normal, uniform in (0, 1)) for a primitive of an episode, both numbered from 0.

    The normal is Box-Muller on the first two words, the uniform comes from the third.
    """
    a, b, c, _ = draw_words(key, primitive, NOISE_PURPOSE)
    scale = 1.0 / 2**32
    normal = math.sqrt(-2.0 * math.log((a + 0.5) * scale)) * math.cos(2.0 * math.pi * (b + 0.5) * scale)
    return normal, (c + 0.5) * scale
