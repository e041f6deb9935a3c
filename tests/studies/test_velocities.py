"""Options and velocities in seconds of motion: sentences from data of other truths, and real runs."""

from __future__ import annotations

import math
from pathlib import Path

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
    advise,
    make_key,
    make_room,
    play_reference,
    run_once,
    summarise,
    tell_ends,
    tell_first_escapes,
    tell_headline,
    tell_searchers,
)
from tests.studies.pages import tell as write_page

DATA = find_study("velocities").data
BUDGET = DATA["steps"] * DATA["time_step"]
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


@pytest.mark.parametrize(("options", "velocities", "told"), [
    (20.0, 150.0, "SAC over options escapes sooner than SAC over velocities (20."),
    (20.0, 12.0, "SAC over velocities escapes sooner than SAC over options (20."),
    (20.0, 20.1, "no difference between SAC over options and over velocities is shown")])
def test_the_end_is_told_by_what_was_measured(options: float, velocities: float, told: str):
    sentences = tell_ends({room: (spread(options, 1), spread(velocities, 2)) for room in ROOMS})
    assert len(sentences) == len(ROOMS) and all(told in sentence for sentence in sentences)
    assert sentences[0].startswith("**One button.**")


def test_headline_and_advice_follow_the_rooms():
    low, high, same = spread(20.0, 1), spread(150.0, 2), spread(20.1, 3)
    assert tell_headline({"a": (low, high), "b": (high, low)}) == (
        "SAC over options escapes sooner with a, SAC over velocities escapes sooner with b.")
    assert tell_headline({"a": (low, high), "b": (low, high)}) == "SAC over options escapes sooner with a and b."
    assert tell_headline({"a": (low, same)}).startswith("No room tells")
    told = [advise({"a": first, "b": second}) for first, second in (
        ((low, high), (high, low)), ((low, high), (low, same)), ((high, low), (low, same)), ((low, same), (low, same)))]
    assert len(set(told)) == 4 and told[1].startswith("Give a robot options")


def test_one_lucky_run_and_few_runs_are_no_difference():
    lucky = [20.0] * 9 + [5.0]
    assert "no difference" in tell_ends({"room": (lucky, [20.0] * 10)})[0]
    assert "no difference" in tell_ends({"room": (spread(20.0, 1)[:4], spread(90.0, 2)[:4])})[0]


@pytest.mark.parametrize(("velocities", "told"), [
    (800.0, "Over velocities it costs 15.8 times"), (10.0, "Velocities find it sooner: they take 0.2 times"),
    (50.5, "That options find it sooner is not shown")])
def test_first_escapes_are_told_by_ratios(velocities: float, told: str):
    assert told in tell_first_escapes({"room": (spread(50.0, 1), spread(velocities, 2))})[0]


def test_runs_that_never_escape_are_counted_beside_the_ratio():
    first = {"room": (spread(50.0, 1), [900.0] * 9 + [80.0])}
    counted = "0 of 10 over options and 9 over velocities, count with the whole budget"
    assert counted in tell_first_escapes(first, 900.0)[0]
    assert "never" not in tell_first_escapes(first, 901.0)[0]


def test_a_ratio_is_a_bound_where_one_side_alone_never_escapes():
    def say(options: list[float], velocities: list[float]) -> str:
        return tell_first_escapes({"room": (options, velocities)}, 900.0)[0]

    some, never = spread(50.0, 1), [900.0] * 10
    assert "it costs more than 17.8 times" in say(some, never) and "as equal" not in say(some, never)
    assert "they take less than 0.1 times" in say(never, some)
    assert "it costs 1" in say(some, spread(800.0, 2, 0.01)), "all escape"
    both = say([900.0, 900.0, *some[2:]], never)
    assert "more than 1" in both and both.endswith("whole budget, so that 2 pairs of 10 count as equal.")
    assert "times" in (mixed := say([900.0, *some[1:]], [80.0, *never[1:]])) and "more than" not in mixed


@pytest.mark.parametrize(("options", "velocities", "told"), [
    (15.0, 150.0, ("SAC over options needs less", "SAC over velocities needs more")),
    (30.0, 20.05, ("SAC over options needs more", "SAC over velocities is not told apart from it"))])
def test_learners_are_held_against_the_best_searcher(options: float, velocities: float, told: tuple[str, str]):
    sentence = tell_searchers({"room": (spread(options, 1), spread(velocities, 2))}, {"room": 20.0})[0]
    assert "needs 20.0 s" in sentence and all(part in sentence for part in told)


def test_the_page_has_a_row_an_agent_and_says_who_never_escaped(tmp_path: Path):
    page = write_page("velocities", make_lines(19.0, 190.0, (50.0, None)), tmp_path)
    assert (tmp_path / "figures/velocities.svg").stat().st_size > 5_000
    assert "| SAC over velocities | 19" in page and "none; 10 never" in page
    assert page.count("SAC over options escapes sooner") >= len(ROOMS)
    with pytest.raises(ComparisonError, match=f"no run of {PLAN} in {ROOMS[1]}"):
        write_page("velocities", [line for line in make_lines(19.0, 190.0) if (line.agent, line.room)
                                  != (PLAN, ROOMS[1])])


def test_runs_of_another_budget_or_with_other_settings_are_another_subject():
    lines, changed = make_lines(19.0, 190.0), DATA | {"settings": {"warmup": 500}, "time_limit": 300.0}
    others = [VelocityRun(agent, room, run, steps, 5.0, (1.0,) * 10, make_key(data, agent, room))
              for room in ROOMS for run in range(10) for agent in (OPTIONS, VELOCITIES)
              for steps, data in ((DATA["steps"] * 2, DATA), (DATA["steps"], changed))]
    assert len({line.place for line in lines + others}) == len(lines) + len(others)
    assert write_page("velocities", lines) == write_page("velocities", lines + others)


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
