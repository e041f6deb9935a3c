"""Statistics against published formulas, exact enumeration and small cases worked by hand."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate, stats

from hrl_escape.experiments.statistics import (
    compute_area,
    compute_final,
    compute_improvement,
    compute_interval,
    compute_iqm,
    compute_profile,
    compute_score,
    compute_slope,
    split_gap,
)

runs = st.lists(st.integers(-5, 5).map(float), min_size=1, max_size=9).map(np.array)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


# --- score -----------------------------------------------------------------------------


def test_score_is_nothing_at_the_worst_and_one_at_the_best():
    assert compute_score([-1000, 86, -457], -1000, 86).tolist() == pytest.approx([0.0, 1.0, 0.5])


def test_score_beyond_the_best_known_is_not_hidden():
    assert compute_score(88, -1000, 86) > 1


# --- interquartile mean ----------------------------------------------------------------


def test_iqm_of_eight_runs_is_the_mean_of_the_middle_four():
    assert compute_iqm([np.array([100.0, 1, 2, 3, 4, -50, 0, 9])]) == (1 + 2 + 3 + 4) / 4


def test_iqm_of_ten_runs_leaves_out_two_at_each_end():
    """10 / 4 = 2.5 is rounded down, as in rliable's trim_mean."""
    assert compute_iqm([np.arange(10.0) ** 2]) == np.mean([4, 9, 16, 25, 36, 49])


@given(st.lists(runs, min_size=1, max_size=4))
def test_iqm_is_scipys_trimmed_mean_of_all_runs_of_all_rooms(scores):
    assert compute_iqm(scores) == pytest.approx(stats.trim_mean(np.concatenate(scores), 0.25))


def test_iqm_keeps_leading_axes():
    scores = rng().normal(size=(3, 2, 8))
    assert compute_iqm([scores]).shape == (3, 2)
    assert compute_iqm([scores])[1, 1] == pytest.approx(compute_iqm([scores[1, 1]]))


# --- probability of improvement --------------------------------------------------------


@given(runs, runs)
def test_improvement_in_one_room_is_the_mann_whitney_u_over_the_pairs(x, y):
    u = stats.mannwhitneyu(x, y).statistic
    assert compute_improvement([x], [y]) == pytest.approx(u / (len(x) * len(y)))


def test_improvement_weighs_rooms_the_same():
    """Room 1: 4 of 4 pairs; room 2: one pair, a tie."""
    first, second = [np.array([3.0, 4]), np.array([1.0])], [np.array([1.0, 2]), np.array([1.0])]
    assert compute_improvement(first, second) == (1 + 0.5) / 2


@given(st.lists(st.tuples(runs, runs), min_size=1, max_size=3))
def test_improvement_of_one_and_of_the_other_add_up_to_one(rooms):
    first, second = [x for x, _ in rooms], [y for _, y in rooms]
    assert compute_improvement(first, second) + compute_improvement(second, first) == pytest.approx(1)


def test_improvement_refuses_different_rooms():
    with pytest.raises(ValueError, match="1 rooms cannot be compared with 2"):
        compute_improvement([np.ones(1)], [np.ones(1), np.ones(1)])


# --- performance profile ---------------------------------------------------------------


def test_profile_is_the_share_of_runs_strictly_above_each_threshold():
    scores = [np.array([0.0, 0.5, 1.0, 1.0])]
    assert compute_profile(scores, [-0.1, 0, 0.5, 0.9, 1]).tolist() == [1, 0.75, 0.5, 0.5, 0]


def test_profile_averages_rooms_not_runs():
    scores = [np.array([1.0]), np.array([0.0, 0.0, 0.0, 1.0])]
    assert compute_profile(scores, [0.5]).tolist() == [(1 + 0.25) / 2]


@given(runs)
def test_profiles_integral_above_the_least_score_is_the_mean(scores):
    """E[X] = c + the integral of P(X > t) from c on: exact for whole numbers, at thresholds between them."""
    least, most = scores.min(), scores.max()
    thresholds = np.arange(least, most) + 0.5
    assert least + compute_profile([scores], thresholds).sum() == pytest.approx(scores.mean())


# --- bootstrap -------------------------------------------------------------------------


def enumerate_resamples(*rooms: np.ndarray) -> list[list[np.ndarray]]:
    """All equally likely stratified bootstrap samples."""
    return [list(drawn) for drawn in itertools.product(
        *([np.array(sample) for sample in itertools.product(room, repeat=len(room))] for room in rooms))]


