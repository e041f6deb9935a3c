"""Connected rooms: jobs, intervals over rooms and seeds, and real runs of a learner and of references."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from hrl_escape.errors import ComparisonError
from studies.connected_rooms.analysis import ConnectedRun, analyse, list_jobs, run_job
from studies.study import find_study

STUDY = find_study("connected-rooms")
SMALL = {**STUDY.data, "rungs": ["pair"], "tested": 2, "primitives": 200, "copies": 2, "compile": False}
MEANS = {"search-random": 0.5, "search-nearest": 0.6, "search-backtrack": 0.6, "bayes": 0.8}


def make_lines(learned: float, runs: int = 10, rungs: tuple[str, ...] = ("doors",)) -> list[ConnectedRun]:
    rng = np.random.default_rng(0)
    ease = 0.1 * rng.standard_normal(64)
    return [dataclasses.replace(job, seconds=60.0, efficiencies=tuple(
        MEANS.get(job.agent, learned) + ease + 0.02 * rng.standard_normal(64)))
            for job in list_jobs(STUDY.data) if job.rung in rungs and job.seed < runs]


def test_jobs_name_each_run_once_and_references_come_first():
    jobs = list(list_jobs(STUDY.data))
    assert len({job.place for job in jobs}) == len(jobs) == 2 * (4 + 2 * 10)
    assert [bool(job.rooms) for job in jobs] == [False] * 8 + [True] * 40


def test_a_learner_is_compared_over_rooms_and_seeds_and_only_with_all_runs():
    found = analyse(STUDY, make_lines(0.7))
    doors = found.numbers.rungs["doors"]
    assert doors.headroom.low > 0.15 and found.numbers.minutes == 24
    assert doors.gains[64].low > 0 and doors.gains[64].value == pytest.approx(0.1, abs=0.02)
    assert doors.learned[256].high - doors.learned[256].low > 0.04, "rooms are resampled, too"
    few = analyse(STUDY, make_lines(0.7, runs=9))
    assert not few.numbers.rungs["doors"].gains
    assert "| `doors` | PPO over options, with memory | 64 | 1 |" in few.tables["connected_missing"]


def test_a_rung_without_all_references_is_left_out():
    lines = make_lines(0.7, rungs=("doors", "house"))
    short = [line for line in lines if (line.rung, line.agent) != ("house", "bayes")]
    assert set(analyse(STUDY, short).numbers.rungs) == {"doors"}
    with pytest.raises(ComparisonError, match="lacks a reference"):
        analyse(STUDY, [line for line in short if line.agent != "bayes"])


def test_real_runs_are_scored_in_every_test_room(tmp_path: Path):
    for agent, rooms in (("search-nearest", 0), (STUDY.data["learner"], 2)):
        found = run_job(ConnectedRun("pair", agent, rooms, 0, 0, (), 0.0), SMALL, tmp_path)
        assert len(found.efficiencies) == 2 and all(0 <= value <= 1 for value in found.efficiencies)
        assert (found.primitives >= 200) == bool(rooms) and found.seconds > 0
