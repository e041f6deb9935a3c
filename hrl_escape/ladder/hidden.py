"""Hidden tests without a server: seeds that nobody knows before the agents are frozen.

Post-dated seeds are the default. Agents are frozen, by the hash of their code and weights, before a date; the seeds
follow from public randomness that is published after it, such as a drand round or a pulse of the NIST beacon. Anybody
can derive them, run the test and verify the score, for ever.

Commit and reveal is the other way, where maintainers run the submissions: they publish `compute_commitment` of salt,
seeds and version with the release, and the salt and the seeds with the next.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence

from hrl_escape.errors import ConfigError

__all__ = ["compute_commitment", "derive_hidden_seed", "derive_seed"]


def derive_seed(*words: str | int) -> int:
    """Instance seed that follows from words: the first 63 bits of SHA-256 over them, joined by slashes."""
    digest = hashlib.sha256("/".join(map(str, words)).encode()).digest()
    return int.from_bytes(digest[:8], "big") >> 1


def derive_hidden_seed(randomness: str, benchmark: str, rung: str, index: int) -> int:
    """Seed of one room of a hidden test.

    Args:
        randomness: public random text, published after all agents were frozen; at least 16 characters.
        benchmark: name of the benchmark.
        rung: name of the rung.
        index: number of the room, from 0.

    Raises:
        ConfigError: too short a text to be random.
    """
    if len(randomness) < 16:
        raise ConfigError("randomness", randomness, "a public random text of at least 16 characters")
    return derive_seed(benchmark, rung, "hidden", randomness, index)


def compute_commitment(salt: str, seeds: Sequence[int], version: str) -> str:
    """Hash that commits to the seeds of a hidden test without telling them.

    Args:
        salt: secret random text, at least 16 characters; without it short lists of seeds could be guessed.
        seeds: instance seeds of the test.
        version: of the package that generates the rooms.

    Raises:
        ConfigError: too short a salt.
    """
    if len(salt) < 16:
        raise ConfigError("salt", salt, "a random text of at least 16 characters")
    text = json.dumps([salt, list(seeds), version], separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
