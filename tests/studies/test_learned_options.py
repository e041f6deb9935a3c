"""Learned options at scale: the design stays as registered, runs resume, few rooms give no verdict, power is real."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from studies.__main__ import main
from studies.learned_options.analysis import analyse, compute_design
from studies.learned_options.answers import find_half, simulate_gain, simulate_ratio
from studies.learned_options.runs import TRIAL, ScaleRun, choose_settings, list_jobs, make_run
from studies.publishing import UnsupportedClaimError, load_page, render_page
from studies.running import open_store
from studies.study import Study, find_study

STUDY = find_study("learned_options")
REGISTERED = "8a546d164f57e8ef"
"""Hash of `study.toml` and `questions.md`, fixed before the first counted run."""
FLAT = {"ppo": 0.3, "ppo, repeats": 0.2, "ppo, novelty": 0.2, "dqn": 0.25, "dqn, novelty": 0.2}
"""Late efficiency of made-up flat learners."""


def shrink(folder: Path) -> Study:
    """A study of its own with a few copies of a room and a few thousand primitives."""
    folder.mkdir()
    text = (STUDY.folder / "study.toml").read_text()
    for old, new in (("family =", "copies = 4\nfamily ="), ("copies = 16\n", ""), ("budget = 200_000", "budget = 300"),
                     ("[300_000, 10_000_000]", "[1_000, 2_000]"), ("rooms = 64", "rooms = 2"),
                     ("room = {", 'analysis = "studies.learned_options.analysis"\nroom = {')):
        assert old in text
        text = text.replace(old, new)
    (folder / "study.toml").write_text(text)
    (folder / "questions.md").write_text("none\n")
    return find_study(str(folder))


def make_lines(late: dict[str, float], rooms: int = 10) -> list[ScaleRun]:
    """Made-up runs of the first stage with two buttons, in which a learner has its efficiency and some noise.

    Trials come before them.
    """
    rng, trials, lines = np.random.default_rng(3), [], []
    for job in list_jobs(STUDY.data, REGISTERED):
        if job.part == TRIAL:
            trials.append(dataclasses.replace(job, fewest=10))
        if (job.agent in late and job.part == "one room" and (job.buttons, job.budget) == (2, 300_000)
                and job.seed < STUDY.data["slices"]["first"] + rooms):
            worth = max(late[job.agent] + 0.05 * rng.normal(), 0.0)
            lines.append(dataclasses.replace(
                job, choice=0, first_escape=10_000, fewest=20, episodes=(10,) * 20, escapes=(10,) * 20,
                efficiency=(10 * worth,) * 20, primitives=job.budget, seconds=1.0))
    return trials + lines


def number(late: dict[str, float], rooms: int = 10) -> SimpleNamespace:
    return analyse(STUDY, make_lines(late, rooms)).numbers


def test_the_design_is_the_registered_one_and_the_page_shows_it():
    assert compute_design(STUDY) == REGISTERED
    assert f"`{REGISTERED}`" in (Path(__file__).parents[2] / "docs/results/learned-options-at-scale.md").read_text()


def test_committed_runs_follow_the_registered_settings():
    lines = open_store(STUDY, None).load()
    choices = choose_settings(line for line in lines if line.part == TRIAL)
    counted = [line for line in lines if line.part != TRIAL]
    assert counted and {line.design for line in counted} == {REGISTERED}
    assert all(line.choice == choices.get(line.agent, 0) for line in counted)
    assert {line.place for line in lines} <= {job.place for job in list_jobs(STUDY.data, REGISTERED)}
    assert all(sum(line.escapes) <= sum(line.episodes) and line.fewest > 0 for line in counted)


def test_a_learner_of_options_pays_only_with_ten_rooms_and_a_gain():
    found = number(FLAT | {"dac": 0.8, "a2oc": 0.0, "ppoc": 0.3}).first
    assert {label: gain.verdict for (_, label), gain in found.gains.items()} == {
        "dac": "pays", "a2oc": "costs", "ppoc": "open"}
    assert {gain.flat for gain in found.gains.values()} == {"ppo"} and found.crossover == 2
    assert not number(FLAT | {"dac": 0.8}, rooms=9).first.gains
    some = {label: worth for label, worth in FLAT.items() if label != "dqn"}
    assert not number(some | {"dac": 0.8}).first.gains, "the best flat learner is not known without all of them"


def test_claims_break_when_runs_disagree_or_those_that_they_call_missing_are_made():
    page, lines = load_page("learned-options-at-scale"), open_store(STUDY, None).load()
    good = {"episodes": (10,) * 20, "escapes": (10,) * 20, "efficiency": (9.0,) * 20, "first_escape": 1_000}
    never = {"episodes": (10,) * 20, "escapes": (0,) * 20, "efficiency": (0.0,) * 20, "first_escape": None}

    def change(new: dict[str, Any], agent: str, *buttons: int, part: str = "one room", first: int = 5_000
               ) -> list[ScaleRun]:
        """All lines, with other outcomes of an agent in some rooms."""
        return [dataclasses.replace(line, **new) if (line.agent, line.part) == (agent, part)
                and line.buttons in buttons and first <= line.seed < first + 10 else line for line in lines]

    text, figures = render_page(page, {"learned-options": analyse(STUDY, lines)})
    assert " of 1,310 registered runs" in text and figures == ["learned-options", "learned-options-escapes"]
    last = next(line for line in lines if line.agent == "ppo" and line.part == "one room")
    wrong = {
        "no-gain": change(good, "dac", 1), "wait": change(good, "a2oc", 4), "credit": change(good, "ppoc", 1),
        "no-crossover": change(good, "dac", 1, 2, 3), "exploration": change(good, "a2oc", 1),
        "untrained": change(never, "untrained, repeats", 2),
        "planned": change(never, "ppo, planned options", 4),
        "reuse": change(good, "ppo, reused options", 2, part="unseen rooms"),
        "confirmation": change(good, "ppoc", 2, first=6_000), "confirmed": change(good, "dac", 3, first=6_000),
        "reset": [dataclasses.replace(line, **good) if line.rule == "reset" else line for line in lines],
        "no-second-stage": [*lines, dataclasses.replace(last, budget=10_000_000)],
        "ppo-two-buttons": change(never, "ppo", 2)}
    assert set(wrong) | {"easy-trial"} == set(page.rules)
    for rule, changed in wrong.items():
        with pytest.raises(UnsupportedClaimError, match=rule):
            render_page(page, {"learned-options": analyse(STUDY, changed)})


def test_a_room_is_learned_with_the_first_of_two_good_parts():
    *_, run = make_lines({"dac": 0.0}, 1)
    worth = (0.0, 9.0, 0.0, *(6.0,) * 17)
    assert find_half(run) is None
    assert find_half(dataclasses.replace(run, efficiency=worth)) == 4 * 15_000


def test_simulated_power_is_what_was_registered():
    assert simulate_gain(0.0, 0.1, 10, 9, 40) <= 0.05
    assert simulate_gain(0.2, 0.1, 10, 9, 40) > 0.85 > 0.6 > simulate_gain(0.1, 0.1, 10, 9, 40)


@pytest.mark.nightly
def test_a_ratio_of_eight_is_found_in_nearly_all_studies():
    assert simulate_ratio(8.0, 1.0, 1.0, 10, 20) > 0.9 > 0.3 > simulate_ratio(1.0, 1.0, 1.0, 10, 20)


@pytest.mark.nightly
def test_every_kind_of_learner_makes_a_run_twice_alike(tmp_path: Path):
    data = shrink(tmp_path / "small").data
    for label in ("ppo, repeats", "dqn", "a2oc", "ppo, planned options", "ppo, reused options", "untrained, repeats",
                  "archive"):
        job = ScaleRun("one room", label, 1, "ignore", 3, 1_000, 0, "")
        once, again = (make_run(data, job, {"dac, egocentric": 0}, "cpu") for _ in range(2))
        assert dataclasses.replace(once, seconds=0.0) == dataclasses.replace(again, seconds=0.0), label
        assert once.fewest > 0 and (once.primitives >= 1_000 or label == "archive"), label
        assert label == "archive" or (once.first_escape is None) == (sum(once.escapes) == 0)


@pytest.mark.nightly
def test_episodes_reach_their_limit_whatever_the_part_of_the_budget(tmp_path: Path):
    data = shrink(tmp_path / "small").data
    run = make_run(data, ScaleRun("one room", "ppo", 4, "ignore", 3, 8_400, 0, ""), {}, "cpu")
    assert sum(run.episodes) - sum(run.escapes) >= 4, "four copies of 2,100 primitives, at most 1,000 an episode"


@pytest.mark.nightly
def test_the_command_makes_trials_first_resumes_and_says_what_is_missing(tmp_path: Path,
                                                                         capsys: pytest.CaptureFixture[str]):
    folder = shrink(tmp_path / "small").folder
    command = [str(folder), "--agents", "ppo", "--buttons", "2", "--budget", "1000", "--rooms", "1"]
    assert main([*command, "--minutes", "1e-9"]) != 0, "nothing was made in so little time"
    assert main(command) == 0
    lines = [json.loads(row) for row in (folder / "raw.jsonl").read_text().splitlines()[1:]]
    assert [line["part"] for line in lines] == [TRIAL, TRIAL, "one room", "one room"]
    assert [line["seed"] for line in lines[2:]] == [5_000, 6_000]
    assert "0 of 4 runs are missing" in capsys.readouterr().err
    before = (folder / "raw.jsonl").read_text()
    assert main(command) == 0 and (folder / "raw.jsonl").read_text() == before
    (folder / "questions.md").write_text("others\n")
    assert main([*command, "--from-raw"]) != 0, "lines of another design are refused"
