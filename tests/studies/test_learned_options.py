"""Learned options at scale: the design stays as registered, runs resume, few rooms give no verdict, power is real."""

from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from studies.__main__ import main
from studies.learned_options.analysis import analyse, compute_design
from studies.learned_options.answers import find_half, simulate_gain
from studies.learned_options.runs import OPEN, TRIAL, ScaleRun, choose_settings, list_jobs, list_learners, make_run
from studies.running import open_store
from studies.study import Study, find_study

STUDY = find_study("learned_options")
REGISTERED = "da9e0f7ee03a9f1f"
"""Hash of `study.toml` and `questions.md`, fixed before the first counted run."""


def shrink() -> dict[str, Any]:
    """The study with a few copies of a room and a few thousand primitives."""
    data = tomllib.loads((STUDY.folder / "study.toml").read_text())
    for learner in data["learners"]:
        learner["copies"] = 4
    small = {"budgets": [2_000, 4_000], "trials": data["trials"] | {"budget": 300},
             "reuse": data["reuse"] | {"rooms": 2}, "rooms": 2}
    return data | small


def make_lines(data: dict[str, Any], late: dict[str, float], rooms: int = 10) -> list[ScaleRun]:
    """Made-up runs of the first stage with two buttons, whose efficiency is that of their learner and some noise."""
    rng, design = np.random.default_rng(3), compute_design(STUDY)
    lines = []
    for job in list_jobs(data, design):
        if job.agent in late and job.part == "one room" and job.buttons == 2 and job.seed < 5_000 + rooms and (
                job.budget == data["budgets"][0]):
            worth = max(late[job.agent] + 0.05 * rng.normal(), 0.0)
            lines.append(dataclasses.replace(job, choice=0, first_escape=10_000, fewest=20, episodes=(10,) * 20,
                                             escapes=(10,) * 20, efficiency=(10 * worth,) * 20, primitives=job.budget,
                                             seconds=1.0))
    return lines


def test_the_design_is_the_registered_one():
    assert compute_design(STUDY) == REGISTERED


def test_every_kind_of_learner_makes_a_run_twice_alike():
    data = shrink()
    for label in ("ppo, repeats", "a2oc", "ppo, planned options", "ppo, reused options", "untrained, repeats", "archive"):
        job = ScaleRun("one room", label, 1, "ignore", 3, 2_000, 0, "")
        once, again = (make_run(data, job, {"dac, egocentric": 0}, "cpu") for _ in range(2))
        assert dataclasses.replace(once, seconds=0.0) == dataclasses.replace(again, seconds=0.0), label
        assert once.fewest > 0 and (once.primitives >= 2_000 or label == "archive"), label
        assert sum(once.escapes) <= sum(once.episodes) and (once.first_escape is None) == (not sum(once.escapes)) or (
            label == "archive")
