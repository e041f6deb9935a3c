"""Intervals for unseen rooms cover the mean over rooms and seeds as often as they say."""

import numpy as np
import pytest
from scipy import stats

from hrl_escape.benchmark.room_intervals import compute_crossed_interval, compute_nested_interval

# spread of rooms and seeds: of the project's runs, of equal size, and of seeds that matter more than rooms
SPREADS = [(0.176, 0.013, 0.05), (0.1, 0.1, 0.05), (0.02, 0.1, 0.1)]


def draw(rng: np.random.Generator, shape: tuple[int, int], spreads: tuple[float, float, float]) -> np.ndarray:
    room, seed, error = spreads
    return (room * rng.standard_normal((shape[0], 1)) + seed * rng.standard_normal(shape[1])
            + error * rng.standard_normal(shape))


@pytest.mark.parametrize("spreads", SPREADS)
@pytest.mark.parametrize("shape", [(64, 10), (16, 5)])
def test_crossed_intervals_cover_the_mean_of_unseen_rooms_and_seeds(shape: tuple[int, int],
                                                                    spreads: tuple[float, float, float]):
    rng, tries = np.random.default_rng(8), 1500
    found = [compute_crossed_interval(draw(rng, shape, spreads)) for _ in range(tries)]
    assert 0.93 <= np.mean([each.low <= 0 <= each.high for each in found]) <= 0.97


def test_efficiencies_between_0_and_1_are_covered_with_64_rooms():
    rng, tries = np.random.default_rng(3), 1500
    covered = 0
    for _ in range(tries):
        rooms = rng.beta(8, 2, (64, 1))  # skewed, as efficiencies are; mean 0.8
        scores = np.clip(rooms + 0.02 * rng.standard_normal((64, 10)), 0, 1.2)
        found = compute_crossed_interval(scores)
        covered += found.low <= 0.8 <= found.high
    assert 0.93 <= covered / tries <= 0.97


def test_an_interval_over_seeds_alone_would_not_cover_unseen_rooms():
    rng, tries = np.random.default_rng(5), 300
    tables = [draw(rng, (10, 10), SPREADS[0]) for _ in range(tries)]
    ends = [compute_nested_interval(list(table.T)) for table in tables]  # seeds as units
    assert np.mean([each.low <= 0 <= each.high for each in ends]) < 0.5


def test_known_cases_have_the_textbook_interval():
    found = compute_nested_interval([np.array([0.2, 0.4]), np.array([0.5]), np.array([0.7, 0.7])])
    reach = stats.t.ppf(0.975, 2) * 0.2 / 3**0.5
    assert found == pytest.approx((0.5, 0.5 - reach, 0.5 + reach))
    table = np.array([[0.2], [0.4], [0.9]])
    assert compute_crossed_interval(table) == compute_nested_interval(list(table))
    same = compute_crossed_interval(np.full((3, 4), 0.5))
    assert same == (0.5, 0.5, 0.5)
    assert np.isinf(compute_crossed_interval(np.array([[0.1, 0.2]])).low)
    # no error: rooms 0 and 1, seeds -0.1 and 0.1; mean squares 1 and 0.04
    crossed = compute_crossed_interval(np.array([[-0.1, 0.1], [0.9, 1.1]]))
    freedom = 1.04**2 / (1.0 + 0.04**2)
    assert crossed.high - crossed.value == pytest.approx(stats.t.ppf(0.975, freedom) * (1.04 / 4) ** 0.5)
