"""Every algorithm on the same rooms: comparisons of known data, the choice of settings, and real runs."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hrl_escape.errors import ComparisonError, UnknownNameError
from studies.canon.analysis import CanonRun, choose_candidate, list_families
from studies.pages.all_algorithms import RULES
from studies.running import open_store, run_study
from studies.statistics import find_lasting
from studies.study import find_study

STUDY = find_study("canon")
FAMILIES = list_families(STUDY)
LEARNERS = {label: family for family in FAMILIES for label in family.learners}
SEARCH_BASELINES = STUDY.data["search"]
REFERENCES = [*STUDY.data["chance"], *SEARCH_BASELINES, *STUDY.data["privileged"]]
PAIR, FIVE = list(STUDY.data["kinds"])[:2]
TABLE, MODEL = "smdp-q-learning", "smdp-factored-r-max"
CRITIC, DAC, PPO = "smdp-option-critic", "smdp-dac", "smdp-ppo"
MOVES = [label for label in LEARNERS if not label.startswith("smdp-") and "planned" not in label]


def make_run(agent: str, candidate: int, room: str, efficiency: float, first_escape: int | None = 300) -> CanonRun:
    return CanonRun(agent, candidate, room, 20_000, efficiency, float(efficiency > 0), 0.5, first_escape,
                    4_000 if efficiency >= 0.9 else None, 2.5, "key")


def make_trials(best: dict[str, int] | None = None) -> list[CanonRun]:
    """Trials in which the first settings are best, or others by learner."""
    return [make_run(label, number, room, 0.6 if number == (best or {}).get(label, 1) else 0.4)
            for label, family in LEARNERS.items() for room in family.trials
            for number in range(1, len(family.learners[label]) + 1)]


def make_lines(efficiency: Callable[[str, str], float], kinds: tuple[str, ...] = (PAIR, FIVE), rooms: int = 10,
               best: dict[str, int] | None = None) -> list[CanonRun]:
    """Runs around these efficiencies by agent and kind; those that never escape are left out of the second kind."""
    rng, lines = np.random.default_rng(0), make_trials(best)
    for kind in kinds:
        for agent in (*REFERENCES, *LEARNERS):
            if kind == PAIR or agent in REFERENCES or efficiency(agent, PAIR):
                mean, number = efficiency(agent, kind), (best or {}).get(agent, 1) if agent in LEARNERS else 0
                lines += [make_run(agent, number, f"{kind}/test#{room}",
                                   float(np.clip(mean + 0.03 * rng.normal(), 0, 1)) if mean else 0.0)
                          for room in range(rooms)]
    return lines


def usual(agent: str, kind: str) -> float:
    """Single moves never escape, presses come to 0.4, search baselines to 0.7, hierarchies that are given to 0.9."""
    if agent in MOVES:
        return 0.0
    return 0.7 if agent in SEARCH_BASELINES else 0.9 if "planned" in agent or agent == "oracle" else 0.4


def change(changes: dict[str, float]) -> Callable[[str, str], float]:
    return lambda agent, kind: changes.get(agent, usual(agent, kind))


# --- comparisons -----------------------------------------------------------------------------


def read(lines: list[CanonRun]) -> Any:
    """Numbers of the analysis."""
    return STUDY.analysis.analyse(STUDY, lines).numbers


@pytest.fixture(scope="module")
def usual_numbers() -> Any:
    return read(make_lines(usual))


def test_learners_are_compared_with_the_best_search_baseline(usual_numbers: Any):
    found = read(make_lines(change({MODEL: 0.9, DAC: 0.8}))).beyond
    assert {label for label, each in found.items() if each.sign > 0} == {MODEL, DAC} and len(found) == 30
    assert not any(each.sign > 0 for each in usual_numbers.beyond.values())


def test_a_gain_in_one_room_of_twenty_is_no_gain():
    lines = make_lines(change({MODEL: 0.7, **dict.fromkeys(SEARCH_BASELINES, 0.7)}))
    lucky = [run if run.agent != MODEL or run.room != f"{FIVE}/test#3" else make_run(MODEL, 1, run.room, 1.0)
             for run in lines]
    assert read(lucky).beyond[MODEL].sign <= 0


def test_the_search_baseline_that_is_best_in_a_kind_counts():
    first, second, third = SEARCH_BASELINES
    bars = {(first, PAIR): 0.9, (second, FIVE): 0.9, (first, FIVE): 0.2, (second, PAIR): 0.2, (third, PAIR): 0.2,
            (third, FIVE): 0.2}
    found = read(make_lines(lambda agent, kind: bars.get((agent, kind), change({MODEL: 0.7})(agent, kind))))
    assert found.beyond[MODEL].sign < 0, "each alone has 0.55 at most"


def test_hierarchies_are_compared_with_their_flat_controls(usual_numbers: Any):
    found = read(make_lines(change({CRITIC: 0.6, DAC: 0.1}))).controls
    assert {label: each.sign for label, each in found.items() if each.sign} == {CRITIC: 1, DAC: -1}
    assert len(found) == 23 and not any(each.sign for each in usual_numbers.controls.values())


@pytest.mark.parametrize(("lowest", "holds"), [(0.91, True), (0.89, False)])
def test_hierarchies_are_called_bounded_only_where_a_flat_learner_leaves_little(lowest: float, holds: bool):
    numbers = SimpleNamespace(canon=SimpleNamespace(means={"smdp-r-max": {PAIR: lowest, FIVE: 0.95}}))
    assert RULES["bounded"](numbers) == RULES["learn-a-model"](numbers) == holds


@pytest.mark.parametrize(("lost", "most", "holds"), [(19, 0.22, True), (18, 0.22, False), (19, 0.3, False)])
def test_learners_of_moves_are_called_a_floor_only_where_they_end_there(lost: int, most: float, holds: bool):
    numbers = SimpleNamespace(canon=SimpleNamespace(lost_moves=lost, moves=27, most_of_moves=most))
    assert RULES["moves-fail"](numbers) == holds


@pytest.mark.nightly
def test_a_learner_that_is_not_run_in_a_kind_is_measured_in_the_others():
    reach, unfit = "ladder-1/reach", ["hiro-finite+learned", "hrac-finite+learned"]
    lines = [run for run in make_lines(change(dict.fromkeys(unfit, 0.5)), (PAIR, reach))
             if run.kind != reach or run.agent not in unfit]
    found = STUDY.analysis.analyse(STUDY, lines)
    assert set(found.numbers.means["hiro-finite+learned"]) == {PAIR} and set(found.numbers.means[PPO]) == {PAIR, reach}
    assert found.numbers.beyond["hiro-finite+learned"].mean == pytest.approx(-0.2, abs=0.05)
    assert found.tables["canon_unfit"].count("| displacements move the base alone |") == 2
    assert "R-MAXQ" not in found.tables["canon_unfit"], "the kinds that it lacks are not here"
    lacking = [run for run in lines if run.kind != reach or run.agent != PPO]
    assert len(read(lacking).kinds) == 1


def test_learners_of_single_moves_without_an_escape_are_counted(usual_numbers: Any):
    count = len(MOVES)
    assert (usual_numbers.lost_moves, usual_numbers.moves, usual_numbers.most_of_moves) == (count, count, 0)
    some = read(make_lines(change({"dqn": 0.2})))
    assert some.lost_moves == count - 1 and len(some.beyond) == 31, "a learner that escapes is followed"
    assert some.most_of_moves == pytest.approx(0.2, abs=0.05)


def test_learners_that_are_given_the_graph_are_compared_apart(usual_numbers: Any):
    planned = {label for label in LEARNERS if "planned" in label}
    assert planned and not planned & usual_numbers.beyond.keys()


def test_learners_of_fewer_rooms_are_compared_in_these_rooms_alone():
    """From the eleventh room on, which one learner is not run in, nothing escapes."""
    lines = [dataclasses.replace(line, efficiency=0.0, escapes=0.0)
             if "/test#1" in line.room and not line.room.endswith("#1") else line
             for line in make_lines(change({MODEL: 0.97, DAC: 0.85}), rooms=20)]
    found = STUDY.analysis.analyse(STUDY, [line for line in lines if line.agent != DAC or line.efficiency])
    assert found.numbers.means[DAC][PAIR] > 0.8 and found.numbers.means[MODEL][PAIR] < 0.6
    row = r"\| DAC over options \| 0\.8\d \(10\) \| 0\.8\d \(10\) \| \*\*\+0\.[12]\d \("
    assert re.search(row, found.tables["canon"])


def test_kinds_that_lack_runs_are_left_out():
    assert len(read(make_lines(usual)[:-1]).kinds) == 1
    for few in (make_lines(usual, rooms=5), make_trials()):
        with pytest.raises(ComparisonError, match="rooms of ladder-1/pair lack runs"):
            read(few)


def test_waits_are_medians_over_all_rooms_and_those_that_never_end_are_counted():
    waits = iter([*range(100, 1000, 100), *[None] * 11])  # nine of twenty
    lines = [dataclasses.replace(line, first_escape=next(waits), seconds=4.0)
             if line.agent == MODEL and "/test#" in line.room else line for line in make_lines(usual)]
    table = STUDY.analysis.analyse(STUDY, lines).tables["canon_courses"]
    (row,) = [line for line in table.splitlines() if f"`{MODEL}`" in line]
    assert row.endswith("| 0.50 | 100% | not in half (9 of 20) | not in half (0 of 20) | 4.0 |")


def test_runs_with_other_settings_than_the_chosen_do_not_count():
    lines = make_lines(usual, best={MODEL: 2})
    stray = [make_run(MODEL, 1, f"{kind}/test#{room}", 1.0) for kind in (PAIR, FIVE) for room in range(10)]
    assert read([*lines, *stray]).beyond[MODEL].sign < 0


def test_an_efficiency_counts_where_the_next_evaluation_has_it_too():
    at = range(0, 20_000, 4_000)
    assert find_lasting(zip(at, [0.0, 0.95, 0.2, 0.9, 1.0], strict=True), 0.9) == 12_000
    assert find_lasting(zip(at, [0.0, 0.95, 0.2, 0.8, 1.0], strict=True), 0.9) is None


# --- settings --------------------------------------------------------------------------------


def test_settings_are_those_of_the_best_mean_trial_then_of_the_quickest():
    family = LEARNERS[MODEL]
    assert choose_candidate(family, MODEL, make_trials({MODEL: 2}))[0].settings["max_parents"] == 3
    equal = [make_run(MODEL, number, room, 0.5, first_escape=400 - 100 * (number == 3))
             for number in (1, 2, 3) for room in family.trials]
    assert choose_candidate(family, MODEL, equal)[1] == 3
    late = [make_run(MODEL, number, room, 0.5, None if number == 1 else 19_000)
            for number in (1, 2, 3) for room in family.trials]
    assert choose_candidate(family, MODEL, late)[1] == 2
    with pytest.raises(ComparisonError, match="has 2 trials of 3 with settings 3"):
        choose_candidate(family, MODEL, equal[:-1])


def test_every_learner_has_three_settings_that_exist_and_differ():
    for label, family in LEARNERS.items():
        made = [dict(settings) for settings in family.learners[label]]
        assert len(made) == 3 and all(made.count(settings) == 1 for settings in made), label
    assert set(STUDY.data["controls"]) <= LEARNERS.keys() and set(STUDY.data["controls"].values()) <= LEARNERS.keys()


def test_trials_are_in_rooms_that_no_result_is_from():
    assert all("/valid#" in room for family in FAMILIES for room in family.trials)


# --- real runs -------------------------------------------------------------------------------


def run(folder: Path, **changes: object):
    args = find_study("canon").analysis.Args(docs=folder / "docs", out=folder / "runs", workers=1, **changes)
    study = find_study("canon")
    study.data["primitives"], study.data["eval_every"] = 400, 200
    return study, args


@pytest.mark.nightly
def test_real_trials_are_kept_line_by_line(tmp_path: Path):
    study, args = run(tmp_path, agents=("q-learning",), trials=True)
    store = open_store(study, args.docs)
    study.analysis.measure(study, args, store)
    (room,) = LEARNERS["q-learning"].trials
    assert {(line.agent, line.candidate, line.room) for line in store.load()} == {
        ("q-learning", number, room) for number in (1, 2, 3)}


@pytest.mark.nightly
def test_real_runs_have_the_chosen_settings_and_are_not_made_twice(tmp_path: Path):
    study, args = run(tmp_path, agents=(MODEL, "oracle"), kinds=(PAIR,), rooms=1)
    store = open_store(study, args.docs)
    trials = [line for line in make_trials({MODEL: 2}) if line.agent == MODEL]
    store.add(trials)
    study.analysis.measure(study, args, store)
    planner, model = [line for line in store.load() if line not in trials]
    assert [(line.agent, line.candidate, line.primitives, line.room) for line in (planner, model)] == [
        ("oracle", 0, 0, f"{PAIR}/test#0"), (MODEL, 2, 400, f"{PAIR}/test#0")]
    assert planner.efficiency == planner.escapes == 1 and 0 < model.first_escape <= 400 and model.seconds > 0
    text = store.path.read_text()
    study.analysis.measure(study, args, store)
    assert store.path.read_text() == text


@pytest.mark.nightly
def test_a_learner_that_never_escaped_from_the_easiest_rooms_is_not_run_in_others(tmp_path: Path):
    study, args = run(tmp_path, agents=(MODEL, "oracle"), kinds=(FIVE,), rooms=1)
    store = open_store(study, args.docs)
    trials = [line for line in make_trials() if line.agent == MODEL]
    store.add([*trials, *(make_run(MODEL, 1, f"{PAIR}/test#{room}", 0.0, 500) for room in range(10))])
    study.analysis.measure(study, args, store)
    assert {line.agent for line in store.load() if line.room.startswith(f"{FIVE}/test#")} == {"oracle"}


@pytest.mark.nightly
def test_a_learner_whose_runs_take_long_is_run_in_the_first_rooms_alone(tmp_path: Path):
    study, args = run(tmp_path, agents=(MODEL, "smdp-dqn"), kinds=(PAIR,), rooms=2)
    assert "smdp-dqn" in study.data["slow"]["learners"]
    assert set(study.data["slow"]["learners"]) <= LEARNERS.keys()
    study.data["slow"]["rooms"] = 1
    store = open_store(study, args.docs)
    store.add([line for line in make_trials() if line.agent in args.agents])
    study.analysis.measure(study, args, store)
    assert [(line.agent, line.room) for line in store.load() if "/test#" in line.room] == [
        *((agent, f"{PAIR}/test#0") for agent in ("smdp-dqn", MODEL)), (MODEL, f"{PAIR}/test#1")]


@pytest.mark.nightly
def test_a_learner_is_not_run_where_it_cannot_be(tmp_path: Path):
    study, args = run(tmp_path, agents=("hiro-finite+learned", "oracle"), kinds=("ladder-1/reach",), rooms=1)
    store = open_store(study, args.docs)
    store.add([line for line in make_trials() if line.agent == "hiro-finite+learned"])
    study.analysis.measure(study, args, store)
    assert {line.agent for line in store.load() if "/test#" in line.room} == {"oracle"}


def test_agents_and_kinds_that_are_unknown_are_named(tmp_path: Path):
    for changes, what in (({"agents": ("dqm",)}, "agent"), ({"kinds": ("ladder-1/pear",)}, "kind")):
        study, args = run(tmp_path, **changes)
        with pytest.raises(UnknownNameError, match=f"{what} of this study"):
            run_study(study, args)
