"""Agents compared in pairs: calibrated where all are alike, and able to see a difference where there is one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hrl_escape.benchmark.inference import ALPHA, Finals, compare_agents, is_better
from hrl_escape.benchmark.statistics import LEAST_RUNS
from tests.covering import cover

Draw = Callable[[np.random.Generator, int], np.ndarray]
SHAPES: dict[str, Draw] = {
    "all or nothing": lambda rng, runs: (rng.random(runs) < 0.5).astype(float),
    "bimodal": lambda rng, runs: np.where(rng.random(runs) < 0.7, 0.9, 0.05) + rng.normal(0, 0.03, runs),
    "skewed": lambda rng, runs: rng.beta(0.5, 3, runs),
    "narrow": lambda rng, runs: rng.normal(0.9, 0.02, runs),
}


def make_finals(values: np.ndarray) -> Finals:
    """Finals of an agent from (rooms, seeds)."""
    return {(f"room {room}", seed): float(value) for (room, seed), value in np.ndenumerate(values)}


@pytest.mark.nightly
@pytest.mark.nightly_for("bimodal-sizes4", "narrow-sizes9", "skewed-sizes8")
@pytest.mark.parametrize(("shape", "sizes"), cover(list(SHAPES), [(5, 1, LEAST_RUNS), (5, 2, 5), (6, 2, 8)]))
def test_identical_agents_are_told_apart_in_one_comparison_of_twenty_at_most(shape: str, sizes: tuple[int, int, int]):
    """300 comparisons: at a rate of 5 %, 23 or more come by chance in 2 % of tests. No interval is drawn, as verdicts
    look at none."""
    (agents, rooms, runs), rng, wrong = sizes, np.random.default_rng(3), 0
    for _ in range(300):
        finals = [make_finals(SHAPES[shape](rng, rooms * runs).reshape(rooms, runs)) for _ in range(agents)]
        pairs = compare_agents(finals, [True] * agents, rng, resamples=1)
        wrong += any(is_better(pair) for row in pairs for pair in row)
    assert wrong <= 22


def test_a_clear_difference_is_seen_among_seven_agents():
    rng = np.random.default_rng(0)
    finals = [make_finals(rng.normal(0.9 if number else 0.4, 0.1, (1, 10))) for number in range(7)]
    pairs = compare_agents(finals, [True] * 7, rng)
    assert all(is_better(pairs[number][0]) and not is_better(pairs[0][number]) for number in range(1, 7))


def test_nine_pairs_decide_nothing_however_clean():
    finals = [make_finals(np.full((1, LEAST_RUNS - 1), value)) for value in (0.0, 1.0)]
    pair = compare_agents(finals, [True, True], np.random.default_rng(0))[1][0]
    assert pair.p == 4.0**-8 < ALPHA and not is_better(pair)


def test_only_runs_that_both_have_are_compared():
    first, second = make_finals(np.ones((1, 6))), make_finals(np.zeros((2, 3)))
    pair = compare_agents([first, second], [True, True], np.random.default_rng(0))[0][1]
    assert pair.count == 3 and pair.improvement.value == 1
