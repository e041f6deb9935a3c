"""Statistics against published formulas, exact enumeration and small cases worked by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate, stats

from hrl_escape.benchmark.statistics import (
    compute_area,
    compute_efficiency,
    compute_final,
    compute_iqm,
    compute_mean,
    compute_mean_efficiency,
    compute_profile,
    compute_score,
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


def test_efficiency_is_nothing_without_escape_and_one_at_the_fewest_known():
    escaped, primitives = [True, True, False, True], [34, 68, 34, 17]
    assert compute_efficiency(escaped, primitives, 34).tolist() == [1, 0.5, 0, 2]
    assert compute_mean_efficiency(escaped, primitives, 34, is_expected=False) == (1 + 0.5 + 0 + 1) / 4
    assert compute_mean_efficiency(escaped, primitives, 34, is_expected=True) == (1 + 0.5 + 0 + 2) / 4
    assert compute_mean_efficiency([True] * 2, [17, 34], 34, is_expected=True) == 1.0, "1.5, capped"


# --- interquartile mean ----------------------------------------------------------------


def test_iqm_of_eight_runs_is_the_mean_of_the_middle_four():
    assert compute_iqm([np.array([100.0, 1, 2, 3, 4, -50, 0, 9])]) == (1 + 2 + 3 + 4) / 4


def test_iqm_of_ten_runs_leaves_out_two_at_each_end():
    """10 / 4 = 2.5 is rounded down, as in rliable's trim_mean."""
    assert compute_iqm([np.arange(10.0) ** 2]) == np.mean([4, 9, 16, 25, 36, 49])


@given(st.lists(runs, min_size=1, max_size=4))
def test_iqm_is_scipys_trimmed_mean_of_all_runs_of_all_rooms(scores):
    assert compute_iqm(scores) == pytest.approx(stats.trim_mean(np.concatenate(scores), 0.25))


@pytest.mark.nightly
@given(st.lists(runs, min_size=1, max_size=4))
def test_iqm_of_runs_with_weights_is_that_of_as_many_copies(scores):
    """Weights of 1/4 and 3/4 are one copy and three, in a number that quarters divide."""
    weights = [np.where(np.arange(len(room)) == 0, 3.0, 1.0) / (len(room) + 2) for room in scores]
    for room, weight in zip(scores, weights, strict=True):
        copies = np.repeat(room, np.where(np.arange(len(room)) == 0, 12, 4))
        assert compute_iqm([room], [weight]) == pytest.approx(stats.trim_mean(copies, 0.25))
        assert compute_mean([room], [weight]) == pytest.approx(copies.mean())


def test_mean_weighs_rooms_the_same():
    rooms = [np.array([0.0, 1.0]), np.ones(6)]
    assert compute_mean(rooms) == compute_mean(rooms, [np.full(2, 1 / 2), np.full(6, 1 / 6)]) == 0.75


def test_iqm_keeps_leading_axes():
    scores = rng().normal(size=(3, 2, 8))
    assert compute_iqm([scores]).shape == (3, 2)
    assert compute_iqm([scores])[1, 1] == pytest.approx(compute_iqm([scores[1, 1]]))


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
