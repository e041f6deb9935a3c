"""The table of the canon: sentences from data of other truths, the choice of settings, and real runs."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hrl_escape.errors import ComparisonError, UnknownNameError
from studies.canon.analysis import (
    CanonRun,
    Standing,
    choose_candidate,
    list_families,
    shorten,
    tell_leads,
    tell_standing,
)
from studies.page import render
from studies.running import open_store, run_study
from studies.statistics import find_lasting
from studies.study import Page, find_study
from tests.studies.pages import tell as write_page

STUDY = find_study("canon")
FAMILIES = list_families(STUDY)
LEARNERS = {label: family for family in FAMILIES for label in family.learners}
SEARCH_BASELINES = STUDY.data["searchers"]
REFERENCES = [*STUDY.data["chance"], *SEARCH_BASELINES, *STUDY.data["told"]]
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
    """Single moves never escape, presses come to 0.4, searchers to 0.7, hierarchies that are given to 0.9."""
    if agent in MOVES:
        return 0.0
    return 0.7 if agent in SEARCH_BASELINES else 0.9 if "planned" in agent or agent == "oracle" else 0.4


def change(changes: dict[str, float]) -> Callable[[str, str], float]:
    return lambda agent, kind: changes.get(agent, usual(agent, kind))


def tell(lines: list[CanonRun]) -> str:
    """The page of lines, without its figure, which takes longer than the rest."""
    return render(STUDY, Page(tell_standing(Standing.read(STUDY, lines))))


def read(efficiency: Callable[[str, str], float]) -> str:
    return tell(make_lines(efficiency))


# --- sentences -------------------------------------------------------------------------------


@pytest.mark.nightly
def test_who_beats_the_searcher_is_the_headline(tmp_path: Path):
    page = write_page("canon", make_lines(change({MODEL: 0.9, DAC: 0.8})), tmp_path)
    assert re.search(r"\*\*2 of 30 learners beat the best searcher, which learns nothing, over 2 kinds of rooms: "
                     rf"`{re.escape(MODEL)}` \(\+0\.\d\d\) and `{re.escape(DAC)}` \(\+0\.\d\d\); 28 of 30 reach "
                     r"less\.\*\*", page)
    assert f"Begin with `{MODEL}` where a planner can press for you" in page
    assert "report a searcher beside your learner: 28 of 30 here are not shown to beat it." in page
    assert (tmp_path / "figures/canon.svg").stat().st_size > 20_000


def test_a_canon_below_the_searcher_is_told_so():
    page = read(usual)
    assert ("**No learner is shown to beat the best searcher, which learns nothing, over 2 kinds of rooms; 30 of 30 "
            "reach less.**") in page
    assert "nothing here is shown to beat it." in page


def test_a_gain_in_one_room_of_twenty_is_no_gain():
    lines = make_lines(change({MODEL: 0.7, **dict.fromkeys(SEARCH_BASELINES, 0.7)}))
    lucky = [run if run.agent != MODEL or run.room != f"{FIVE}/test#3" else make_run(MODEL, 1, run.room, 1.0)
             for run in lines]
    assert "No learner is shown to beat" in tell(lucky)


def test_the_searcher_that_is_best_in_a_kind_is_the_bar():
    first, second, third = SEARCH_BASELINES
    bars = {(first, PAIR): 0.9, (second, FIVE): 0.9, (first, FIVE): 0.2, (second, PAIR): 0.2, (third, PAIR): 0.2,
            (third, FIVE): 0.2}
    page = read(lambda agent, kind: bars.get((agent, kind), change({MODEL: 0.7})(agent, kind)))
    assert "No learner is shown to beat the best searcher" in page  # each alone has 0.55 at most


def test_hierarchies_are_held_against_their_flat_controls():
    page = read(change({CRITIC: 0.6, DAC: 0.1}))
    assert ("- Of 23 hierarchies held against the flat learner that chooses among the same presses, 1 gains: "
            f"`{CRITIC}` (+0.1") in page
    assert f"1 loses: `{DAC}` (-0.3" in page and "21 cannot be told apart." in page
    turned = read(change({TABLE: 0.6, PPO: 0.1}))
    (told,) = [line for line in turned.splitlines() if "held against the flat" in line]
    assert re.search(r"6 gain, most of all `smdp-\w+` \(\+0\.\d", told)
    assert "; 10 lose, most of all `" in told
    assert told.count("`smdp-") == 6 and told.endswith("; 7 cannot be told apart."), "three of each are named"
    assert f"- `{CRITIC}` against `{TABLE}`: **-0.2" in turned, "all stand further down"


def test_who_cannot_be_run_in_a_kind_of_rooms_is_measured_in_the_others():
    reach, unfit = "ladder-1/reach", ["hiro+learned", "hrac+learned"]
    lines = [run for run in make_lines(change(dict.fromkeys(unfit, 0.5)), (PAIR, reach))
             if run.kind != reach or run.agent not in unfit]
    page = tell(lines)
    assert "over 2 kinds of rooms" in page and "two to four, by hand (`ladder-1/reach`)" in page
    assert ("Not run: `hiro+learned` and `hrac+learned` with two to four, by hand, as displacements move the base "
            "alone. A learner that is not run") in page
    assert page.count("Not run:") == page.count("displacements move the base alone") == 1, "one reason, told once"
    assert "means over 2 kinds, open ones over fewer." in page and "open ones" not in read(usual)
    assert "`r-maxq+planned` with" not in page, "the kinds that it lacks are not here"
    assert re.search(r"\| `hiro\+learned` \| 0\.\d\d \|  \| \*\*-0\.2\d \(", page), "against the searcher of one kind"
    assert "learners of displacements over single moves (" not in page, "no mean over fewer kinds stands in the order"
    lacking = [run for run in lines if run.kind != reach or run.agent != PPO]
    assert "not run whole: two to four, by hand" not in page and "two to four, by hand" in tell(lacking)
    assert "over 1 kind of rooms" in tell(lacking), "who can be run there must be"


def test_families_stand_in_order_of_their_best():
    page = read(change({MODEL: 0.9, DAC: 0.6, "hamq+planned": 0.97}))
    (told,) = [line for line in page.splitlines() if line.startswith("- By the best of each family")]
    (searcher,) = re.findall(r"the best searcher \((0\.\d\d)\)", told)
    assert 0.7 <= float(searcher) < 0.75, "the best of three in each kind"
    order = [told.index(words) for words in (
        "come hierarchies that are given, with a planned low level (`hamq+planned` +0.2",
        f"learners of structure over planned presses (`{MODEL}` +0.",
        f"below it stay learners of their own options over planned presses (`{DAC}` -0.1")]
    assert order == sorted(order)
    other = read(change(dict.fromkeys((label for label in LEARNERS if "planned" in label), 0.3)))
    assert re.search(r"- By the best of each family, below the best searcher \(0\.\d\d\) stay", other)


def test_one_leader_and_several_are_told_apart():
    assert f"- One learner leads in every kind of rooms: `{MODEL}`." in read(change({MODEL: 0.8}))
    assert tell_leads({"a": {"x": 0.912, "y": 0.909, "z": 0.5}, "b": {"x": 0.701, "y": 0.699, "z": 0.698}}) == (
        "2 learners share the lead in every kind of rooms, `x` among them.")
    assert tell_leads({"a": {"x": 0.9, "y": 0.9, "z": 0.5}, "b": {"x": 0.1, "y": 0.1, "z": 0.6}}) == (
        "No one learner leads everywhere (by means to two digits, not tested): `x` and `y` tie with a; `z` leads "
        "with b.")
    many = dict.fromkeys("tuvw", 0.9)
    assert tell_leads({"a": many | {"z": 0.5}, "b": many | {"z": 0.95}}) == (
        "No one learner leads everywhere (by means to two digits, not tested): 4 learners tie with a; `z` leads with "
        "b.")
    page = read(lambda agent, kind: 0.8 if (agent, kind) in ((MODEL, PAIR), (DAC, FIVE)) else usual(agent, kind))
    assert (f"- No one learner leads everywhere (by means to two digits, not tested): `{MODEL}` leads with two "
            f"buttons; `{DAC}` leads with five buttons.") in page


def test_learners_that_would_have_one_name_in_the_figure_keep_what_tells_them_apart():
    assert shorten(["h-dqn@table+learned", "h-dqn@table+planned", "smdp-ppo", "hac+learned"]) == {
        "h-dqn@table+learned": "h-dqn@table+learned", "h-dqn@table+planned": "h-dqn@table+planned",
        "smdp-ppo": "smdp-ppo", "hac+learned": "hac"}
    assert len(set(shorten(list(LEARNERS)).values())) == len(LEARNERS)


def test_those_that_choose_single_moves_are_counted():
    count = len(MOVES)
    assert (f"- Of {count} learners of single moves {count} end without an escape in every room with two buttons after "
            "20,000 primitives, hierarchies or not. None of these was run in other rooms.") in read(usual)
    page = read(change(dict.fromkeys(MOVES, 0.2)))
    assert f"- Every one of {count} learners of single moves ends with some escape in rooms with two buttons." in page
    assert f"hierarchies or not; over presses `{DAC}` as well. None of these" in read(change({DAC: 0.0}))
    some = read(change({"dqn": 0.2}))
    assert f"Of {count} learners of single moves {count - 1} end without" in some
    assert some.index("2 kinds of rooms") and "31 of 31 reach less" in some  # who escapes is followed


def test_what_being_told_the_graph_brings_is_a_sentence_of_its_own():
    told = [label for label in LEARNERS if "planned" in label]
    page = read(usual)
    study = dataclasses.replace(STUDY, data=STUDY.data | {"families": [
        table | ({"given": "the places"} if "hiro+learned" in table["learners"] else {})
        for table in STUDY.data["families"]]})
    followed = tell_standing(Standing.read(study, make_lines(change({"hiro+learned": 0.2}))))["sentences"]
    assert "Even told the places, no hierarchy is shown to beat the best searcher." in followed
    assert f"- Told the task graph, which searchers have to find, {len(told)} of {len(told)} hierarchies beat" in page
    page = read(change(dict.fromkeys(told, 0.5)))
    assert "- Even told the task graph, no hierarchy is shown to beat the best searcher." in page


def test_learners_of_fewer_rooms_are_held_against_others_in_these_rooms_alone():
    """From the eleventh room on, which one learner is not run in, nothing escapes, neither searchers nor others."""
    lines = [dataclasses.replace(line, efficiency=0.0, escapes=0.0)
             if "/test#1" in line.room and not line.room.endswith("#1") else line
             for line in make_lines(change({MODEL: 0.97, DAC: 0.85}), rooms=20)]
    page = tell([line for line in lines if line.agent != DAC or line.efficiency])
    assert "Mean efficiency over 20 rooms of each kind, or as many as stand in brackets:" in page
    some = tell([line for line in lines if line.kind == PAIR or int(re.findall(r"#(\d+)", line.room)[0]) < 10])
    assert "Mean efficiency over 10 or 20 rooms of each kind" in some
    assert re.search(rf"\| `{re.escape(DAC)}` \| 0\.4\d \| 0\.8\d \|", some), "in every kind as many as all others"
    assert re.search(rf"\| `{re.escape(DAC)}` \| 0\.\d\d \(10\) \| 0\.\d\d \(10\) \| \*\*\+0\.[12]\d \(", page)
    assert re.search(rf"\| `{re.escape(MODEL)}` \| 0\.[45]\d \| 0\.[45]\d \|", page), "over all rooms"
    assert f"One learner leads in every kind of rooms: `{MODEL}`." in page, "by the rooms that all have"
    assert re.search(rf"\(`{re.escape(DAC)}` \+0\.[12]\d\)", page), "beside the searcher in its rooms"


def test_kinds_that_lack_runs_are_left_out_and_named():
    lines = make_lines(usual)
    page = tell(lines[:-1])
    assert "over 1 kind of rooms" in page and f"not run whole: five buttons (`{FIVE}`)" in page
    for few in (make_lines(usual, rooms=5), make_trials()):
        assert "**Nothing is concluded yet, as the rooms with two buttons lack runs" in tell(few)


def test_waits_are_medians_over_all_rooms_and_those_that_never_end_are_counted():
    waits = iter([*range(100, 1000, 100), *[None] * 11])  # nine of twenty
    lines = [dataclasses.replace(line, first_escape=next(waits), seconds=4.0)
             if line.agent == MODEL and "/test#" in line.room else line for line in make_lines(usual)]
    (row,) = [line for line in tell(lines).splitlines() if line.startswith(f"| `{MODEL}` | defaults")]
    assert row.endswith("| 0.50 | 100% | not in half (9 of 20) | not in half (0 of 20) | 4.0 |")
    early = [dataclasses.replace(line, first_escape=50) if line.first_escape is None else line for line in lines]
    assert "| 50 (20 of 20) |" in tell(early)


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


def test_runs_with_other_settings_than_the_chosen_do_not_count():
    lines = make_lines(usual, best={MODEL: 2})
    stray = [make_run(MODEL, 1, f"{kind}/test#{room}", 1.0) for kind in (PAIR, FIVE) for room in range(10)]
    assert "No learner is shown" in tell([*lines, *stray])


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


def test_a_learner_that_never_escaped_from_the_easiest_rooms_is_not_run_in_others(tmp_path: Path):
    study, args = run(tmp_path, agents=(MODEL, "oracle"), kinds=(FIVE,), rooms=1)
    store = open_store(study, args.docs)
    trials = [line for line in make_trials() if line.agent == MODEL]
    store.add([*trials, *(make_run(MODEL, 1, f"{PAIR}/test#{room}", 0.0, 500) for room in range(10))])
    study.analysis.measure(study, args, store)
    assert {line.agent for line in store.load() if line.room.startswith(f"{FIVE}/test#")} == {"oracle"}


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
    study, args = run(tmp_path, agents=("hiro+learned", "oracle"), kinds=("ladder-1/reach",), rooms=1)
    store = open_store(study, args.docs)
    store.add([line for line in make_trials() if line.agent == "hiro+learned"])
    study.analysis.measure(study, args, store)
    assert {line.agent for line in store.load() if "/test#" in line.room} == {"oracle"}


def test_agents_and_kinds_that_are_unknown_are_named(tmp_path: Path):
    for changes, what in (({"agents": ("dqm",)}, "agent"), ({"kinds": ("ladder-1/pear",)}, "kind")):
        study, args = run(tmp_path, **changes)
        with pytest.raises(UnknownNameError, match=f"{what} of this study"):
            run_study(study, args)
