"""What each learner is good at: sentences from data of other truths, and a real rung."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hrl_escape.errors import ComparisonError
from hrl_escape.ladder.benchmark import load_benchmark
from studies.baseline import BaselineRun
from studies.study import find_study
from tests.studies.pages import load
from tests.studies.pages import tell as write_page

STUDY = find_study("profiles")
AXES = load_benchmark("ladder-2").manifest.axes
TABLE, MODEL, NETWORK = STUDY.data["agents"]
SEARCHERS = STUDY.data["searchers"]


def make_lines(changes: dict[tuple[str, str], tuple[float, ...]], searcher: float = 0.5) -> list[BaselineRun]:
    """Ten rooms a rung around these efficiencies by learner and axis, rung by rung; 0.6 falling to 0.3 elsewhere."""
    rng, lines = np.random.default_rng(0), []
    for axis in AXES[:3]:
        for agent in (TABLE, MODEL, NETWORK, *SEARCHERS):
            usual = (searcher,) * 4 if agent in SEARCHERS else (0.6, 0.5, 0.4, 0.3)
            for rung, mean in zip(axis.rungs, changes.get((agent, axis.name), usual), strict=True):
                lines += [BaselineRun("per-instance", rung, f"{rung}/test[{room}]", agent, 0, 10_000,
                                      float(np.clip(mean + 0.03 * rng.normal(), 0, 1)), None, 1.0, 5, 1.0, 100, "key")
                          for room in range(10)]
    return lines


def read(changes: dict[tuple[str, str], tuple[float, ...]], folder: Path, searcher: float = 0.5) -> str:
    return write_page("profiles", make_lines(changes, searcher), folder)


def test_profiles_that_cross_are_told_by_the_axes_on_which_they_do(tmp_path: Path):
    high = (0.95, 0.9, 0.85, 0.8)
    page = read({(MODEL, "depth"): high, (TABLE, "branching"): high}, tmp_path)
    assert ("**Profiles cross: a table beats a learned model on branching, and is beaten on depth; a table leads on "
            "branching; a learned model leads on depth.**") in page
    assert all((tmp_path / f"figures/{name}.svg").stat().st_size > 5_000 for name in ("profiles", "profiles-axes"))


def test_one_learner_that_is_best_everywhere_is_one_order(tmp_path: Path):
    page = read({(MODEL, axis.name): (0.9,) * 4 for axis in AXES[:3]}, tmp_path)
    assert ("One order holds on all axes: nobody is shown to beat a learned model on any, and it leads on depth, "
            "branching and violations.") in page


def test_learners_that_are_alike_are_not_told_apart(tmp_path: Path):
    assert "No two of these learners are told apart on any axis." in read({}, tmp_path)


def test_a_lead_that_is_shared_is_no_lead(tmp_path: Path):
    high = (0.9,) * 4
    page = read({(MODEL, "depth"): high, (NETWORK, "depth"): high, (TABLE, "branching"): high}, tmp_path)
    assert "leads on depth" not in page and "a table leads on branching" in page


def test_searching_is_beaten_where_some_learner_is_shown_to(tmp_path: Path):
    page = read({(MODEL, "depth"): (0.9,) * 4}, tmp_path)
    assert ("- On depth some learner beats the best searcher, which starts anew in each episode; on branching and "
            "violations all learners are below it.") in page
    everyone = read({}, tmp_path, searcher=0.9)
    assert ("On no axis is a learner shown to beat the best searcher, which starts anew in each episode; on depth, "
            "branching and violations all learners are below it.") in everyone


def test_an_axis_that_gets_easier_is_no_fall(tmp_path: Path):
    rising = {(agent, "depth"): (0.6, 0.3, 0.6, 0.2) for agent in (TABLE, MODEL)}
    page = read(rising, tmp_path)
    assert ("As rungs grow harder a table falls on branching and violations; a learned model falls on branching and "
            "violations; a network falls on depth, branching and violations.") in page


def test_nobody_falls_where_rungs_are_alike(tmp_path: Path):
    level = {(agent, axis.name): (0.6, 0.6, 0.6, 0.6) for agent in (TABLE, MODEL, NETWORK) for axis in AXES[:3]}
    assert "No learner is shown to fall as rungs grow harder, on any axis." in read(level, tmp_path)
    steep = {place: means for place, means in level.items() if place[1] != "depth"}
    assert "none does on branching and violations." in read(steep, tmp_path)


def test_a_top_rung_that_is_solved_is_used_up(tmp_path: Path):
    assert "No axis is used up: on every top rung all learners stay below an efficiency of 0.9." in read({}, tmp_path)
    page = read({(MODEL, "depth"): (1.0,) * 4}, tmp_path)
    assert "The top rung of depth is all but solved" in page


def test_axes_with_too_few_rooms_are_left_out_and_named(tmp_path: Path):
    lines = [line for line in make_lines({}) if line.rung != "branching-4" or "[9]" not in line.rooms]
    page = write_page("profiles", lines, tmp_path)
    assert "Not enough was run for branching" in page and "| branching |" not in page
    with pytest.raises(ComparisonError, match="every agent in 10 rooms"):
        write_page("profiles", [line for line in lines if line.agent != TABLE], tmp_path)


def test_a_real_rung_gives_lines_of_both_kinds(tmp_path: Path):
    args = STUDY.analysis.Args(docs=tmp_path, out=tmp_path / "runs", rung=("memory-1",), rooms=1, workers=1,
                               agents=(SEARCHERS[0], TABLE), primitives=300)
    from studies.running import run_study

    with pytest.raises(ComparisonError, match="every agent in 10 rooms"):  # the lines are kept
        run_study(STUDY, args)
    searcher, learner = sorted(load("profiles", tmp_path), key=lambda line: line.primitives)
    assert (searcher.agent, searcher.primitives, learner.agent, learner.primitives) == (SEARCHERS[0], 0, TABLE, 300)
    assert searcher.escapes == 1.0 and searcher.rooms == learner.rooms
