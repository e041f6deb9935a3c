"""Merkle trees: a root stands for all leaves, in order."""

import hashlib

from hrl_escape.sets.benchmark import compute_root


def make_leaves(count):
    return [hashlib.sha256(str(i).encode()).hexdigest() for i in range(count)]


def test_order_and_content_decide_the_root():
    leaves = make_leaves(5)
    assert len({compute_root(each) for each in (leaves, leaves[::-1], leaves[:4], [*leaves, leaves[4]])}) == 4
