"""Options and velocities in seconds of motion: data of other truths, and real runs."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from hrl_escape.errors import ComparisonError
from studies.study import find_study
from studies.velocities.analysis import (
    CHANCE,
    OPTIONS,
    ORDER,
    PLAN,
    VELOCITIES,
    EpisodeEnds,
    VelocityRun,
    analyse,
    make_key,
    make_room,
    play_reference,
    run_once,
    summarise,
)

STUDY = find_study("velocities")
DATA = STUDY.data
ROOMS = list(DATA["rooms"])


def spread(mean: float, seed: int, by: float = 0.05) -> list[float]:
    """Ten numbers around a mean."""
    return (mean * (1 + by * np.random.default_rng(seed).normal(size=10))).tolist()


def make_lines(options: float, velocities: float, first: tuple[float, float | None] = (50.0, 900.0)
               ) -> list[VelocityRun]:
    """Ten runs in each room that end with these seconds of an episode, and references around 20 s."""
    lines = [VelocityRun(name, room, 0, 0, None, (time,), make_key(DATA, name, room)) for room in ROOMS
             for name, time in ((ORDER, 18.0), (PLAN, 17.0), *((name, 20.0) for name in DATA["searchers"]))]
    for room in ROOMS:
        for agent, end, escape in ((OPTIONS, options, first[0]), (VELOCITIES, velocities, first[1]),
                                   (CHANCE[0], 60.0, 70.0), (CHANCE[1], 200.0, None)):
            key = make_key(DATA, agent, room)
            lines += [VelocityRun(agent, room, run, DATA["steps"], escape, (None, *(2 * time,) * 7, time, time), key)
                      for run, time in enumerate(spread(end, len(agent)))]
    return lines


@pytest.mark.parametrize(("options", "velocities", "sign"), [(20.0, 150.0, -1), (20.0, 12.0, 1), (20.0, 20.1, 0)])
def test_the_end_is_compared_run_by_run(options: float, velocities: float, sign: int):
    numbers = analyse(STUDY, make_lines(options, velocities)).numbers
    assert {gap.sign for gap in numbers.ends.values()} == {sign} and list(numbers.ends) == ROOMS
    assert numbers.ends[ROOMS[0]].mean == pytest.approx(
        numbers.means[ROOMS[0], OPTIONS] - numbers.means[ROOMS[0], VELOCITIES])
    assert numbers.searched == dict.fromkeys(ROOMS, 20.0) and numbers.runs == 10


def test_one_lucky_run_and_few_runs_are_no_difference():
    lucky = [dataclasses.replace(line, times=(5.0,) * 10 if (line.agent, line.run) == (OPTIONS, 9) else (20.0,) * 10)
             if line.agent in (OPTIONS, VELOCITIES) else line for line in make_lines(20.0, 20.0)]
    assert {gap.sign for gap in analyse(STUDY, lucky).numbers.ends.values()} == {0}
    few = [line for line in make_lines(20.0, 90.0) if line.run < 4]
    assert {gap.sign for gap in analyse(STUDY, few).numbers.ends.values()} == {0}


def test_the_table_has_a_row_an_agent_and_counts_runs_that_never_escape():
    found = analyse(STUDY, make_lines(19.0, 190.0, (50.0, None)))
    assert "| SAC over velocities | 19" in found.tables["velocities"] and "none; 10 never" in found.tables["velocities"]
    assert found.numbers.never[ROOMS[0], VELOCITIES] == 10 and found.numbers.never[ROOMS[0], OPTIONS] == 0
    with pytest.raises(ComparisonError, match=f"no run of {PLAN} in {ROOMS[1]}"):
        analyse(STUDY, [line for line in make_lines(19.0, 190.0) if (line.agent, line.room) != (PLAN, ROOMS[1])])


def test_runs_of_another_budget_or_with_other_settings_are_another_subject():
    lines, changed = make_lines(19.0, 190.0), DATA | {"settings": {"warmup": 500}, "time_limit": 300.0}
    others = [VelocityRun(agent, room, run, steps, 5.0, (1.0,) * 10, make_key(data, agent, room))
              for room in ROOMS for run in range(10) for agent in (OPTIONS, VELOCITIES)
              for steps, data in ((DATA["steps"] * 2, DATA), (DATA["steps"], changed))]
    assert len({line.place for line in lines + others}) == len(lines) + len(others)
    assert analyse(STUDY, lines).tables == analyse(STUDY, lines + others).tables


def test_failures_count_with_the_time_limit_in_the_part_they_end_in():
    data = DATA | {"time_step": 0.5, "time_limit": 100.0}
    run = summarise("someone", ROOMS[0], 3, [(20, 20, True), (100, 80, True), (101, 1, False), (1000, 899, True)], 1000,
                    data)
    assert run.times == (25.0, 100.0, *(None,) * 7, 449.5) and run.first_escape == 10.0 and run.end == 449.5
    assert summarise("someone", ROOMS[0], 3, [(200, 200, False)], 1000, data).first_escape is None


@pytest.mark.nightly
def test_all_four_run_and_the_log_counts_every_step():
    for agent in (OPTIONS, VELOCITIES, *CHANCE):
        run = run_once(DATA | {"steps": 500}, agent, ROOMS[0], 1)
        assert run == run_once(DATA | {"steps": 500}, agent, ROOMS[0], 1), "a seed decides a run"
        assert all(time is None or 0 < time <= DATA["time_limit"] for time in run.times) and run.steps == 500
        assert any(time is not None for time in run.times)
    log = EpisodeEnds(make_room(DATA, ROOMS[0]))
    log.reset(seed=0)
    for _ in range(int(DATA["time_limit"] / DATA["time_step"])):
        log.step(np.zeros(3))
    assert log.ends == [(400, 400, False)] and log.steps == 400


@pytest.mark.nightly
def test_no_searcher_beats_the_best_order_and_the_planner_escapes():
    data = DATA | {"rooms": {"two": {"preset": "paper-two-button", "side": 12.0}}}
    order, plan, *searchers = (play_reference(data, name, "two").end for name in (ORDER, PLAN, *DATA["searchers"]))
    assert order <= min(searchers) and order < max(searchers) < DATA["time_limit"]
    assert plan < DATA["time_limit"] and math.isclose(order, 20.5, abs_tol=0.6)
