"""What each learner is good at: sentences from data of other truths, and a real rung."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from hrl_escape.errors import ComparisonError, UnknownNameError
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.sets.manifest import AxisRecord
from studies.baseline import BaselineRun
from studies.profiles.analysis import tell_falls
from studies.running import run_study
from studies.study import find_study
from tests.studies.pages import load
from tests.studies.pages import tell as write_page

STUDY = find_study("profiles")
AXES = load_benchmark("ladder-2").manifest.axes
TABLE, MODEL, NETWORK, POLICY = LEARNERS = tuple(STUDY.data["agents"])
OTHERS = {axis: tuple(other["agents"]) for other in STUDY.data["others"] for axis in other["axes"]}
MOVERS, BOTH = OTHERS["motion"], OTHERS["branching"]
MOTION = next(axis for axis in AXES if axis.name == "motion")
SEARCH_BASELINES = STUDY.data["searchers"]


def make_lines(changes: dict[tuple[str, str], tuple[float, ...]], searcher: float = 0.5, axes: Sequence[AxisRecord] =
               AXES[:3]) -> list[BaselineRun]:
    """Ten rooms a rung around these efficiencies by learner and axis, rung by rung; 0.6 falling to 0.3 elsewhere."""
    rng, lines = np.random.default_rng(0), []
    for axis in axes:
        for agent in (*LEARNERS, *SEARCH_BASELINES, *OTHERS.get(axis.name, ())):
            usual = (searcher,) * 4 if agent in SEARCH_BASELINES else (0.6, 0.5, 0.4, 0.3)
            for rung, mean in zip(axis.rungs, changes.get((agent, axis.name), usual[:len(axis.rungs)]), strict=True):
                lines += [BaselineRun("per-instance", rung, f"{rung}/test#{room}", agent, 0, 10_000,
                                      float(np.clip(mean + 0.03 * rng.normal(), 0, 1)), None, 1.0, 5, 1.0, 100, "key")
                          for room in range(10)]
    return lines


def read(changes: dict[tuple[str, str], tuple[float, ...]], folder: Path, searcher: float = 0.5) -> str:
    return write_page("profiles", make_lines(changes, searcher), folder)


@pytest.mark.nightly
def test_profiles_that_cross_are_told_by_the_axes_on_which_they_do(tmp_path: Path):
    high = (0.95, 0.9, 0.85, 0.8)
    page = read({(MODEL, "depth"): high, (TABLE, "branching"): high}, tmp_path)
    assert ("**Profiles cross: a table beats a learned model on branching, and is beaten on depth; a table leads on "
            "branching; a learned model leads on depth.**") in page
    assert all((tmp_path / f"figures/{name}.svg").stat().st_size > 5_000 for name in ("profiles", "profiles-axes"))


@pytest.mark.nightly
def test_one_learner_that_is_best_everywhere_is_one_order(tmp_path: Path):
    page = read({(MODEL, axis.name): (0.9,) * 4 for axis in AXES[:3]}, tmp_path)
    assert ("One order holds on all axes: nobody is shown to beat a learned model on any, and it leads on depth, "
            "branching and violations.") in page


@pytest.mark.nightly
def test_learners_that_are_alike_are_not_told_apart(tmp_path: Path):
    assert "No two of these learners are told apart on any axis." in read({}, tmp_path)


def test_a_lead_that_is_shared_is_no_lead(tmp_path: Path):
    high = (0.9,) * 4
    page = read({(MODEL, "depth"): high, (NETWORK, "depth"): high, (TABLE, "branching"): high}, tmp_path)
    assert "leads on depth" not in page and "a table leads on branching" in page


@pytest.mark.nightly
def test_searching_is_beaten_where_some_learner_is_shown_to(tmp_path: Path):
    page = read({(MODEL, "depth"): (0.9,) * 4}, tmp_path)
    assert ("- On depth some learner beats the best search baseline, which starts anew in each episode; on branching "
            "and violations all learners are below it.") in page
    everyone = read({}, tmp_path, searcher=0.9)
    assert ("On no axis is a learner shown to beat the best search baseline, which starts anew in each episode; on "
            "depth, branching and violations all learners are below it.") in everyone


def test_an_axis_that_gets_easier_is_no_fall(tmp_path: Path):
    rising = {(agent, "depth"): (0.6, 0.3, 0.6, 0.2) for agent in (TABLE, MODEL)}
    page = read(rising, tmp_path)
    assert ("As rungs grow harder three learners or more fall on branching and violations; one or two learners fall on "
            "depth.") in page
    depth, branching = (next(line for line in page.splitlines() if line.startswith(f"| {axis} |"))
                        for axis in ("depth", "branching"))
    assert (depth.count("↓"), branching.count("↓")) == (2, 4)


@pytest.mark.nightly
def test_three_falls_are_several_whoever_falls(tmp_path: Path):
    level = {(agent, axis.name): (0.6,) * 4 for agent in LEARNERS for axis in (MOTION, AXES[0])}
    page = write_page("profiles", make_lines(level, axes=(MOTION, AXES[0])), tmp_path)
    assert "As rungs grow harder three learners or more fall on motion; none does on depth." in page


@pytest.mark.parametrize(("least", "told"), [
    (4, "four learners or more fall on depth; one, two or three learners fall on branching; none does on violations"),
    (2, "two learners or more fall on depth and branching; one learner falls on violations"),
    (1, "one learner or more falls on depth, branching and violations"),
])
def test_the_sentence_on_falls_names_the_number_that_decides(monkeypatch, least, told):
    monkeypatch.setattr("studies.profiles.analysis.LEAST_FALLING", least)
    falls = [(agent, axis.name) for axis, agents in zip(AXES, ("abcd", "abc", "a" * (least < 4)), strict=False)
             for agent in agents]
    assert tell_falls(falls, AXES[:3]) == f"As rungs grow harder {told}."


def test_others_are_below_planned_options_where_each_of_them_is(tmp_path: Path):
    axes = (MOTION, AXES[1])
    good = {(agent, axis.name): (0.9,) * 4 for agent in LEARNERS for axis in axes}
    page = write_page("profiles", make_lines(good, axes=axes), tmp_path)
    assert "- On motion every learner of single moves is below every one of planned options alone." in page
    assert ("- On branching every learner of planned options and single moves is below every one of planned options "
            "alone.") in page
    assert page.count("| motion |") == page.count("| branching |") == 2  # a table for each kind
    one = write_page("profiles", make_lines(good | {(MOVERS[2], "motion"): (0.9,) * 4}, axes=axes), tmp_path)
    assert "- On motion some learner of single moves keeps up with some of planned options alone." in one


def test_nobody_falls_where_rungs_are_alike(tmp_path: Path):
    level = {(agent, axis.name): (0.6, 0.6, 0.6, 0.6) for agent in (*LEARNERS, *BOTH) for axis in AXES[:3]}
    assert "No learner is shown to fall as rungs grow harder, on any axis." in read(level, tmp_path)
    steep = {place: means for place, means in level.items() if place[1] != "depth"}
    assert "none does on branching and violations." in read(steep, tmp_path)


@pytest.mark.nightly
def test_searching_is_no_answer_where_it_stays_low_on_the_upper_half(tmp_path: Path):
    told = "On the upper half of depth, branching and violations the best search baseline stays below 0.5."
    assert told in read({}, tmp_path, searcher=0.45)
    said = read({}, tmp_path, searcher=0.55)
    assert "On no axis does the best search baseline stay below 0.5 on the upper half" in said
    half = {(SEARCH_BASELINES[0], "depth"): (0.9, 0.4, 0.6, 0.1),
            (SEARCH_BASELINES[0], "branching"): (0.9, 0.6, 0.4, 0.3),
            (SEARCH_BASELINES[0], "violations"): (0.1, 0.1, 0.1, 0.6)}
    assert ("On the upper half of branching the best search baseline stays below 0.5; on that of depth and violations "
            "it does not.") in read(half, tmp_path, searcher=0.2)
    arm = next(axis for axis in AXES if axis.name == "arm")
    for middle, told in ((0.4, "On the upper half of arm"), (0.6, "On no axis does the best search baseline stay")):
        lines = make_lines({(SEARCH_BASELINES[0], "arm"): (0.9, middle, 0.3)}, searcher=0.2, axes=(arm,))
        assert told in write_page("profiles", lines, tmp_path)


@pytest.mark.nightly
def test_a_top_rung_that_is_solved_is_used_up(tmp_path: Path):
    assert "No axis is used up: on every top rung all learners stay below an efficiency of 0.9." in read({}, tmp_path)
    page = read({(MODEL, "depth"): (1.0,) * 4}, tmp_path)
    assert "The top rung of depth is all but solved" in page


@pytest.mark.nightly
def test_axes_with_too_few_rooms_are_left_out_and_named(tmp_path: Path):
    lines = [line for line in make_lines({}) if line.rung != "branching-4" or not line.rooms.endswith("#9")]
    page = write_page("profiles", lines, tmp_path)
    assert "Not enough was run for branching" in page and "| branching |" not in page
    with pytest.raises(ComparisonError, match="every agent in 10 rooms"):
        write_page("profiles", [line for line in lines if line.agent != TABLE], tmp_path)
    with pytest.raises(ComparisonError, match="every agent in 10 rooms"):
        write_page("profiles", [line for line in make_lines({}, axes=(MOTION,)) if line.agent != MOVERS[0]], tmp_path)


def test_a_real_rung_gives_lines_of_both_kinds(tmp_path: Path):
    args = STUDY.analysis.Args(docs=tmp_path, out=tmp_path / "runs", rung=("memory-1", "motion-1"), rooms=1, workers=1,
                               agents=(SEARCH_BASELINES[0], TABLE, MOVERS[0]), primitives=300)
    with pytest.raises(ComparisonError, match="every agent in 10 rooms"):  # the lines are kept
        run_study(STUDY, args)
    found = {(line.rung, line.agent): line for line in load("profiles", tmp_path)}
    assert {place: line.primitives for place, line in found.items()} == {
        ("memory-1", SEARCH_BASELINES[0]): 0, ("memory-1", TABLE): 300, ("motion-1", SEARCH_BASELINES[0]): 0,
        ("motion-1", TABLE): 300, ("motion-1", MOVERS[0]): 300}  # moves on their axes only
    assert found["memory-1", SEARCH_BASELINES[0]].escapes == 1.0
    with pytest.raises(UnknownNameError, match="agent of this study"):
        run_study(STUDY, dataclasses.replace(args, agents=("sarsa",)))