def test_interval_is_that_of_all_resamples_within_rooms():
    rooms = [np.array([0.0, 0.2, 0.7]), np.array([0.5, 0.8, 1.0])]
    every = np.array([compute_iqm(sample) for sample in enumerate_resamples(*rooms)])
    for level in (0.5, 0.8):
        found = compute_interval(compute_iqm, rooms, rng=rng(), resamples=200_000, level=level)
        exact = np.quantile(every, [(1 - level) / 2, (1 + level) / 2])
        assert found == pytest.approx(exact, abs=0.02)


def test_interval_never_mixes_rooms():
    """Each room's runs agree, so nothing is uncertain however different the rooms are."""
    low, high = compute_interval(compute_iqm, [np.zeros(5), np.ones(5)], rng=rng())
    assert low == high == 0.5


def test_interval_of_two_groups_draws_each_independently():
    """With runs {0, 1} in both, the 16 resamples give P(improvement) with known shares."""
    two = np.array([0.0, 1.0])
    shares = [float(compute_improvement([x], [y])) for [x], [y] in
              itertools.product(enumerate_resamples(two), enumerate_resamples(two))]
    low, high = compute_interval(compute_improvement, [two], [two], rng=rng(), resamples=100_000, level=0.75)
    assert (low, high) == pytest.approx(tuple(np.quantile(shares, [0.125, 0.875])))
    assert (low, high) == (0.25, 0.75)


def test_interval_of_a_curve_has_the_curves_shape_and_keeps_runs_together():
    """Runs are rows of a whole curve: where each run is constant, the interval is too."""
    curves = np.repeat(rng().normal(size=(1, 6)), 4, axis=0)  # (points, runs)
    low, high = compute_interval(compute_iqm, [curves], rng=rng())
    assert low.shape == high.shape == (4,)
    assert len(set(low)) == len(set(high)) == 1


def test_interval_covers_the_truth_as_often_as_it_says():
    """The mean of 20 normal numbers, 400 times: the percentile bootstrap covers about 93 %."""
    source = rng(1)
    covered = 0
    for _ in range(400):
        low, high = compute_interval(lambda s: s[0].mean(axis=-1), [source.normal(size=20)], rng=source, resamples=500)
        covered += bool(low <= 0 <= high)
    assert 0.89 <= covered / 400 <= 0.97


def test_interval_is_the_same_for_the_same_generator():
    scores = [rng().normal(size=10)]
    assert compute_interval(compute_iqm, scores, rng=rng(3)) == compute_interval(compute_iqm, scores, rng=rng(3))


# --- curves and runs -------------------------------------------------------------------


def test_area_of_a_line_is_its_mean_height():
    assert compute_area([0, 100], [0, 1], 100) == 0.5


def test_area_stops_at_the_budget_and_goes_on_to_it():
    assert compute_area([0, 200], [0, 1], 100) == pytest.approx(0.25)
    assert compute_area([0, 50], [0, 1], 100) == pytest.approx(0.75)


@given(st.lists(st.tuples(st.integers(1, 50), st.integers(-3, 3)), min_size=1, max_size=8, unique_by=lambda p: p[0]))
def test_area_is_the_integral_of_the_interpolated_curve(points):
    x, y = (np.array(values, float) for values in zip(*sorted(points), strict=True))
    exact = sum(integrate.quad(lambda t: np.interp(t, x, y), a, a + 1)[0] for a in range(40))
    assert compute_area(x, y, 40) == pytest.approx(exact / 40)


def test_a_run_comes_to_the_mean_of_its_last_fifth():
    assert compute_final([0, 50, 79, 80, 90, 103], [9, 9, 9, 1, 2, 6], 100) == 3
    assert compute_final([0, 100], [1, 5], 100) == 5


def test_gaps_add_up_to_what_is_missing():
    gap = split_gap(score=0.7, reachable=0.95)
    assert gap == pytest.approx((0.05, 0.25)) and sum(gap) == pytest.approx(0.3)


# --- slope -----------------------------------------------------------------------------


def test_slope_is_that_of_linear_regression_over_the_chosen_part():
    x, y = np.arange(10.0), np.array([9, 9, 9, 9, 1, 4, 2, 6, np.nan, 5])
    kept = [4, 5, 6, 7, 9]
    assert compute_slope(x, y, 4, 9) == pytest.approx(stats.linregress(x[kept], y[kept]).slope)


def test_slope_of_fewer_than_two_measurements_is_none():
    assert compute_slope([0, 1], [3, np.nan], 0, 1) == compute_slope([], [], 0, 1) == 0
