"""Merkle trees: every leaf can be proved, and nothing else."""

import hashlib

import pytest

from hrl_escape.ladder.certificate import check_proof, compute_root, prove_leaf


def make_leaves(count):
    return [hashlib.sha256(str(i).encode()).hexdigest() for i in range(count)]


@pytest.mark.parametrize("count", [1, 2, 3, 7, 8, 100])
def test_every_leaf_is_proved_and_no_other_is(count):
    leaves = make_leaves(count)
    root = compute_root(leaves)
    for index, leaf in enumerate(leaves):
        proof = prove_leaf(leaves, index)
        assert check_proof(leaf, proof, root) and len(proof) <= 7
        assert not check_proof(make_leaves(count + 1)[-1], proof, root)


def test_order_and_content_decide_the_root():
    leaves = make_leaves(5)
    assert len({compute_root(each) for each in (leaves, leaves[::-1], leaves[:4], [*leaves, leaves[4]])}) == 4
