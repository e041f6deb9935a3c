"""What each learner is good at: comparisons of known data, and a real rung."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hrl_escape.errors import ComparisonError, UnknownNameError
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.sets.manifest import AxisRecord
from studies.baseline import BaselineRun
from studies.pages.profiles import RULES
from studies.running import run_study
from studies.study import find_study
from tests.studies.lines import load

STUDY = find_study("profiles")
AXES = load_benchmark("ladder-2").manifest.axes
TABLE, MODEL, NETWORK, POLICY = LEARNERS = tuple(STUDY.data["agents"])
OTHERS = {axis: tuple(other["agents"]) for other in STUDY.data["others"] for axis in other["axes"]}
MOVERS, BOTH = OTHERS["motion"], OTHERS["branching"]
MOTION = next(axis for axis in AXES if axis.name == "motion")
SEARCH_BASELINES = STUDY.data["search"]


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


def read(changes: dict[tuple[str, str], tuple[float, ...]], searcher: float = 0.5,
         axes: Sequence[AxisRecord] = AXES[:3]) -> Any:
    """Numbers of the analysis."""
    return STUDY.analysis.analyse(STUDY, make_lines(changes, searcher, axes)).numbers


HIGH = (0.95, 0.9, 0.85, 0.8)


def test_a_leader_is_significantly_above_every_other_learner():
    found = read({(MODEL, "depth"): HIGH, (TABLE, "branching"): HIGH})
    assert found.leaders == {"depth": MODEL, "branching": TABLE, "violations": None}
    assert found.gains["depth", MODEL, TABLE].is_shown and not found.gains["depth", TABLE, MODEL].is_shown
    shared = read({(agent, "depth"): HIGH for agent in (MODEL, TABLE)})
    assert shared.leaders["depth"] is None
    assert not RULES["leaders"](SimpleNamespace(profiles=shared))


def test_learners_are_compared_with_the_best_search_baseline_by_axis():
    found = read({(MODEL, "depth"): (0.9,) * 4}, searcher=0.7)
    assert found.beyond == ["depth"]


def test_an_axis_that_gets_easier_is_no_fall():
    found = read({(agent, "depth"): (0.6, 0.3, 0.6, 0.2) for agent in (TABLE, MODEL)})
    assert set(found.falls["depth"]) == {NETWORK, POLICY} and set(found.falls["violations"]) == set(LEARNERS)
    level = {(agent, axis.name): (0.6,) * 4 for agent in (*LEARNERS, *BOTH) for axis in AXES[:3]}
    assert not any(read(level).falls.values())


def test_learners_of_moves_are_below_where_each_is_below_each_over_options():
    good = {(agent, "motion"): (0.9,) * 4 for agent in LEARNERS}
    assert read(good, axes=(MOTION,)).below == ["motion"]
    assert read(good | {(MOVERS[2], "motion"): (0.9,) * 4}, axes=(MOTION,)).below == []


def test_axes_with_too_few_rooms_are_left_out():
    lines = [line for line in make_lines({}) if line.rung != "branching-4" or not line.rooms.endswith("#9")]
    found = STUDY.analysis.analyse(STUDY, lines)
    assert "branching" not in found.numbers.axes
    assert "| Q-learning over options |" in found.tables["profiles"]
    for lacking in ([line for line in lines if line.agent != TABLE],
                    [line for line in make_lines({}, axes=(MOTION,)) if line.agent != MOVERS[0]]):
        with pytest.raises(ComparisonError, match="every agent in 10 rooms"):
            STUDY.analysis.analyse(STUDY, lacking)


@pytest.mark.nightly
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
