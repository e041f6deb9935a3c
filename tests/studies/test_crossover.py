"""The crossover by size: ratios of censored pairs, runs that resume, and claims that follow from the data."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from studies.crossover.analysis import SearchRun, analyse, estimate_ratio, list_jobs
from studies.study import find_study

STUDY = find_study("crossover")


def test_jobs_are_the_rooms_of_both_slices_once_each():
    jobs = list(list_jobs(find_study(STUDY.data["parts"]).data))
    assert len(jobs) == len({job.place for job in jobs}) == 8 * 30 * 2
    assert [job.buttons for job in jobs] == sorted(job.buttons for job in jobs)


def test_a_known_ratio_is_found_and_censoring_does_not_bias_it():
    rng = np.random.default_rng(1)
    learner = np.exp(rng.normal(7.0, 0.5, 200))
    search = learner * 0.5 * np.exp(rng.normal(0, 0.3, 200))
    free = estimate_ratio(list(search), list(learner), 1e9)
    assert free.value == pytest.approx(0.5, rel=0.1) and free.low < 0.5 < 1.05 * free.high
    budget = 1500.0
    cut = [[value if value <= budget else None for value in values.tolist()] for values in (search, learner)]
    assert sum(value is None for value in cut[1]) > 40
    censored = estimate_ratio(*cut, budget)
    assert censored.value == pytest.approx(0.5, rel=0.2) and censored.low < 0.55 < 1.2 * censored.high
    imputed = np.exp(np.mean([np.log((one or budget) / (other or budget)) for one, other in zip(*cut, strict=True)]))
    assert abs(np.log(censored.value / 0.5)) < abs(np.log(imputed / 0.5)), "imputed runs pull the ratio towards 1"


def test_ends_are_open_where_one_side_never_escapes():
    found = estimate_ratio([10.0] * 6, [None] * 6, 1000.0)
    assert found.high <= 0.02 and found.low == 0 and (found.search, found.learner) == (6, 0)
    nothing = estimate_ratio([None] * 6, [None] * 6, 1000.0)
    assert np.isnan(nothing.value) and (nothing.low, nothing.high) == (0, np.inf)


def test_a_size_without_enough_rooms_has_no_ratio():
    lines = [SearchRun("reset", 4, 3000 + number, 100_000, 50) for number in range(6)]
    numbers: SimpleNamespace = analyse(STUDY, lines).numbers
    assert set(numbers.ratios["reset"]["all"]) == {4} and "confirmation" not in numbers.ratios["reset"]
