"""Counter-based random numbers: noise is a pure function of (episode key, primitive number).

Philox4x32-10 (Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3"). Because
nothing is kept between primitives, a restored state meets the same noise, and a room
meets the same noise in whichever batch it is stepped.
"""

from __future__ import annotations

import math

_MASK = 0xFFFFFFFF
_MULTIPLIERS = (0xD2511F53, 0xCD9E8D57)
_WEYL = (0x9E3779B9, 0xBB67AE85)
ROUNDS = 10
EPISODE_PURPOSE = 1
"""Third word of the counter for draws at an episode's start; noise has the word 0."""
CHANCE_PURPOSE = 2
"""Third word of the counter for the random outcomes of a puzzle."""
PUZZLE_PURPOSE = 3
"""Third word of the counter for the puzzle's first state."""


def philox(counter: tuple[int, int, int, int], key: tuple[int, int]) -> tuple[int, int, int, int]:
    """Return four 32-bit words of Philox4x32-10."""
    c0, c1, c2, c3 = counter
    k0, k1 = key
    for _ in range(ROUNDS):
        p0, p1 = _MULTIPLIERS[0] * c0, _MULTIPLIERS[1] * c2
        c0, c1, c2, c3 = (p1 >> 32) ^ c1 ^ k0, p1 & _MASK, (p0 >> 32) ^ c3 ^ k1, p0 & _MASK
        k0, k1 = (k0 + _WEYL[0]) & _MASK, (k1 + _WEYL[1]) & _MASK
    return c0, c1, c2, c3


def draw_episode(seed: int, episode: int, starts: int) -> tuple[int, int]:
    """Return the number of an episode's start and the 63-bit key of its noise.

    Args:
        seed: key of the environment's random numbers, 64 bits.
        episode: number of the episode since seeding, from 0.
        starts: number of starts.
    """
    counter = (episode & _MASK, episode >> 32, EPISODE_PURPOSE, 0)
    first, second, third, _ = philox(counter, (seed & _MASK, seed >> 32 & _MASK))
    return first * starts >> 32, ((second << 32) | third) & (2**63 - 1)


def draw_puzzle_start(key: int, starts: int) -> int:
    """Return the number of the puzzle's first state in an episode, by the 64-bit key of the episode's noise."""
    return philox((0, 0, PUZZLE_PURPOSE, 0), (key & _MASK, key >> 32))[0] * starts >> 32


def draw_chance(key: int, primitive: int) -> float:
    """Return the uniform number in (0, 1) that decides a puzzle's random outcome at a primitive of an episode."""
    word, *_ = philox((primitive & _MASK, primitive >> 32, CHANCE_PURPOSE, 0), (key & _MASK, key >> 32))
    return (word + 0.5) / 2**32


def compute_noise(key: int, primitive: int) -> tuple[float, float]:
    """Return (standard normal, uniform in (0, 1)) for a primitive of an episode.

    Args:
        key: 64-bit key of the episode.
        primitive: number of the primitive within the episode, from 0.

    The normal is Box-Muller on the first two words, the uniform comes from the third.
    """
    a, b, c, _ = philox((primitive & _MASK, primitive >> 32, 0, 0), (key & _MASK, key >> 32))
    scale = 1.0 / 2**32
    normal = math.sqrt(-2.0 * math.log((a + 0.5) * scale)) * math.cos(2.0 * math.pi * (b + 0.5) * scale)
    return normal, (c + 0.5) * scale
