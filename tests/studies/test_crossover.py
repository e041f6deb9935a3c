"""The crossover by size: ratios of censored pairs, runs that resume, and claims that follow from the data."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from studies.crossover.analysis import LINES, SearchRun, analyse, estimate_ratio, list_jobs
from studies.running import make_missing
from studies.store import Store
from studies.study import find_study

STUDY = find_study("crossover")


def test_jobs_are_the_rooms_of_both_slices_once_each():
    jobs = list(list_jobs(find_study(STUDY.data["parts"]).data))
    assert len(jobs) == len({job.place for job in jobs}) == 8 * 30 * 2
    assert [job.buttons for job in jobs] == sorted(job.buttons for job in jobs)


def test_runs_resume_and_none_begins_once_the_time_is_up(tmp_path: Path):
    store, jobs, made = Store(tmp_path / "raw.jsonl", LINES), list(list_jobs(find_study("parts").data))[:3], []

    def run(job: SearchRun) -> SearchRun:
        made.append(job)
        return dataclasses.replace(job, first_escape=len(made))

    make_missing(jobs, run, store, 1e-9)
    assert not made and not store.path.exists()
    make_missing(jobs[:2], run, store, None)
    make_missing(jobs, run, store, 1.0)
    assert made == jobs and [line.first_escape for line in store.load()] == [1, 2, 3]


@pytest.mark.nightly
def test_a_known_ratio_is_found_and_censored_runs_do_not_pull_it_to_1():
    rng = np.random.default_rng(1)
    search = np.exp(rng.normal(6.0, 0.3, 300))
    learner = search / (0.1 * np.exp(rng.normal(0, 0.5, 300)))
    free = estimate_ratio(list(search), list(learner), 1e9)
    assert free.value == pytest.approx(0.1, rel=0.1) and free.low < 0.1 * 1.05 and free.high > 0.1 * 0.95
    budget = float(np.median(learner))
    cut = [value if value <= budget else None for value in learner.tolist()]
    censored = estimate_ratio(list(search), cut, budget)
    assert censored.value == pytest.approx(0.1, rel=0.15) and censored.learner == 150
    imputed = np.exp(np.mean([np.log(one / (other or budget)) for one, other in zip(search, cut, strict=True)]))
    assert imputed > 0.12, "a mean with the budget in place of censored runs does"


def test_ends_are_open_where_one_side_never_escapes():
    found = estimate_ratio([10.0] * 6, [None] * 6, 1000.0)
    assert found.high <= 0.02 and found.low == 0 and (found.search, found.learner) == (6, 0)
    nothing = estimate_ratio([None] * 6, [None] * 6, 1000.0)
    assert np.isnan(nothing.value) and (nothing.low, nothing.high) == (0, np.inf)


def test_a_size_without_enough_rooms_has_no_ratio():
    lines = [SearchRun("reset", 4, 3000 + number, 100_000, 50) for number in range(6)]
    numbers: SimpleNamespace = analyse(STUDY, lines).numbers
    assert set(numbers.ratios["reset"]["all"]) == {4} and "confirmation" not in numbers.ratios["reset"]
