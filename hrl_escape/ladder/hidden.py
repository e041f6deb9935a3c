"""Hidden tests without a server: seeds that nobody knows before the agents are frozen.

Post-dated seeds are the default. A season announces a round of a public beacon, drand's quicknet, that lies ahead;
agents are frozen, by the hash of their code and weights, before it; the seeds follow from the round's value. Anybody
can derive them, run the test and verify the score, for ever. A round has one value and a value one canonical form, so
nobody can choose among tests by spelling it otherwise.
"""

from __future__ import annotations

import hashlib
import re
from typing import NamedTuple

from hrl_escape.errors import ConfigError

_ROUND = re.compile(r"(?:drand\W+)?quicknet\W+(?:round\W+)?(\d+)\W+(?:randomness\W+)?(?:0x)?([0-9a-f]{64})", re.ASCII)


class Beacon(NamedTuple):
    """One round of drand's quicknet chain (https://api.drand.sh, chain 52db9ba70e0c...)."""

    round: int  # its number
    value: str  # its randomness, 64 lower-case hexadecimal digits

    def __str__(self) -> str:
        return f"quicknet {self.round} {self.value}"


def read_beacon(text: str) -> Beacon:
    """Read a round from text, such as `quicknet 4242 1f9c...`; spellings of one round give one value.

    Raises:
        ConfigError: no round of quicknet with a value of 64 hexadecimal digits.
    """
    found = _ROUND.fullmatch(text.strip().lower())
    if found is None or int(found[1]) == 0:
        raise ConfigError("beacon", text, "a round of drand's quicknet and its randomness, 'quicknet 4242 1f9c...', "
                          "which has 64 hexadecimal digits")
    return Beacon(int(found[1]), found[2])


def derive_seed(*words: str | int) -> int:
    """Instance seed that follows from words: the first 63 bits of SHA-256 over them, joined by slashes."""
    digest = hashlib.sha256("/".join(map(str, words)).encode()).digest()
    return int.from_bytes(digest[:8], "big") >> 1


def derive_hidden_seed(beacon: Beacon, benchmark: str, rung: str, index: int) -> int:
    """Seed of one room of a hidden test, numbered from 0.

    The beacon is a round that was announced before, and published after all agents were frozen.
    """
    return derive_seed(benchmark, rung, "hidden", str(beacon), index)
