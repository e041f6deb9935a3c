"""References across rooms: jobs season by season, and normalised scores only where there is headroom."""

from __future__ import annotations

import dataclasses

import numpy as np

from studies.across.analysis import AcrossRun, analyse, list_jobs
from studies.study import find_study

STUDY = find_study("across")


def make_lines(search: float, counting: float, planner: float) -> list[AcrossRun]:
    rng, lines = np.random.default_rng(0), []
    for job in list_jobs(STUDY.data):
        if job.season < 6 and job.rung == "symbols":
            mean = planner if job.agent == "bayes" else counting if job.rooms else search
            lines.append(dataclasses.replace(job, efficiencies=tuple(np.clip(rng.normal(mean, 0.02, 8), 0, 1))))
    return lines


def test_jobs_go_season_by_season_and_name_each_cell_once():
    jobs = list(list_jobs(STUDY.data))
    assert [job.season for job in jobs] == sorted(job.season for job in jobs)
    assert len({job.place for job in jobs}) == len(jobs) == 20 * 13 * 5


def test_scores_are_normalised_between_search_and_planner():
    found = analyse(STUDY, make_lines(0.6, 0.8, 0.9)).numbers.rungs["cues-1/symbols"]
    assert found.seasons == 6 and abs(found.normalised[16] - 2 / 3) < 0.1 and found.headroom.low > 0.1
    assert analyse(STUDY, make_lines(0.8, 0.85, 0.89)).numbers.rungs["cues-1/symbols"].normalised[16] is None


def test_seasons_that_lack_a_cell_do_not_count():
    lines = make_lines(0.6, 0.8, 0.9)
    short = [line for line in lines if (line.season, line.agent) != (2, "bayes")]
    assert analyse(STUDY, short).numbers.rungs["cues-1/symbols"].seasons == 5
