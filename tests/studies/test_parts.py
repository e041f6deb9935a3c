"""Which part of a hierarchy pays: data of other truths turn the abstract round, and the design stays as registered."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ComparisonError
from studies.__main__ import main
from studies.parts.analysis import (
    Args,
    analyse,
    compute_design,
    list_jobs,
    list_missing,
    make_config,
    measure,
    run_job,
)
from studies.parts.answers import (
    Answer,
    PartsRun,
    answer,
    compute_power,
    find_exchange,
    fit_law,
    is_given_up,
    tell_abstract,
    tell_again,
    tell_bar,
    tell_finding,
    tell_law,
)
from studies.parts.learner import LinearQ, Structure, WalkTables, Watched
from studies.parts.runs import Cell, LearnerSettings, play_cell
from studies.running import open_store
from studies.statistics import compute_sign_flip_p
from studies.store import read_rows
from studies.study import find_study
from tests.studies.pages import save

STUDY = find_study("parts")
DATA, DESIGN = STUDY.data, compute_design(STUDY)
SETTINGS = LearnerSettings(**DATA["learner"])


def make_runs(factors: dict[str, Callable[[int], float]], slice_: str = "first", spread: float = 0.3
              ) -> list[PartsRun]:
    """Runs in which each part divides the primitives by some function of the buttons, whatever else a cell has.

    Walks of any kind are commitments; planned ones have geometry, and searchers memory.
    """
    rng, runs = np.random.default_rng(5), []
    cells = {cell["name"]: cell for cell in DATA["cells"]}
    for job in list_jobs(DATA, slice_, DESIGN):
        cell, time = cells[job.cell], 150 * job.buttons**1.5 / (1 - job.failure)
        has = {"commitment": cell.get("walks", "none") != "none" or "reference" in cell,
               "geometry": cell.get("walks") == "planned" or "reference" in cell,
               "memory": cell.get("memory", False) or "reference" in cell, "structure": cell.get("structure", False)}
        for part, factor in factors.items():
            time /= factor(job.buttons) if has[part] else 1.0
        time *= math.exp(spread * rng.normal())
        runs.append(dataclasses.replace(job, first_escape=round(time) if time < DATA["budget"] else None))
    return runs


def write(runs: list[PartsRun], again: Sequence[Answer] = ()) -> tuple[str, list[str]]:
    answers = answer(runs, DATA)
    laws = {(cell["name"], rule): fit_law([run for run in runs if (run.cell, run.rule, run.failure) == (
        cell["name"], rule, 0)]) for cell in DATA["cells"] for rule in DATA["rules"]}
    exchanges = [find_exchange(runs, DATA, rule) for rule in DATA["rules"]]
    return tell_finding(answers), tell_abstract(answers, laws, exchanges, runs, DATA, again)


def nothing(_: int) -> float:
    return 1.0


# --- other truths ----------------------------------------------------------------------------


@pytest.mark.nightly
def test_a_truth_in_which_no_part_pays():
    finding, abstract = write(make_runs({}))
    assert finding == ("No part of a hierarchy is shown to pay: neither commitment, nor geometry, nor memory, nor "
                       "structure.")
    assert len(abstract) == 8 and abstract[1] == finding
    assert all("is not shown to matter" in sentence and "saves" not in sentence for sentence in abstract[2:6])
    assert "no part is shown to lower the exponent" in abstract[6] and "only the constant" not in abstract[6]
    assert "is not shown to need more or fewer primitives than" in abstract[7]


@pytest.mark.nightly
def test_a_truth_in_which_only_commitment_pays():
    finding, abstract = write(make_runs({"commitment": lambda n: 6.0}))
    assert finding.startswith("What pays is commitment (up to ")
    assert finding.endswith("; geometry, memory and structure are not shown to.")
    assert "saves a factor of" in abstract[2] and "is not shown to matter" in abstract[3]
    assert "no part is shown to lower the exponent" in abstract[6]
    assert "only the constant is shown to fall with commitment" in abstract[6]


@pytest.mark.nightly
def test_a_truth_in_which_only_structure_pays_and_lowers_the_exponent():
    finding, abstract = write(make_runs({"structure": lambda n: n**0.8}))
    assert finding.startswith("What pays is structure (up to ")
    assert finding.endswith("; commitment, geometry and memory are not shown to.")
    assert "saves" not in "".join(abstract[2:5]) and "saves" in abstract[5]
    assert "the exponent is lowered by structure" in abstract[6]
    assert "times fewer primitives than untried-nearest" in abstract[7] and "is not shown" not in abstract[7]
    runs = make_runs({"structure": lambda n: n**0.8})
    kept = [one for one in answer(runs, DATA) if one.lowers_exponent and one.part == "structure"]
    fresh = write(runs, answer(runs, DATA))[1][6], write(runs, answer(make_runs({}), DATA))[1][6]
    assert f", {len(kept)} of these again in fresh rooms" in fresh[0] and ", none of these again in fresh" in fresh[1]


@pytest.mark.nightly
def test_a_truth_in_which_all_parts_add():
    finding, abstract = write(make_runs({"commitment": lambda n: 3.0, "geometry": lambda n: 5.0,
                                         "memory": lambda n: 2.0, "structure": lambda n: 2.0}))
    assert re.match(r"What pays is geometry \(up to [45]\.?\d* times fewer primitives\), commitment", finding)
    assert "not shown" not in finding
    assert all("saves" in sentence and "not shown" not in sentence for sentence in abstract[2:6])
    assert "beside structure saves" in abstract[4]


def test_the_headline_holds_all_parts_against_a_searcher():
    of = {"costs": 0.5, "pays": 2.0, "open": 1.0}
    words = {"costs": "needs on average 2 times the primitives under `reset`",
             "pays": "needs on average 2 times fewer primitives under `reset`",
             "open": "is not shown to need more or fewer under `reset`"}
    both = [PartsRun(cell, "reset", buttons, seed, 0.0, 100, None, DESIGN) for seed in range(4) for buttons in (10, 20)
            for cell in ("options + both", "retrace")]
    behind = [dataclasses.replace(run, first_escape=None) if run.cell == "retrace" and run.buttons == 20
              and run.seed != 0 else run for run in both]
    for verdict, factor in of.items():
        one = Answer("learning", "options + both", "retrace", "reset", 96, factor, p=1.0 if verdict == "open" else 0.01)
        assert tell_bar([one], both).endswith(f"the learner with all of these {words[verdict]}.")
        assert one.verdict == verdict and tell_bar([one], behind).endswith(
            f"{words[verdict]}, where half of its runs escape with up to 20 buttons and half of the searcher's with up "
            "to 10.")
    other = one._replace(rule="ignore", factor=0.25, p=0.01)
    assert "needs on average 4 times the primitives under `ignore`, and is not shown" in tell_bar([other, one], [])


def test_fresh_rooms_are_said_to_give_exponents_again_only_where_they_do():
    """Answers on commitment and geometry; a slope with its interval above 0 lowers the exponent."""
    first, second = (Answer(part, part, "flat", "ignore", 96, 2.0, p=0.01) for part in ("commitment", "geometry"))
    lower = (1.0, 0.5, 1.5)
    there = [first._replace(slope=lower), second]
    assert tell_again([first, second], [first, second._replace(p=1.0)]) == "1 of 2 answers are the same."
    assert tell_again(there, there) == (
        "2 of 2 answers are the same. Of 1 exponent that a part lowered in the first rooms, 1 is lowered again.")
    assert tell_again(there, [first, second._replace(slope=lower)]) == (
        "2 of 2 answers are the same. Of 1 exponent that a part lowered in the first rooms, none is lowered again; "
        "here geometry (`ignore`) lowers it, which did not there.")
    assert "In the first rooms no part lowered an exponent; here" in tell_again([first, second], there)


@pytest.mark.nightly
def test_a_part_that_costs_is_said_to():
    finding, abstract = write(make_runs({"memory": lambda n: 0.25}))
    assert "memory" in finding and "pays is" not in finding
    assert "in a flat learner costs a factor of" in abstract[4] and "over options costs" in abstract[4]


# --- rules -----------------------------------------------------------------------------------


def test_runs_that_gave_up_stay_in_the_denominator():
    runs = make_runs({"commitment": lambda n: 6.0})
    hard = [dataclasses.replace(run, first_escape=None) if run.cell == "flat" else run for run in runs]
    (one, *_), (other, *_) = answer(runs, DATA), answer(hard, DATA)
    assert one.verdict == other.verdict == "pays" and other.factor > one.factor
    assert other.slope is None, "half of the runs of both cells must escape"
    left_out = [run for run in hard if run.cell != "flat" or (
        run.buttons == 2 and run.seed < DATA["slices"]["first"]["first_seed"] + DATA["hopeless"])]
    assert answer(left_out, DATA)[0] == other, "what was given up counts as having given up"


def test_all_answers_are_one_family():
    """A difference that one test alone would show is open among sixteen, and its interval holds 1."""
    rng = np.random.default_rng(11)
    runs = [dataclasses.replace(run, first_escape=round(2_000 * math.exp(0.5 * rng.normal() - (
        0.13 if run.cell == "options + memory" else 0)))) for run in make_runs({})]
    one = next(one for one in answer(runs, DATA) if one.more == "options + memory")
    gains = [math.log(other.first_escape / run.first_escape) for run in runs for other in runs
             if (run.cell, other.cell) == ("options + memory", "options")
             and run.place[1:] == other.place[1:] and run.rule == "ignore" and run.first_escape and other.first_escape]
    alone = 2 * compute_sign_flip_p(gains, "above")
    assert alone < 0.05 < one.p and one.verdict == "open" and one.low < 1 < one.high


@pytest.mark.slow
def test_verdicts_and_intervals_agree():
    for spread in (0.3, 2.0):
        for one in answer(make_runs({"memory": lambda n: 1.2, "geometry": lambda n: 1.5}, spread=spread), DATA):
            assert (one.verdict == "open") == (one.low <= 1 <= one.high), one


def test_rooms_from_which_neither_escaped_say_nothing():
    runs = make_runs({"commitment": lambda n: 6.0})
    none = [dataclasses.replace(run, first_escape=None)
            if run.cell.startswith("flat") and run.buttons > 2 else run for run in runs]
    assert answer(none, DATA)[0].rooms == DATA["slices"]["first"]["runs"]
    all_none = [dataclasses.replace(run, first_escape=None) if run.cell.startswith("flat") else run for run in runs]
    assert math.isnan(answer(all_none, DATA)[0].factor)
    assert "is not told" in write(all_none)[1][2]


def test_a_cell_is_given_up_after_its_first_runs_with_some_number_of_buttons_all_fail():
    runs = [PartsRun("flat", "ignore", 4, seed, 0.0, None, None, DESIGN) for seed in range(5)]
    assert is_given_up(runs, 4, 5) and is_given_up(runs, 20, 5) and not is_given_up(runs, 3, 5)
    assert not is_given_up(runs[:4], 4, 5)
    assert not is_given_up([*runs[:4], dataclasses.replace(runs[4], first_escape=9)], 8, 5)


@pytest.mark.nightly
def test_the_page_says_how_many_runs_are_still_to_be_made():
    runs = make_runs({"geometry": lambda n: 4.0})
    assert not list_missing(DATA, "first", runs)
    given_up = [run for run in runs if run.cell != "flat" or run.buttons < 8]
    kept = [dataclasses.replace(run, first_escape=None) if (run.cell, run.buttons) == ("flat", 6) else run
            for run in given_up]
    assert not list_missing(DATA, "first", kept), "what was given up is not missing"
    assert {(run.cell, run.buttons) for run in list_missing(DATA, "first", given_up)} == {
        ("flat", size) for size in DATA["sizes"] if size >= 8}
    page = analyse(STUDY, [*given_up, *make_runs({}, "confirmation")[1:]]).values
    assert page["missing"]["confirmation"] == 1, "a confirmation is told whole or not at all"
    assert page["missing"]["first"] == 4 * 2 * DATA["slices"]["first"]["runs"] and not page["confirmed"]


def test_laws_are_told_apart():
    def make(law: Callable[[int], float]) -> list[PartsRun]:
        rng = np.random.default_rng(3)
        return [PartsRun("flat", "ignore", size, seed, 0.0, round(law(size) * math.exp(0.2 * rng.normal())), None, "")
                for size in DATA["sizes"] for seed in range(12)]

    power, steep = fit_law(make(lambda n: 20 * n**1.6)), fit_law(make(lambda n: 60 * 1.35**n))
    assert power is not None and steep is not None
    assert power.low < 1.6 < power.high and power.constant_low < 20 < power.constant_high
    assert (tell_law(power), tell_law(steep), tell_law(None)) == ("power law", "exponential", "too few sizes")


@pytest.mark.nightly
@pytest.mark.nightly_for("10.0-0.9")
@pytest.mark.parametrize(("gain", "expected"), [(0.5, 0.0), (10.0, 0.9), (1000.0, 1.0)])
def test_the_exchange_rate_is_where_the_gain_is_gone(gain: float, expected: float):
    runs = make_runs({"structure": lambda n: gain}, spread=0.05)
    found = find_exchange(runs, DATA, "ignore")
    assert found.failure == pytest.approx(expected, abs=0.02) and found.low <= found.failure <= found.high
    said = {0.0: "make up for no failing walks under", 0.9: "make up for walks that fail 90% of the time (",
            1.0: "make up for walks that fail more than 98% of the time under"}[expected]
    assert said.replace("90%", f"{found.failure:.0%}") in write(runs)[1][7]


@pytest.mark.nightly
def test_what_each_question_would_see_was_simulated_before_the_runs():
    tests = len(DATA["questions"]) * len(DATA["rules"])
    assert 1 < compute_power(0.5, 100, tests) < compute_power(1.0, 100, tests) < compute_power(1.0, 25, tests)
    for question in DATA["questions"]:
        seen = compute_power(question["spread"], question["rooms"], tests)
        assert question["power"] == pytest.approx(seen, abs=0.005)


# --- the design ------------------------------------------------------------------------------


def test_every_published_line_is_of_the_registered_design():
    lines = [json.loads(row) for row in read_rows(STUDY.folder / "raw.jsonl")]
    assert lines and {line["design"] for line in lines} == {DESIGN}
    pilots = range(DATA["pilots"]["first_seed"], DATA["pilots"]["first_seed"] + DATA["pilots"]["runs"])
    assert not {line["seed"] for line in lines} & set(pilots)
    assert DESIGN in (STUDY.folder.parents[1] / "docs/results/parts.md").read_text()


def test_lines_of_another_design_are_refused(tmp_path: Path):
    runs = [dataclasses.replace(run, design="0123456789abcdef") for run in make_runs({})[:3]]
    with pytest.raises(ComparisonError, match="a new design begins with results of its own"):
        analyse(STUDY, runs)
    store = open_store(STUDY, tmp_path)
    store.add(runs)
    with pytest.raises(ComparisonError, match="3 lines are of the design 0123456789abcdef"):
        measure(STUDY, Args(), store)


def test_a_changed_design_has_another_hash(tmp_path: Path):
    for name in ("study.toml", "questions.md"):
        (tmp_path / name).write_bytes((STUDY.folder / name).read_bytes())
    assert compute_design(dataclasses.replace(STUDY, folder=tmp_path)) == DESIGN
    (tmp_path / "questions.md").write_text((tmp_path / "questions.md").read_text().replace("pays", "costs", 1))
    assert compute_design(dataclasses.replace(STUDY, folder=tmp_path)) != DESIGN


@pytest.mark.slow
def test_the_page_tells_of_fresh_rooms_beside_the_first(tmp_path: Path):
    save("parts", [*make_runs({"structure": lambda n: 4.0}), *make_runs({}, "confirmation")], tmp_path)
    assert main(["parts", "--from-raw", "--docs", str(tmp_path)]) == 0
    page = (tmp_path / "parts.md").read_text()
    assert page.index("What pays is structure") < page.index("## In fresh rooms") < page.index("No part of a hierarchy")
    assert {path.suffix for path in (tmp_path / "figures").iterdir()} == {".svg", ".pdf", ".tex"}
    assert r"\toprule" in (tmp_path / "figures" / "parts.tex").read_text()


# --- real runs -------------------------------------------------------------------------------


def make_small(rule: str = "ignore", buttons: int = 3, seed: int = 501):
    return generate(make_config(DATA["room"], buttons, rule), seed)


@pytest.mark.slow
def test_runs_go_on_and_come_out_again_to_the_same_bits(tmp_path: Path):
    data = {**DATA, "sizes": [2, 3], "rules": ["ignore"], "budget": 200, "slices": {
        "first": {"first_seed": 500, "runs": 2}, "confirmation": {"first_seed": 502, "runs": 1}},
        "near": {"sizes": [2], "budget": 200}, "dial": {**DATA["dial"], "buttons": 3, "failures": [0.5]}, "hopeless": 2}
    study, cells = dataclasses.replace(STUDY, data=data), ("flat", "options", "options + both", "untried-nearest")
    store = open_store(study, tmp_path)
    measure(study, Args(cells=cells, minutes=1e-9), store)
    assert not store.path.exists(), "no time, no run"
    measure(study, Args(cells=cells), store)
    first = store.path.read_text()
    measure(study, Args(cells=cells), store)
    assert store.path.read_text() == first, "nothing is run twice"
    store.path.write_text("".join(first.splitlines(keepends=True)[:7]))
    measure(study, Args(cells=cells), store)
    assert store.path.read_text() == first
    runs = store.load()
    assert {run.cell for run in runs} == set(cells) and {run.failure for run in runs} == {0.0, 0.5}
    assert all(run.first_escape for run in runs if run.cell == "options + both" and run.buttons == 2)
    measure(study, Args(cells=cells, confirmation=True), store)
    assert {run.seed for run in store.load()} == {500, 501, 502}


@pytest.mark.nightly
def test_published_runs_come_out_again():
    lines = open_store(STUDY, None).load()
    chosen = [line for line in lines if line.cell in ("options + both", "flat + commitment") and line.buttons == 2][:4]
    assert len(chosen) == 4
    assert [run_job(line, DATA) for line in chosen] == chosen


@pytest.mark.parametrize("walks", ["none", "commitment", "learned", "planned"])
def test_every_cell_escapes_from_a_small_room(walks):
    found = play_cell(Cell(walks, memory=walks != "learned", structure=walks in ("learned", "planned")), SETTINGS,
                      make_small(buttons=2), 1, 20_000)
    assert found.first_escape is not None and found.near_best is None


@pytest.mark.nightly
def test_a_learner_comes_near_the_best():
    found = play_cell(Cell("planned", structure=True), SETTINGS, make_small(buttons=2), 1, 5_000, 10_000, 5_000)
    assert found.near_best is not None and found.first_escape == found.near_best, "every escape is near so lax a best"
    assert play_cell(Cell("planned"), SETTINGS, make_small(buttons=2), 1, 5_000, 1, 2_000).near_best is None


def test_walks_that_fail_cost_primitives_and_teach_no_structure():
    ends = [play_cell(Cell("planned", True, True, failure), SETTINGS, make_small(), 1, 20_000).first_escape
            for failure in (0.0, 0.95)]
    assert ends[0] is not None and ends[1] is not None and ends[1] > ends[0]


def test_what_failed_is_kept_by_lights_and_forgotten_with_the_episode():
    from hrl_escape.env.escape_room import EscapeRoomEnv
    from hrl_escape.options.options_env import OptionsEnv

    room = make_small("ignore", 4, 503)
    watched = Watched(EscapeRoomEnv(instance=room))
    env = OptionsEnv(watched, include_primitives=False)
    env.reset(seed=0)
    roots = [i for i in range(4) if not any(child == i for _, child in room.puzzle.edge_list)]
    blocked = next(i for i in range(4) if i not in roots)
    env.step(blocked)
    assert watched.failed == {0: 1 << blocked} and not watched.structure.needs
    env.step(roots[0])
    assert watched.lights == 1 << roots[0] and watched.structure.needs == {roots[0]: 0}
    assert watched.failed.get(watched.lights, 0) == 0, "under other lights nothing has failed"
    env.reset(seed=0)
    assert watched.failed == {} and watched.structure.needs == {roots[0]: 0}, "structure outlives the episode"


def test_structure_is_what_was_lit_every_time():
    structure = Structure()
    structure.note(2, 0b0011)
    assert structure.list_enabled(0b0001, goal=2) == (False, []), "button 0 was never seen to light"
    structure.note(0, 0b0000)
    structure.note(1, 0b0001)
    assert structure.list_enabled(0b0000, goal=2) == (True, [0])
    assert structure.list_enabled(0b0011, goal=2) == (True, [2])
    structure.note(2, 0b0010)
    assert structure.list_enabled(0b0010, goal=2) == (True, [0, 2]), "button 0 may not be needed by 2, but is by 1"
    assert Structure().list_enabled(0, goal=1) == (False, [])


def test_values_follow_the_backup_and_costs_the_steps():
    q = LinearQ(2, 2, gamma=0.9, rate=1.0)
    q.update((0,), np.array([1.0, 1.0]), 1, -3.0)
    assert q.compute_values((0,), np.array([1.0, 1.0])).tolist() == [0.0, -3.0]
    assert q.compute_values((0,), np.array([1.0, 0.0])).tolist() == [0.0, -1.5]
    q.update((0,), np.array([1.0, 1.0]), 0, -1e9)
    assert q.compute_values((0,), np.array([1.0, 1.0]))[0] == pytest.approx(-10.0), "never below a life of primitives"
    walks = WalkTables(2, 1, rate=1.0)
    for _ in range(3):
        for place in range(3):
            walks.learn((place,), 0, (place + 1,), [1] if place == 2 else [])
    assert [walks.get((place,))[0, 1] for place in range(3)] == [3.0, 2.0, 1.0]
