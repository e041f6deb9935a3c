"""Analysis of variance against published worked examples and scipy."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import stats

from hrl_escape.errors import ComparisonError
from hrl_escape.experiments.studies.contrasts import analyse, make_half_fraction

STANDARD_ORDER = np.array([levels[::-1] for levels in itertools.product((-1, 1), repeat=4)])
FILTRATION = [45, 71, 48, 65, 68, 60, 80, 65, 43, 100, 45, 104, 75, 86, 70, 96]
"""Filtration rate in a pilot plant: Montgomery, Design and Analysis of Experiments, example 6.2, table 6.10."""


def test_the_pilot_plants_effects_and_sums_of_squares_are_the_published_ones():
    analysis = analyse("ABCD", STANDARD_ORDER, ["plant"] * 16, FILTRATION)
    effects = {"".join(term.factors): term.effect for term in analysis.terms}
    published = {"A": 21.625, "B": 3.125, "C": 9.875, "D": 14.625, "AB": 0.125, "AC": -18.125, "AD": 16.625,
                 "BC": 2.375, "BD": -0.375, "CD": -1.125}
    assert effects == pytest.approx(published)
    squares = {"".join(term.factors): round(5730.94 * term.share, 2) for term in analysis.terms}
    assert squares["A"] == 1870.56 and squares["AC"] == 1314.06 and squares["AD"] == 1105.56
    assert squares["D"] == 855.56 and squares["C"] == 390.06
    assert analysis.residual_freedom == 5


def test_with_one_factor_f_and_p_are_those_of_a_t_test():
    rng = np.random.default_rng(1)
    low, high = rng.normal(0, 1, 9), rng.normal(0.8, 1, 9)
    levels = [[-1]] * 9 + [[1]] * 9
    term = analyse(["x"], levels, ["all"] * 18, [*low, *high]).terms[0]
    reference = stats.ttest_ind(high, low)
    interval = reference.confidence_interval()
    assert term.effect == pytest.approx(high.mean() - low.mean())
    assert (term.f, term.p) == pytest.approx((reference.statistic**2, reference.pvalue))
    assert (term.low, term.high) == pytest.approx((interval.low, interval.high))


def test_what_lies_between_blocks_is_taken_out_of_the_error():
    levels = np.tile(STANDARD_ORDER, (2, 1))
    shift = np.repeat([0.0, 1000.0], 16)
    blocks = ["a"] * 16 + ["b"] * 16
    response = np.tile(FILTRATION, 2) + shift + np.random.default_rng(0).normal(0, 1, 32)
    analysis = analyse("ABCD", levels, blocks, response)
    assert analysis.block_share > 0.99 and analysis.get_term("A").p < 1e-3
    assert analysis.get_term("A").effect == pytest.approx(21.6, abs=1)
    assert analyse("ABCD", levels, ["one"] * 32, response).get_term("A").p > 0.5
    total = sum(term.share for term in analysis.terms) + analysis.block_share + analysis.residual_share
    assert total == pytest.approx(1)


def test_the_half_fraction_is_orthogonal_in_all_effects_and_interactions_of_two():
    design = make_half_fraction(6)
    assert len({tuple(row) for row in design.tolist()}) == len(design) == 32
    terms = [(i,) for i in range(6)] + list(itertools.combinations(range(6), 2))
    columns = np.stack([design[:, list(term)].prod(axis=1) for term in terms])
    assert (columns @ columns.T == len(design) * np.eye(len(terms))).all()
    assert [-1] * 6 in design.tolist() and [1] * 6 in design.tolist()


def test_a_missing_run_and_too_few_runs_are_refused():
    with pytest.raises(ComparisonError, match="not balanced"):
        analyse("ABCD", STANDARD_ORDER[1:], ["plant"] * 15, FILTRATION[1:])
    with pytest.raises(ComparisonError, match="too few"):
        analyse("AB", [[-1, -1], [-1, 1], [1, -1], [1, 1]], ["x"] * 4, [1, 2, 3, 4])
