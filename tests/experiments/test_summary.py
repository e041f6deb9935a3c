"""What runs amount to, on comparisons written down by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hrl_escape.errors import ComparisonError
from hrl_escape.experiments.summary import summarise
from tests.experiments.made_up import BEST, WORST, compare, make_result


def at(score: float) -> float:
    """The return that has this score."""
    return WORST + score * (BEST - WORST)


def test_an_agents_numbers_are_those_of_its_last_evaluations():
    """Two evaluations a run, so the last fifth of training holds one."""
    finals = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]
    (agent,) = summarise(compare({"dqn": [[at(0), at(s)] for s in finals]})).agents
    assert agent.scores[0] == pytest.approx(finals)
    assert agent.score.value == pytest.approx(np.mean([0.3, 0.4, 0.5, 0.6]))  # the middle half
    assert 0.1 < agent.score.low < agent.score.value < agent.score.high < 0.8
    assert agent.success.value == 1 and agent.runs == 8 and agent.stuck == 0
    assert agent.area.value == pytest.approx(agent.score.value / 2)  # a straight line from 0
    assert (agent.decisions, agent.planner_calls, agent.seconds, agent.planner_seconds) == (20, 3, 1, 0.5)


def test_a_run_is_judged_by_the_last_fifth_not_by_its_very_last_evaluation():
    returns = [at(0)] * 8 + [at(0.9), at(0.9), WORST]  # at 0, 100, ..., 1000 primitives
    (agent,) = summarise(compare({"dqn": [returns] * 4})).agents
    assert agent.score.value == pytest.approx(0.6) and agent.success.value == pytest.approx(2 / 3) and agent.stuck == 0


def test_a_run_that_never_escapes_has_score_nothing_and_is_stuck():
    (agent,) = summarise(compare({"dqn": [[WORST, WORST], [WORST, at(0.8)], [at(0.9), WORST], [WORST, WORST]]})).agents
    assert agent.scores[0].tolist() == pytest.approx([0, 0.8, 0, 0])
    assert agent.success.value == 0.25 and agent.stuck == 0.75


def test_rooms_weigh_the_same_and_are_never_mixed():
    summary = summarise(compare({"dqn": [[at(0.2)]] * 4 + [[at(0.6)]] * 4,
                                 "ppo": [[at(0.1)]] * 4 + [[at(0.9)]] * 4}, rooms=2))
    dqn, ppo = summary.agents
    assert [room.tolist() for room in dqn.scores] == [pytest.approx([0.2] * 4), pytest.approx([0.6] * 4)]
    assert (dqn.score.value, dqn.score.low, dqn.score.high) == pytest.approx((0.4, 0.4, 0.4))
    assert summary.get_improvement(ppo, dqn).value == 0.5  # wins every pair in one room, loses every pair in the other
    assert [room.name for room in summary.rooms] == ["paper-two-button", "paper-one-button"]


def test_curves_are_interpolated_between_evaluations_and_carry_all_three_axes():
    (agent,) = summarise(compare({"dqn": [[at(0), at(0.5), at(1)]] * 4})).agents
    curve = agent.curve
    assert curve.primitives[[0, -1]].tolist() == [0, 1000]
    middle, low, high = curve.metrics["score"]
    for line in (middle, low, high):
        assert line == pytest.approx(curve.primitives / 1000)
    assert curve.decisions == pytest.approx(curve.primitives * 20 / 1000)
    assert curve.seconds == pytest.approx(curve.primitives * 2 / 1000)
    assert agent.room_curves[0] is not None and agent.room_curves[0].metrics["score"][0] == pytest.approx(middle)


def test_what_is_missing_splits_into_what_options_cannot_do_and_what_was_not_learned():
    """Reachable 0.9, reached 0.6: 0.1 lies with the options, 0.3 with learning."""
    runs = [make_result([at(0.6)], reachable=at(0.9))] * 4
    (agent,) = summarise(compare({"smdp-dqn!": runs})).agents
    assert agent.gap == pytest.approx((0.1, 0.3))


def test_an_agent_that_beats_the_planner_raises_the_best_known_for_all_that_start_there():
    """The planner knew 50 from here; one agent gets 100, in training's middle. From elsewhere 50 stands."""
    elsewhere = ((1.0, 0.0, 0, 0.0),)
    summary = summarise(compare({
        "dqn": [make_result([WORST, 100.0, 45.0], best=50.0),
                make_result([WORST, WORST, 50.0], best=50.0, start=elsewhere)],
        "ppo": [make_result([WORST, WORST, 50.0], best=50.0),
                make_result([WORST, WORST, 0.0], best=50.0, start=elsewhere)],
    }))
    dqn, ppo = summary.agents
    assert dqn.scores[0] == pytest.approx([1045 / 1100, 1050 / 1050])
    assert ppo.scores[0] == pytest.approx([1050 / 1100, 1000 / 1050])
    assert summary.rooms[0].source == "dqn, planner" and summary.rooms[0].best == 75
    assert sum(ppo.gap) == pytest.approx(1 - ppo.score.value)


def test_a_raised_best_is_reachable_only_for_who_could_do_the_old_best():
    summary = summarise(compare({
        "dqn": [make_result([100.0], best=50.0)] * 4,
        "smdp-dqn!": [make_result([40.0], best=50.0, reachable=40.0)] * 4,
    }))
    assert summary.agents[1].gap == pytest.approx((60 / 1100, 0))


def test_a_lucky_episode_in_a_noisy_room_is_no_reference():
    comparison = compare({"dqn": [make_result([90.0], best=50.0)] * 2})
    (room,) = comparison.instances
    noisy = dataclasses.replace(room, dynamics=dataclasses.replace(room.dynamics, noise=0.1))
    cells = comparison.grid.make_cells([noisy])
    runs = tuple((cell, result) for cell, (_, result) in zip(cells, comparison.runs, strict=True))
    (agent,) = summarise(dataclasses.replace(comparison, instances=(noisy,), runs=runs)).agents
    assert agent.scores[0].max() > 1


def test_failed_runs_count_nowhere_and_are_counted():
    summary = summarise(compare({"dqn": [[at(0.5)], None, [at(0.5)], [at(0.5)]], "ppo": [None] * 4}))
    (dqn,) = summary.agents
    assert (dqn.runs, dqn.failed, dqn.score.value) == (3, 1, pytest.approx(0.5))


def test_a_room_where_an_agent_has_no_run_is_left_out_of_its_numbers():
    summary = summarise(compare({"dqn": [[at(0.5)]] * 4 + [None] * 4, "ppo": [[at(0.4)]] * 4 + [[at(0.9)]] * 4}, 2))
    dqn, ppo = summary.agents
    assert dqn.score.value == pytest.approx(0.5) and dqn.room_curves[1] is None and dqn.fewest_runs == 0
    assert summary.get_improvement(dqn, ppo).value == 1, "only the room that both have"


def test_nothing_finished_is_an_error_that_says_why():
    with pytest.raises(ComparisonError, match="no run has finished.*it fell over"):
        summarise(compare({"dqn": [None] * 4}))


def test_different_versions_of_a_package_are_kept_apart():
    runs = [make_result([at(0.5)]), dataclasses.replace(make_result([at(0.5)]), versions={"torch": "2.0"})]
    assert summarise(compare({"dqn": runs})).versions == {"torch": "1.0, 2.0"}
