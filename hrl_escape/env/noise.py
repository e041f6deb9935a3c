"""Counter-based random numbers: noise is a pure function of (episode key, primitive number).

It is Philox4x32-10 (Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3"). No generator state is kept
between primitives. The noise after a restored state is therefore the same, and the noise of a room is independent of
its batch. Words are computed for one room, or for many in tensors.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np

from hrl_escape.errors import ConfigError

MASK = 0xFFFFFFFF
_MULTIPLIERS = (0xD2511F53, 0xCD9E8D57)
_WEYL = (0x9E3779B9, 0xBB67AE85)
_ROUNDS = 10
_BLOCK = 128
"""Number of primitives whose noise is drawn at once."""
Words = tuple[Any, Any, Any, Any]
NOISE_PURPOSE, EPISODE_PURPOSE, CHANCE_PURPOSE, PUZZLE_PURPOSE = range(4)
"""Third word of the counter: noise, start of an episode, random outcomes of a puzzle, and its initial state."""


def philox(counter: Words, key: tuple[Any, Any]) -> Words:
    """Return four 32-bit words of Philox4x32-10. Inputs are integers, or int64 tensors or uint64 arrays of them."""
    c0, c1, c2, c3 = counter
    k0, k1 = key
    for _ in range(_ROUNDS):
        p0, p1 = _MULTIPLIERS[0] * c0, _MULTIPLIERS[1] * c2  # tensors wrap modulo 2**64, which keeps both halves right
        c0, c1 = ((p1 >> 32) & MASK) ^ c1 ^ k0, p1 & MASK
        c2, c3 = ((p0 >> 32) & MASK) ^ c3 ^ k1, p0 & MASK
        k0, k1 = (k0 + _WEYL[0]) & MASK, (k1 + _WEYL[1]) & MASK
    return c0, c1, c2, c3


def draw_words(key: Any, count: Any, purpose: int = EPISODE_PURPOSE) -> Words:
    """Return four 32-bit words for a 64-bit key and a count; tensors for int64 tensors.

    For episodes, the key is the environment's seed and the count is the number of the episode.
    """
    return philox((count & MASK, count >> 32 & MASK, purpose, 0), (key & MASK, key >> 32 & MASK))


def scale_word(word: Any, count: Any) -> Any:
    """Scale 32-bit words to integers from 0 to count - 1 (multiply and shift)."""
    return word * count >> 32


def check_seed(seed: Any) -> int:
    """Return the seed of an episode as an int, or raise `ConfigError`."""
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise ConfigError("seed", seed, "a whole number of at least 0")
    return int(seed)


def check_instance_seed(seed: Any) -> int:
    """Return the seed of a room as an int, or raise `ConfigError`. Files store seeds in 63 bits."""
    if check_seed(seed) >= 2**63:
        raise ConfigError("seed", seed, "a whole number from 0 to 2**63 - 1")
    return int(seed)


def fold_seed(seed: int) -> int:
    """Return the 64-bit key of a seed of any size: the seed itself below 2**64, otherwise a hash of it."""
    return seed if seed < 2**64 else int(np.random.SeedSequence(seed).generate_state(1, np.uint64)[0])


def draw_episode(seed: int, episode: int, starts: int) -> tuple[int, int]:
    """Return the index of an episode's start and the 63-bit key of its noise, from the environment's 64-bit seed."""
    first, second, third, _ = draw_words(seed, episode)
    return scale_word(first, starts), ((second << 32) | third) & (2**63 - 1)


def draw_puzzle_start(key: Any, starts: Any) -> Any:
    """Return the index of the puzzle's initial state in an episode, from the 64-bit key of the episode's noise."""
    return scale_word(draw_words(key, 0, PUZZLE_PURPOSE)[0], starts)


def draw_chance(key: int, primitive: int) -> float:
    """Return the uniform number in (0, 1) that decides a random outcome of the puzzle at a primitive of an episode."""
    return (draw_words(key, primitive, CHANCE_PURPOSE)[0] + 0.5) / 2**32


@functools.lru_cache(maxsize=256)
def _draw_block(key: int, block: int) -> list[tuple[int, int, int]]:
    """Draw the words of the noise of successive primitives at once: arrays take a fifth of the time of Python."""
    counts = np.arange(block * _BLOCK, (block + 1) * _BLOCK, dtype=np.uint64)
    return list(zip(*(words.tolist() for words in draw_words(key, counts, NOISE_PURPOSE)[:3]), strict=True))


def compute_noise(key: int, primitive: int) -> tuple[float, float]:
    """Return (standard normal, uniform in (0, 1)) for an episode and a primitive, both numbered from 0.

    The normal is computed by Box-Muller from the first two words, the uniform from the third.
    """
    block, place = divmod(primitive, _BLOCK)
    a, b, c = _draw_block(key, block)[place]
    scale = 1.0 / 2**32
    normal = math.sqrt(-2.0 * math.log((a + 0.5) * scale)) * math.cos(2.0 * math.pi * (b + 0.5) * scale)
    return normal, (c + 0.5) * scale
