"""Intervals and tests against closed forms and against how often they are wrong."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from hrl_escape.benchmark.inference import (
    compare_agents,
    compare_pairs,
    compute_interval,
    compute_wilson_interval,
    correct_by_holm,
)
from hrl_escape.benchmark.statistics import compute_iqm, compute_mean
from studies.statistics import choose_holm_levels

UNIT = (0.0, 1.0)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


# --- intervals -------------------------------------------------------------------------


@pytest.mark.parametrize("hits", range(9))
def test_interval_of_a_share_is_that_of_clopper_and_pearson(hits: int):
    runs = np.array([1.0] * hits + [0.0] * (8 - hits))
    exact = stats.binomtest(hits, 8).proportion_ci(method="exact")
    found = compute_interval(compute_mean, [runs], UNIT, rng(), resamples=200_000)
    assert found == pytest.approx((exact.low, exact.high), abs=0.01)


def make_bimodal(source: np.random.Generator, runs: int, share: float = 0.7) -> np.ndarray:
    """Runs that end near 0.9 with this probability, near 0.05 otherwise."""
    hit = source.random(runs) < share
    return np.clip(np.where(hit, 0.9, 0.05) + source.normal(0, 0.03, runs), 0, 1)


@pytest.mark.nightly_for(
    "compute_iqm-2-0.9", "compute_iqm-2-0.7", "compute_iqm-1-0.9", "compute_iqm-1-0.5", "compute_mean-2-0.7",
    "compute_mean-1-0.9")
@pytest.mark.parametrize("share", [0.5, 0.7, 0.9])
@pytest.mark.parametrize("rooms", [1, 2])
@pytest.mark.parametrize("statistic", [compute_iqm, compute_mean])
def test_interval_of_eight_bimodal_runs_covers_the_truth(share: float, rooms: int, statistic):
    source = rng(1)
    truth = statistic([make_bimodal(source, 200_000, share)])
    covered = 0
    for _ in range(200):
        scores = [make_bimodal(source, 8, share) for _ in range(rooms)]
        low, high = compute_interval(statistic, scores, UNIT, source, resamples=500)
        covered += bool(low <= truth <= high)
    assert covered / 200 >= 0.95


def test_interval_of_runs_that_agree_is_not_nothing():
    low, high = compute_interval(compute_iqm, [np.ones(8)], UNIT, rng())
    assert low < 0.8 and high == 1


def test_interval_of_a_curve_has_the_curves_shape_and_keeps_runs_together():
    curves = np.repeat(rng().random((1, 6)), 4, axis=0)  # (points, runs)
    low, high = compute_interval(compute_iqm, [curves], UNIT, rng())
    assert low.shape == high.shape == (4,)
    assert len(set(low)) == len(set(high)) == 1


def test_interval_is_the_same_for_the_same_generator():
    scores = [rng().random(10)]
    assert compute_interval(compute_iqm, scores, UNIT, rng(3)) == compute_interval(compute_iqm, scores, UNIT, rng(3))


@given(st.integers(0, 20), st.integers(1, 20))
def test_wilsons_interval_is_scipys(hits: int, misses: int):
    tries = hits + misses
    exact = stats.binomtest(hits, tries).proportion_ci(method="wilson")
    assert compute_wilson_interval(hits / tries, tries) == pytest.approx((exact.low, exact.high))


# --- paired tests ----------------------------------------------------------------------


def test_paired_test_in_one_room_is_students():
    values = rng().normal(0.1, 0.2, 9)
    exact = stats.ttest_1samp(values, 0)
    found = compare_pairs([values])
    assert (found.difference, found.p) == pytest.approx((values.mean(), exact.pvalue))
    assert (found.low, found.high) == pytest.approx(tuple(exact.confidence_interval(0.95)))


def test_rooms_are_strata_whose_differences_are_no_noise():
    one, other = rng(1).normal(0.2, 0.05, 5), rng(2).normal(0.6, 0.05, 5)
    found = compare_pairs([one, other])
    assert found.difference == pytest.approx((one.mean() + other.mean()) / 2)
    assert found.p < stats.ttest_1samp(np.concatenate([one, other]), 0).pvalue


def test_identical_runs_are_no_difference_and_one_pair_says_nothing():
    assert compare_pairs([np.zeros(8)]).p == 1
    assert compare_pairs([np.array([0.3])]).p == compare_pairs([]).p == 1


def test_one_pair_in_some_room_says_nothing_whatever_the_other_rooms_say():
    """Of one pair there is no spread, so that no mean over rooms has an error that is known."""
    many = np.array([0.2, 0.21, 0.22, 0.2])
    for rooms in ([many, np.array([0.4])], [np.array([0.4]), many], [many, np.array([0.4]), np.array([])]):
        found = compare_pairs(rooms)
        assert (found.low, found.high, found.p, found.pairs) == (-math.inf, math.inf, 1.0, 5)
        assert found.difference == pytest.approx((0.2075 + 0.4) / 2)
    assert compare_pairs([many, np.array([])]).p == compare_pairs([many]).p < 0.01, "a room without pairs is left out"


def test_two_agents_are_compared_alike_from_either_side():
    """Shares of improvement add up to one, differences to nothing, and each interval to that of the other side."""
    source = rng(5)
    finals = [{(room, seed): float(source.normal(mean, 0.2)) for room in "ab" for seed in range(6)}
              for mean in (0.3, 0.5, 0.9)]
    pairs = compare_agents(finals, [True] * 3, rng(), resamples=200)
    for first, second in itertools.permutations(range(3), 2):
        here, there = pairs[first][second], pairs[second][first]
        gain = np.mean([finals[first][key] - finals[second][key] for key in finals[0]])
        wins = np.mean([finals[first][key] > finals[second][key] for key in finals[0]])
        assert (here.difference.value, here.improvement.value) == pytest.approx((gain, wins))
        assert (here.p, here.count) == (there.p, there.count) == (here.p, 12)
        for mine, other, total in ((here.difference, there.difference, 0), (here.improvement, there.improvement, 1)):
            assert mine.low < mine.value < mine.high or mine.value in (0, 1) and mine.low <= mine.value <= mine.high
            assert [mine.low + other.high, mine.high + other.low] == pytest.approx([total] * 2)


@pytest.mark.parametrize("law", [(0.5, 0.5), (0.3, 0.4, 0.3), (0.25, 0.25, 0.25, 0.25), (0.4, 0.1, 0.1, 0.4)])
@pytest.mark.parametrize("count", [2, 3])
def test_equal_differences_of_identical_agents_are_rarer_than_their_p_says(law: tuple[float, ...], count: int):
    """Exact: scores 0, 1, ... with these chances, and all pairs of runs that so many seeds may have."""
    share, p = 0.0, 0.0
    scores = range(len(law))
    for runs in itertools.product(itertools.product(scores, scores), repeat=count):
        differences = np.array([float(first - second) for first, second in runs])
        if differences[0] != 0 and np.all(differences == differences[0]):
            share += math.prod(law[first] * law[second] for first, second in runs)
            p = compare_pairs([differences]).p
    assert 0 < share <= p < 1


@pytest.mark.parametrize("count", range(5, 11))
def test_equal_differences_say_more_than_those_with_one_tie_among_them(count: int):
    ones = np.ones(count)
    clean, tied = compare_pairs([0.37 * ones]).p, compare_pairs([np.append(ones[1:], 0.0)]).p
    assert 0 < clean < tied and clean == 4.0 ** (1 - count)
    assert compare_pairs([0.37 * ones, -0.1 * ones, 0 * ones]).p == pytest.approx(clean**2), "each room by itself"


def test_holms_correction_is_that_of_the_textbook():
    """Holm (1979): 0.01 x 4, 0.02 x 3, then none below a smaller one's."""
    assert correct_by_holm([0.02, 0.01, 0.9, 0.025]) == pytest.approx([0.06, 0.04, 0.9, 0.06])
    assert correct_by_holm([]) == []


