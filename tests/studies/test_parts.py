"""Which part of a hierarchy pays: other truths give other answers, sizes stay apart, the design stays as registered."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ComparisonError
from studies.parts.analysis import (
    Args,
    SizeRatio,
    analyse,
    compare_sizes,
    compute_design,
    list_jobs,
    list_missing,
    make_config,
    measure,
    run_job,
)
from studies.parts.answers import (
    PartsRun,
    answer,
    find_exchange,
    fit_law,
    is_given_up,
)
from studies.parts.learner import LinearQ, Structure, WalkTables, Watched
from studies.parts.runs import Cell, LearnerSettings, play_cell
from studies.running import open_store
from studies.statistics import compute_sign_flip_p
from studies.store import read_rows
from studies.study import find_study

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


def find_paying(runs: list[PartsRun]) -> set[str]:
    """Parts of which some answer says that they pay, and `-PART` of those of which one says that they cost."""
    return {one.part if one.verdict == "pays" else f"-{one.part}" for one in answer(runs, DATA)
            if one.verdict != "open" and one.part in ("commitment", "geometry", "memory", "structure")}


# --- other truths ----------------------------------------------------------------------------


@pytest.mark.nightly
@pytest.mark.parametrize(("factors", "expected"), [
    ({}, set()),
    ({"commitment": lambda n: 6.0}, {"commitment"}),
    ({"structure": lambda n: n**0.8}, {"structure"}),
    ({"commitment": lambda n: 3.0, "geometry": lambda n: 5.0, "memory": lambda n: 2.0, "structure": lambda n: 2.0},
     {"commitment", "geometry", "memory", "structure"}),
    ({"memory": lambda n: 0.25}, {"-memory"}),
])
def test_each_truth_is_found(factors: dict[str, Callable[[int], float]], expected: set[str]):
    assert find_paying(make_runs(factors)) == expected


@pytest.mark.nightly
def test_a_part_that_pays_more_with_more_buttons_lowers_the_exponent():
    growing, constant = (answer(make_runs({"structure": factor}), DATA) for factor in (lambda n: n**0.8, lambda n: 4.0))
    assert [one.lowers_exponent for one in growing if one.part == "structure"].count(True) >= 3
    assert not any(one.lowers_exponent for one in constant)


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


@pytest.mark.nightly
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


def test_a_cell_is_given_up_after_its_first_runs_with_some_number_of_buttons_all_fail():
    runs = [PartsRun("flat", "ignore", 4, seed, 0.0, None, None, DESIGN) for seed in range(5)]
    assert is_given_up(runs, 4, 5) and is_given_up(runs, 20, 5) and not is_given_up(runs, 3, 5)
    assert not is_given_up(runs[:4], 4, 5)
    assert not is_given_up([*runs[:4], dataclasses.replace(runs[4], first_escape=9)], 8, 5)


def test_registered_runs_that_are_missing_are_named():
    runs = make_runs({"geometry": lambda n: 4.0})
    assert not list_missing(DATA, "first", runs)
    given_up = [run for run in runs if run.cell != "flat" or run.buttons < 8]
    kept = [dataclasses.replace(run, first_escape=None) if (run.cell, run.buttons) == ("flat", 6) else run
            for run in given_up]
    assert not list_missing(DATA, "first", kept), "what was given up is not missing"
    assert {(run.cell, run.buttons) for run in list_missing(DATA, "first", given_up)} == {
        ("flat", size) for size in DATA["sizes"] if size >= 8}
    with pytest.raises(ComparisonError, match="still to be made: {'confirmation': 1}"):
        analyse(STUDY, [*runs, *make_runs({}, "confirmation")[1:]])


def test_sizes_are_compared_apart_and_only_where_both_were_run():
    """With 2 buttons the part saves half, with 4 the other never escapes, and with 6 it was not run."""
    def make(cell: str, buttons: int, ends: list[int | None]) -> list[PartsRun]:
        return [PartsRun(cell, "reset", buttons, seed, 0.0, end, None, DESIGN) for seed, end in enumerate(ends)]

    runs = [*make("with", 2, [10, 20, 30]), *make("without", 2, [20, 40, 60]), *make("with", 4, [10, 20, None]),
            *make("without", 4, [None, None, None]), *make("with", 6, [10, 10, 10])]
    found = compare_sizes(runs, "with", "without", "reset")
    assert found == {2: SizeRatio(2.0, 3, 3), 4: SizeRatio(math.inf, 2, 3)}
    assert compare_sizes(runs, "without", "with", "reset")[4].median == 0.0
    noisy = [dataclasses.replace(run, failure=0.5) for run in runs]
    assert compare_sizes(noisy, "with", "without", "reset") == {}


def test_laws_are_told_apart():
    def make(law: Callable[[int], float]) -> list[PartsRun]:
        rng = np.random.default_rng(3)
        return [PartsRun("flat", "ignore", size, seed, 0.0, round(law(size) * math.exp(0.2 * rng.normal())), None, "")
                for size in DATA["sizes"] for seed in range(12)]

    power, steep = fit_law(make(lambda n: 20 * n**1.6)), fit_law(make(lambda n: 60 * 1.35**n))
    assert power is not None and steep is not None and fit_law([]) is None
    assert power.low < 1.6 < power.high and power.constant == pytest.approx(20, rel=0.3)
    assert (power.shape, steep.shape) == ("power law", "exponential")


@pytest.mark.nightly
@pytest.mark.nightly_for("10.0-0.9")
@pytest.mark.parametrize(("gain", "expected"), [(0.5, 0.0), (10.0, 0.9), (1000.0, 1.0)])
def test_the_exchange_rate_is_where_the_gain_is_gone(gain: float, expected: float):
    runs = make_runs({"structure": lambda n: gain}, spread=0.05)
    found = find_exchange(runs, DATA, "ignore")
    assert found.failure == pytest.approx(expected, abs=0.02) and found.low <= found.failure <= found.high


# --- the design ------------------------------------------------------------------------------


def test_every_published_line_is_of_the_registered_design():
    lines = [json.loads(row) for row in read_rows(STUDY.folder / "raw.jsonl")]
    assert lines and {line["design"] for line in lines} == {DESIGN}
    pilots = range(DATA["pilots"]["first_seed"], DATA["pilots"]["first_seed"] + DATA["pilots"]["runs"])
    assert not {line["seed"] for line in lines} & set(pilots)
    assert DESIGN in (STUDY.folder.parents[1] / "docs/results/learning-structure.md").read_text()


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
