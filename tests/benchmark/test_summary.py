"""Summaries of comparisons written down by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hrl_escape.benchmark.inference import compute_wilson_interval
from hrl_escape.benchmark.runs import RunResult
from hrl_escape.benchmark.summary import summarise
from hrl_escape.errors import ComparisonError
from hrl_escape.sets.places import RunPlace
from tests.benchmark.made_up import BEST, WORST, compare, make_result

FEWEST = 100
PLANNED = BEST + 1 - FEWEST
"""Return of an escape in so many primitives."""


def at(efficiency: float) -> float:
    """The return of a run with this efficiency, where the best known escape takes 100 primitives."""
    return BEST + 1 - FEWEST / efficiency if efficiency else WORST


def make(*efficiencies: float) -> RunResult:
    """A run with these efficiencies at its evaluations."""
    return make_result([at(value) for value in efficiencies], best=PLANNED)


def test_an_agents_numbers_are_those_of_its_last_evaluations():
    """Two evaluations a run, so the last fifth of training holds one."""
    finals = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]
    (agent,) = summarise(compare({"dqn": [make(0, s) for s in finals]})).agents
    assert agent.efficiencies[0] == pytest.approx(finals, rel=0.01)  # lengths are whole primitives
    assert agent.efficiency.value == pytest.approx(np.mean([0.3, 0.4, 0.5, 0.6]), rel=0.01)  # the middle half
    assert 0.1 < agent.efficiency.low < agent.efficiency.value < agent.efficiency.high < 0.8
    assert agent.success == pytest.approx((1, *compute_wilson_interval(1, 8)))
    assert agent.runs == agent.escaped_runs == 8 and agent.stuck == 0 and agent.progress.value == 1
    assert agent.area.value == pytest.approx(agent.efficiency.value / 2)  # a straight line from 0
    assert agent.score.value == pytest.approx((np.mean([at(s) for s in finals[2:6]]) - WORST) / (PLANNED - WORST),
                                              rel=0.01)
    assert (agent.decisions, agent.planner_calls, agent.seconds, agent.planner_seconds) == (20, 3, 1, 0.5)


def test_a_run_is_judged_by_the_last_fifth_not_by_its_very_last_evaluation():
    run = make(*[0] * 8, 0.8, 0.8, 0)  # at 0, 100, ..., 1000 primitives
    (agent,) = summarise(compare({"dqn": [run] * 4})).agents
    assert agent.efficiency.value == pytest.approx(1.6 / 3) and agent.success.value == pytest.approx(2 / 3)
    assert agent.stuck == 0


def test_a_run_that_never_escapes_has_no_efficiency_and_is_stuck():
    (agent,) = summarise(compare({"dqn": [make(0, 0), make(0, 0.8), make(0.5, 0), make(0, 0)]})).agents
    assert agent.efficiencies[0].tolist() == pytest.approx([0, 0.8, 0, 0])
    assert agent.success.value == agent.progress.value == 0.25 and agent.stuck == 0.75


def test_first_escapes_count_runs_without_one_at_the_budget():
    """Escapes at 0, 500 and 1,000 of 1,000 primitives, and none."""
    (agent,) = summarise(compare({"dqn": [make(1, 0, 0), make(0, 1, 0), make(0, 0, 1), make(0, 0, 0)]})).agents
    assert agent.first_escape.value == 625 and agent.escaped_runs == 3
    assert agent.first_escape.low < 625 < agent.first_escape.high <= 1000


@pytest.mark.nightly
def test_rooms_weigh_the_same_and_are_never_mixed():
    summary = summarise(compare({"dqn": [make(0.2)] * 4 + [make(0.5)] * 4,
                                 "ppo": [make(0.1)] * 4 + [make(0.8)] * 4}, rooms=2))
    dqn, ppo = summary.agents
    assert [room.tolist() for room in dqn.efficiencies] == [pytest.approx([0.2] * 4), pytest.approx([0.5] * 4)]
    assert dqn.efficiency.value == pytest.approx(0.35)
    pair = summary.get_pair(ppo, dqn)
    assert pair.improvement.value == 0.5  # wins every pair in one room, loses every pair in the other
    assert pair.difference.value == pytest.approx((0.3 - 0.1) / 2) and pair.count == 8
    assert [room.name for room in summary.rooms] == ["paper-two-button", "paper-one-button"]


def test_curves_are_interpolated_between_evaluations_and_carry_all_three_axes():
    (agent,) = summarise(compare({"dqn": [make(0, 0.5, 1)] * 4})).agents
    curve = agent.curve
    assert curve.primitives[[0, -1]].tolist() == [0, 1000]
    middle, low, high = curve.metrics["efficiency"]
    assert middle == pytest.approx(curve.primitives / 1000)
    assert (low <= middle).all() and (middle <= high).all() and low[-1] < 1
    assert curve.decisions == pytest.approx(curve.primitives * 20 / 1000)
    assert curve.seconds == pytest.approx(curve.primitives * 2 / 1000)
    assert agent.room_curves[0] is not None and agent.room_curves[0].metrics["efficiency"][0] == pytest.approx(middle)


def test_what_is_missing_splits_into_what_options_cannot_do_and_what_was_not_learned():
    """Reachable 0.8, reached 0.5: 0.2 lies with the options, 0.3 with learning."""
    runs = [make_result([at(0.5)], best=PLANNED, reachable=at(0.8))] * 4
    (agent,) = summarise(compare({"smdp-dqn": runs})).agents
    assert agent.gap == pytest.approx((0.2, 0.3))


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
    assert dqn.efficiencies[0] == pytest.approx([1 / 56, 1])
    assert ppo.efficiencies[0] == pytest.approx([1 / 51, 51 / 101])
    assert ppo.score.value == pytest.approx((1050 / 1100 + 1000 / 1050) / 2)
    room = summary.rooms[0]
    assert (room.source, room.best, room.fewest) == ("dqn, planner", 75, 26)
    assert sum(ppo.gap) == pytest.approx(1 - ppo.efficiency.value)


def test_a_raised_best_is_reachable_only_for_who_could_do_the_old_best():
    summary = summarise(compare({
        "dqn": [make_result([100.0], best=50.0)] * 4,
        "smdp-dqn": [make_result([40.0], best=50.0, reachable=40.0)] * 4,
    }))
    assert summary.agents[1].gap == pytest.approx((1 - 1 / 61, 0))


def test_a_lucky_episode_in_a_noisy_room_is_no_reference():
    comparison = compare({"dqn": [make_result([90.0], best=50.0)] * 2})
    (room,) = (place.instance for place in comparison.places)
    noisy = dataclasses.replace(room, dynamics=dataclasses.replace(room.dynamics, noise=0.1))
    planned = comparison.grid.make_runs([RunPlace.of_room(noisy)])
    runs = tuple((run, result) for run, (_, result) in zip(planned, comparison.runs, strict=True))
    (agent,) = summarise(dataclasses.replace(comparison, places=(RunPlace.of_room(noisy),), runs=runs)).agents
    assert agent.score.value > 1 and agent.efficiency.value == 1


def test_failed_runs_count_nowhere_and_are_counted():
    summary = summarise(compare({"dqn": [make(0.5), None, make(0.5), make(0.5)], "ppo": [None] * 4}))
    (dqn,) = summary.agents
    assert (dqn.runs, dqn.failed, dqn.efficiency.value) == (3, 1, pytest.approx(0.5))


def test_a_room_where_an_agent_has_no_run_is_left_out_of_its_numbers():
    summary = summarise(compare({"dqn": [make(0.5)] * 4 + [None] * 4, "ppo": [make(0.4)] * 4 + [make(0.8)] * 4}, 2))
    dqn, ppo = summary.agents
    assert dqn.efficiency.value == pytest.approx(0.5) and dqn.room_curves[1] is None and dqn.fewest_runs == 0
    pair = summary.get_pair(dqn, ppo)
    assert pair.improvement.value == 1 and pair.count == 4, "only the room that both have"


def test_agents_are_compared_run_by_run_with_the_same_seed():
    """Seeds differ by far more than agents: 0.1 each time, which only pairs show."""
    dqn, ppo = [0.2, 0.4, 0.8, 0.5, 0.32], [0.16, 0.25, 0.5, 0.4, 0.25]
    summary = summarise(compare({"dqn": [make(s) for s in dqn], "ppo": [make(s) for s in ppo]}))
    pair = summary.get_pair(*summary.agents)
    assert pair.improvement.value == 1 and pair.p < 0.1
    assert summary.get_pair(*summary.agents[::-1]) == pair.turn()


@pytest.mark.nightly
def test_all_pairs_are_one_family_but_for_the_planner():
    agents = {name: [make(s) for s in (0.2, 0.4, 0.8, 0.5, 0.32)[n:] + (0.2, 0.4, 0.8, 0.5, 0.32)[:n]]
              for n, name in enumerate(("dqn", "ppo", "sarsa"))}
    alone = summarise(compare({name: agents[name] for name in ("dqn", "ppo")}))
    three = summarise(compare(agents))
    with_planner = summarise(compare({**agents, "oracle": [make(1)] * 5}))
    assert three.pairs[0][1].p >= alone.pairs[0][1].p
    assert with_planner.pairs[0][1].p == three.pairs[0][1].p
    assert with_planner.pairs[3][0].p == 1


def test_nothing_finished_is_an_error_that_says_why():
    with pytest.raises(ComparisonError, match="no run has finished.*it fell over"):
        summarise(compare({"dqn": [None] * 4}))


def test_different_versions_of_a_package_are_kept_apart():
    runs = [make(0.5), dataclasses.replace(make(0.5), versions={"torch": "2.0"})]
    assert summarise(compare({"dqn": runs})).versions == {"torch": "1.0, 2.0"}


def test_the_best_known_is_raised_by_fewer_primitives_or_a_larger_return_alone():
    """One agent escapes in 41 primitives for less than the best return, one earns more in as many as the planner."""
    base = make_result([50.0], best=50.0)
    (last,) = base.evaluations
    quick = dataclasses.replace(base, evaluations=(dataclasses.replace(last, returns=(20.0,), lengths=(41,)),))
    rich = dataclasses.replace(base, evaluations=(dataclasses.replace(last, returns=(70.0,), lengths=(51,)),))
    room = summarise(compare({"dqn": [quick] * 2, "ppo": [base] * 2})).rooms[0]
    assert (room.best, room.fewest) == (50, 41)
    room = summarise(compare({"dqn": [rich] * 2, "ppo": [base] * 2})).rooms[0]
    assert (room.best, room.fewest) == (70, 51)


def test_a_first_escape_beyond_the_budget_counts_as_the_budget():
    """The last decision of a run may end after its budget."""
    late = dataclasses.replace(make(0, 0, 1), first_escape=1_040)
    (agent,) = summarise(compare({"dqn": [late, make(0, 1, 0)]})).agents
    assert agent.first_escape.value == 750