@given(st.lists(st.floats(0, 1), min_size=1, max_size=6))
def test_holm_keeps_the_order_and_lies_between_none_and_bonferroni(p: list[float]):
    adjusted = correct_by_holm(p)
    for (a, b), (x, y) in zip(itertools.pairwise(sorted(p)), itertools.pairwise(sorted(adjusted)), strict=True):
        assert a <= b and x <= y
    assert all(raw <= value <= min(1, len(p) * raw) + 1e-12 for raw, value in zip(p, adjusted, strict=True))


def test_an_interval_leaves_out_zero_just_where_the_corrected_test_finds_a_difference():
    rng, both = np.random.default_rng(3), set()
    for _ in range(300):
        family = [[rng.normal(mean, 1.0, 10)] for mean in rng.choice([0.0, 0.6, 0.9, 1.2], 5)]
        p = [compare_pairs(differences).p for differences in family]
        levels, alone = choose_holm_levels(p), [compare_pairs(differences) for differences in family]
        for differences, corrected, level, single in zip(family, correct_by_holm(p), levels, alone, strict=True):
            found = compare_pairs(differences, level)
            assert (found.low > 0 or found.high < 0) == (corrected < 0.05)
            assert found.low <= single.low and found.high >= single.high
            both.add((corrected < 0.05, single.p < 0.05))
    assert len(both) == 3, "some differences that are found alone are not in their family"
    assert choose_holm_levels([0.5]) == [0.95] and choose_holm_levels([]) == []
