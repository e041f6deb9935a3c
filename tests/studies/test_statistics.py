"""Statistics of the studies, beside textbooks and scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from studies.statistics import (
    compare_signs,
    compute_median_interval,
    compute_restricted_mean,
    compute_sign_flip_p,
    compute_slope,
    cut_signs,
)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


# --- time to an event ------------------------------------------------------------------


def test_restricted_mean_of_runs_censored_at_the_horizon_is_the_mean_of_capped_times():
    assert compute_restricted_mean([100, 300, 1000, 1000], [True, True, False, False], 1000) == 600


def test_restricted_mean_is_the_area_under_the_survival_curve():
    """Survival 1 to 2, 3/4 to 3, then 3/4 x 1/2 to 5 (one was lost at 3, so two are left), then 0."""
    found = compute_restricted_mean([2, 3, 4, 5], [True, False, True, True], 10)
    assert found == pytest.approx(2 + 0.75 * (4 - 2) + 0.375 * (5 - 4))
    survival = stats.ecdf(stats.CensoredData(uncensored=[2, 4, 5], right=[3])).sf
    assert found == pytest.approx(sum(survival.evaluate(np.arange(0, 10, 0.01)) * 0.01), abs=0.02)


# --- signs -----------------------------------------------------------------------------


@pytest.mark.parametrize("count", range(1, 11))
def test_differences_of_nought_and_one_have_the_p_of_their_signs(count: int):
    """Only those that are not 0 have a sign: all of them up, by chance, once in 2 to their number."""
    differences = [1.0] * count + [0.0] * (10 - count)
    assert compute_sign_flip_p(differences, "above") == 0.5**count
    assert compute_sign_flip_p([-each for each in differences], "below") == 0.5**count
    assert compute_sign_flip_p(differences, "below") == 1.0


def test_the_p_of_signs_is_scipys_over_all_of_them():
    differences = rng(3).normal(0.4, 1.0, 9)
    for side, alternative in (("above", "greater"), ("below", "less")):
        exact = stats.permutation_test((differences,), np.mean, permutation_type="samples", n_resamples=np.inf,
                                       alternative=alternative).pvalue
        assert compute_sign_flip_p(differences, side) == pytest.approx(exact)


def test_drawn_signs_of_many_differences_never_give_nought():
    """The differences themselves are one of the draws."""
    assert compute_sign_flip_p(np.ones(40), "above") == 2.0**-14
    assert compute_sign_flip_p(rng(1).normal(0.0, 1.0, 40), "above") == pytest.approx(
        1 - compute_sign_flip_p(rng(1).normal(0.0, 1.0, 40), "below"), abs=0.02)


def test_equal_sums_count_as_reached_whatever_their_rounding():
    assert compute_sign_flip_p([0.1, 0.2, -0.3], "above") == 5 / 8


# --- slope -----------------------------------------------------------------------------


def test_slope_is_that_of_linear_regression_over_the_chosen_part():
    x, y = np.arange(10.0), np.array([9, 9, 9, 9, 1, 4, 2, 6, np.nan, 5])
    kept = [4, 5, 6, 7, 9]
    assert compute_slope(x, y, 4, 9) == pytest.approx(stats.linregress(x[kept], y[kept]).slope)


def test_slope_of_fewer_than_two_measurements_is_none():
    assert compute_slope([0, 1], [3, np.nan], 0, 1) == compute_slope([], [], 0, 1) == 0


# --- intervals -------------------------------------------------------------------------


@pytest.mark.nightly
def test_the_interval_of_a_median_is_that_of_order_statistics():
    """Of ten numbers the second and the ninth: the median lies outside with probability 2 (1 + 10) / 1,024 = 2.1 %."""
    assert compute_median_interval(range(10, 0, -1)) == (5.5, 2, 9)
    assert compute_median_interval([1, 2, 3, 4, *[np.inf] * 6]) == (np.inf, 2, np.inf)
    assert compute_median_interval(range(5)) == (2, 0, np.inf), "too few for an interval"
    inside = [low <= 0 <= high for _, low, high in (compute_median_interval(rng(seed).normal(size=10))
                                                    for seed in range(2_000))]
    assert np.mean(inside) == pytest.approx(1 - 22 / 1_024, abs=0.01)


def test_the_interval_of_signs_leaves_out_nought_where_their_test_does():
    for seed in range(40):
        values = rng(seed).normal(0.6, size=10)
        p = 2 * min(compute_sign_flip_p(values, "above"), compute_sign_flip_p(values, "below"))
        low, high = cut_signs(values, 0.95)
        assert (low > 0 or high < 0) == (p <= 0.05) and low < values.mean() < high
    assert cut_signs(rng(0).normal(size=4), 0.95) == (-np.inf, np.inf)


def test_a_difference_has_a_sign_only_where_its_test_finds_one():
    found = compare_signs({"none": np.tile([1.0, -0.9], 6), "above": np.linspace(1, 2, 12), "few": np.ones(4)})
    assert [each.mean > 0 for each in found.values()] == [True, True, True]
    assert [each.sign for each in found.values()] == [0, 1, 0]
    assert compare_signs({"below": -np.linspace(1, 2, 12)})["below"].sign == -1
