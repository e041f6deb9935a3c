"""Screening designs: what of them is orthogonal."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from studies.factorial.design import MOST_FACTORS, make_screening_design


@pytest.mark.parametrize("factors", [1, 4, MOST_FACTORS])
def test_main_effects_are_orthogonal_to_each_other_and_to_interactions_of_two(factors: int):
    design = make_screening_design(factors)
    pairs = [design[:, list(pair)].prod(axis=1) for pair in itertools.combinations(range(factors), 2)]
    assert design.shape == (24, factors)
    assert (design.T @ design == 24 * np.eye(factors)).all()
    assert not np.any(design.sum(axis=0)) and not any(np.any(design.T @ pair) for pair in pairs)
    assert (design[0] == -1).all() and (design[-1] == 1).all() and (design[::-1] == -design).all()


def test_its_first_half_is_the_published_design():
    """Rows of Plackett and Burman (1946) for 12 trials, as sets of the factors that are high."""
    first = "++-+++---+-"
    published = {"".join(first[(place - shift) % 11] for place in range(11)) for shift in range(11)} | {"-" * 11}
    assert {"".join("+" if level > 0 else "-" for level in row) for row in make_screening_design(11)[:12]} == published


def test_any_three_factors_take_all_their_combinations_equally_often():
    design = make_screening_design(MOST_FACTORS)
    for chosen in itertools.combinations(range(MOST_FACTORS), 3):
        _, counts = np.unique(design[:, list(chosen)], axis=0, return_counts=True)
        assert counts.tolist() == [3] * 8


@pytest.mark.parametrize("factors", [0, 12])
def test_more_factors_than_rows_allow_are_refused(factors: int):
    with pytest.raises(ValueError, match="1 to 11"):
        make_screening_design(factors)
