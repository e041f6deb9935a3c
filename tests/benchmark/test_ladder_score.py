"""Ladder score: rungs weigh the same, rooms are drawn as a whole, and intervals hold."""

from __future__ import annotations

import numpy as np
import pytest

from hrl_escape.benchmark.inference import compute_interval
from hrl_escape.benchmark.standings import compute_ladder_score, list_standings, normalise, score_standings
from hrl_escape.benchmark.statistics import compute_iqm
from hrl_escape.benchmark.summary import summarise
from tests.benchmark.made_up import compare, make_result


def score(*rungs: list[list[float]], resamples: int = 2000):
    return compute_ladder_score([[np.array(unit) for unit in rung] for rung in rungs], np.random.default_rng(1),
                                resamples)


def test_rungs_weigh_the_same_whatever_their_runs():
    assert score([[1.0]] * 100, [[0.0]] * 4).value == 0.5
    assert score([[0.0], [0.5], [0.7], [1.0]], [[0.2]]).value == pytest.approx((0.6 + 0.2) / 2), "the middle half"


def test_of_one_rung_of_single_runs_it_is_the_interval_of_any_interquartile_mean():
    values = np.array([0.1, 0.4, 0.5, 0.8, 0.9, 1.0, 0.0, 0.7])
    low, high = compute_interval(compute_iqm, [values], (0.0, 1.0), np.random.default_rng(2), 20_000)
    found = score([[value] for value in values], resamples=20_000)
    assert found.low == pytest.approx(low, abs=0.01) and found.high == pytest.approx(high, abs=0.01)


def test_seeds_in_one_room_are_no_evidence_about_another_room():
    one_room, ten_rooms = score([[0.8] * 100]), score([[0.8]] * 100)
    assert one_room.value == ten_rooms.value == pytest.approx(0.8)
    assert one_room.low < 0.1 and ten_rooms.low > 0.75


@pytest.mark.nightly
def test_the_interval_holds_over_rooms_that_vary():
    rng, caught = np.random.default_rng(3), 0
    for _ in range(100):  # rooms with a level of their own, three seeds each; the true score is the laws' own 0.5
        rungs = [[np.clip(rng.uniform(0.2, 0.8) + rng.normal(0, 0.02, 3), 0, 1) for _ in range(10)] for _ in range(2)]
        found = compute_ladder_score(rungs, rng, 300)
        caught += found.low <= 0.5 <= found.high
    assert caught >= 91, "95 % of 100, less two standard errors"


def test_agents_are_scored_over_the_rungs_that_all_were_run_on():
    good, poor = [90.0] * 2, [-1000.0] * 2
    both = list_standings("low", summarise(compare({"dqn": [good] * 2, "ppo": [poor] * 2})))
    alone = list_standings("high", summarise(compare({"dqn": [poor]})))
    rungs, scores = score_standings([*both, *alone])
    assert rungs == ["low"]
    assert scores["dqn"].value > 0 and scores["ppo"].value == 0
    assert [len(unit) for unit in both[0].units] == [2], "a room is one unit, whatever its seeds"
    rungs, scores = score_standings(alone)
    assert rungs == ["high"] and set(scores) == {"dqn"}
    assert score_standings([both[1], *alone]) == ([], {}), "nothing to compare"


def test_the_normalised_score_is_0_for_the_best_search_baseline_and_1_for_the_bayes_planner():
    search, bayes = np.array([0.6, 0.7, 0.8]), np.array([0.86, 0.95, 1.04])
    assert normalise(0.9, search, bayes) == pytest.approx(0.8)
    assert normalise(0.6, search, bayes) == pytest.approx(-0.4)
    assert normalise(0.9, search, search + 0.08) is None, "nothing to learn there"
    assert normalise(0.9, search, search + [0.5, 0.1, 0.2]) is None, "not in unseen rooms"
    lengths = {"search-random": (80, 90), "search-nearest": (60, 70), "search-memory": (50, 55), "bayes": (44, 47),
               "smdp-dqn": (50, 60), "smdp-ppo": (70, 60)}
    made = {name: [make_result([101.0 - length], best=61.0)] for name, (length, _) in lengths.items()}
    found = {own.agent.spec.name: own for own in list_standings("low", summarise(compare(made)))}
    assert {own.normalised for own in found.values()} == {None}, "one room says nothing about others"
