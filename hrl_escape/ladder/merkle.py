"""Merkle trees: one hash commits to a whole set, and a few hashes prove that a room belongs to it."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

Proof = tuple[tuple[str, str], ...]
"""For each level from the leaf upwards: the side, `left` or `right`, of the other node, and its hash."""


def _join(left: str, right: str) -> str:
    return hashlib.sha256(b"\x01" + bytes.fromhex(left) + bytes.fromhex(right)).hexdigest()


def _climb(level: Sequence[str]) -> list[str]:
    """Next level up; a last node without partner rises as it is."""
    pairs = [_join(left, right) for left, right in zip(level[::2], level[1::2], strict=False)]
    return pairs + list(level[-1:]) * (len(level) % 2)


def compute_root(leaves: Sequence[str]) -> str:
    """Root of leaves, hexadecimal SHA-256 digests in order; that of no leaves is the hash of nothing."""
    level = list(leaves)
    while len(level) > 1:
        level = _climb(level)
    return level[0] if level else hashlib.sha256(b"").hexdigest()


def prove_leaf(leaves: Sequence[str], index: int) -> Proof:
    """Proof that a leaf is in the tree, for `check_proof`."""
    level, proof = list(leaves), []
    while len(level) > 1:
        other = index ^ 1
        if other < len(level):
            proof.append(("left" if other < index else "right", level[other]))
        level, index = _climb(level), index // 2
    return tuple(proof)


def check_proof(leaf: str, proof: Proof, root: str) -> bool:
    """Return whether a proof shows that a leaf is in the tree of this root."""
    for side, other in proof:
        leaf = _join(other, leaf) if side == "left" else _join(leaf, other)
    return leaf == root
