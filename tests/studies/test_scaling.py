"""The scaling study: runs in real rooms, studies that go on, and rules with data of other truths."""

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace

import pytest

from hrl_escape.errors import ComparisonError, UnknownNameError
from studies.__main__ import main
from studies.pages.learning_structure import RULES
from studies.scaling import rounds as scaling
from studies.scaling.analysis import Args, analyse, compare_given, follow, measure
from studies.scaling.results import RoomKind, ScalingRun
from studies.scaling.rounds import AGENTS, BAR, GIVEN, GIVEN_TASKS, HOLDS, choose_options, make_room, run_once
from studies.store import Store
from studies.study import find_study
from tests.studies.lines import load, save


def make_result(agent="smdp-factored-r-max", buttons=10, rule="ignore", run=0, graph="layered", first=400, near=900):
    structure = ((100, 0.5, 0.25), (800, 1.0, 1.0)) if agent != "random-options" else ()
    measured = {"best": 50.0, "worst": -1000.0, "budget": 20_000, "primitives": 20_000, "decisions": 900,
                "seconds": 1.5}
    return ScalingRun(graph, buttons, rule, agent, run, "abc", **measured, first_escape=first, near_best=near, edges=4,
                      depth=3, structure=structure)


def run_here(out: Path, task: RoomKind, agent: str, seed: int, primitives: int) -> ScalingRun:
    run = run_once(task, choose_options(agent), seed, primitives, out, math.inf)
    assert run is not None
    return run


def forget_time(runs: list[ScalingRun]) -> set[ScalingRun]:
    return {dataclasses.replace(run, seconds=0.0) for run in runs}


@pytest.mark.slow
def test_factored_r_max_is_near_the_best_of_a_real_room_and_has_its_graph(tmp_path):
    for rule in ("ignore", "reset"):
        run = run_here(tmp_path, RoomKind("chain", 4, rule), "smdp-factored-r-max", 0, 4_000)
        assert run.first_escape is not None and run.near_best is not None
        assert run.first_escape <= run.near_best < run.primitives < 4_000, "it stops once the room is solved"
        assert run.edges == 3 and run.depth == 3
        assert run.structure[-1][1:] == (1.0, 1.0)


@pytest.mark.nightly
def test_a_run_gives_the_published_numbers(tmp_path):
    """These runs are lines of the study's results."""
    published = Store(find_study("scaling").folder / "raw.jsonl", (ScalingRun,)).load()
    chosen = [run for run in published if (run.task, run.run) == (RoomKind("chain", 4, "reset"), 0)
              and run.agent in ("smdp-factored-r-max", "random-options")]
    assert len(chosen) == 2
    again = [run_here(tmp_path, run.task, run.agent, run.run, 20_000) for run in chosen]
    assert forget_time(again) == forget_time(chosen)


@pytest.mark.slow
def test_every_agent_runs(tmp_path):
    for agent in AGENTS:
        run = run_here(tmp_path, RoomKind("chain", 2, "ignore"), agent, 0, 60)
        assert run.primitives >= 60 or run.first_escape is not None


@pytest.fixture
def small_study(monkeypatch):
    for name, value in (("GRAPHS", ("chain",)), ("RULES", ("ignore",)), ("SIZES", (2, 4)), ("BAR_RUNS", 0)):
        monkeypatch.setattr(scaling, name, value)


@pytest.mark.nightly
def test_a_study_goes_on_where_it_was_stopped_and_tries_no_hopeless_rooms(tmp_path, small_study):
    study, store = find_study("scaling"), Store(tmp_path / "scaling.jsonl", (ScalingRun,))
    args = Args(out=tmp_path, workers=1, runs=1, primitives=60, parts=("bar", "agents"),
                agents=("smdp-r-max", "smdp-q-learning"))
    with pytest.raises(ComparisonError, match="no run is finished after 0 minutes"):
        measure(study, dataclasses.replace(args, minutes=0.0), store)
    measure(study, args, store)
    first = store.load()
    assert [run.buttons for run in first] == [2, 2], "60 primitives are too few, so there is no run with 4 buttons"
    store.path.write_text("".join(store.path.read_text().splitlines(keepends=True)[:-1]))
    kept, = store.load()
    measure(study, args, store)
    assert forget_time(store.load()) == forget_time(first) and kept in store.load(), "finished runs are kept"


def test_failures_count_where_they_were_not_tried_again():
    results = [make_result(), make_result(run=1, first=600, near=None), make_result(rule="reset"),
               make_result("random-options", first=None, near=None), make_result(buttons=20)]
    escapes = find(*results[1:]).scaling.escapes
    assert str(escapes["ignore", "smdp-factored-r-max", 10]) == "2 of 2; 500"
    assert str(escapes["ignore", "random-options", 20]) == "0 of 1; 20,000"
    assert ("ignore", "smdp-factored-r-max", 15) not in escapes
    assert find(*results[:0:-1]).scaling.escapes == escapes, "the order of lines does not matter"


def test_runs_of_another_budget_and_unknown_agents_are_refused_before_anything_runs(tmp_path, capsys):
    save("scaling", [make_result()], tmp_path)
    call = ["scaling", "--docs", str(tmp_path), "--out", str(tmp_path / "runs")]
    few = ["--parts", "told", "--runs", "1"]
    assert main([call[0], "--docs", str(tmp_path / "new"), *call[3:], *few, "--minutes", "0.000001"]) == 2
    assert "no run is finished after 1e-06 minutes" in capsys.readouterr().err
    assert main([*call, "--primitives", "60"]) == 2
    assert "the runs in" in (said := capsys.readouterr().err) and "have 20000. Choose another --docs" in said
    assert main([*call, "--agents", "smdp-dqm"]) == 2
    assert "unknown agent of the scaling study 'smdp-dqm'" in (said := capsys.readouterr().err) and "smdp-dqn" in said
    assert not list(tmp_path.glob("runs/*/runs/*")) and load("scaling", tmp_path) == [make_result()]


def test_failures_stay_in_medians_and_means():
    """Three of four escape: by hand, the curve is 1, 3/4, 1/2, 1/4 from 0, 100, 300, 500 on, and stays there."""
    own = [make_result(run=run, first=first) for run, first in enumerate((100, 300, 500))]
    fewer = [make_result(buttons=6, run=run, first=None) for run in (3, 4)]
    followed = follow([*own, fewer[0]], "ignore", own[0].agent, 10, 1_000)
    assert followed is not None and followed.median == 300
    assert followed.restricted_mean == pytest.approx(100 + 0.75 * 200 + 0.5 * 200 + 0.25 * 500)
    assert str(followed) == "3 of 4; 475"
    hopeless = follow([own[0], *fewer], "ignore", own[0].agent, 10, 1_000)
    assert hopeless is not None and hopeless.median is None
    assert follow(own, "ignore", own[0].agent, 20, 1_000) is None, "those that escaped were stopped by the time"
    assert follow(fewer, "reset", own[0].agent, 10, 1_000) is None


def test_what_structure_learners_are_given_is_what_the_labels_say():
    assert len({spec.label for spec in GIVEN}) == len(GIVEN) == 8
    for spec in GIVEN:
        settings = spec.resolve_settings()
        assert spec.label == f"{settings['conditions']}, {settings['max_parents']}"
    noisy, exact = make_room(GIVEN_TASKS[1]), make_room(GIVEN_TASKS[0])
    assert (noisy.dynamics.noise, noisy.dynamics.slip) == (0.1, 0.1)
    assert dataclasses.replace(noisy, name=exact.name, dynamics=exact.dynamics) == exact


LABELS = [spec.label for spec in GIVEN]
FEW: dict[str, int | None] = {"all-on, 1": None, "any, 1": None}


def make_given(waits: Mapping[str, int | None], runs: int = 10, rule: str = "ignore") -> list[ScalingRun]:
    """Runs of the labels that are near the best with the whole graph after so many primitives, or never."""
    exact, part = ((800, 1.0, 1.0),), ((100, 1.0, 0.5),)
    return [dataclasses.replace(
        make_result(label, run=run, rule=rule, near=wait), primitives=20_000 if wait is None else wait,
        structure=part if wait is None else exact) for label, wait in waits.items() for run in range(runs)]


def find(*runs: ScalingRun) -> SimpleNamespace:
    return SimpleNamespace(scaling=analyse(find_study("scaling"), [*runs, make_result()]).numbers)


def test_what_a_learner_is_given_costs_what_the_runs_show():
    """By hand: 20,000 in place of 900 is 19,100 more; the signs of ten pairs have p = 2 / 1,024, times 7 by Holm."""
    costs = compare_given(make_given({label: 900 for label in LABELS} | {"all-on, 1": None, "any, 4": 700}))
    assert ("ignore", HOLDS) not in costs and costs["ignore", "all-on, 1"].p == pytest.approx(7 * 2 / 2**10)
    assert costs["ignore", "all-on, 1"].mean == 19_100 and costs["ignore", "any, 4"].mean == -200
    assert {label: cost.sign for (_, label), cost in costs.items() if cost.sign} == {"all-on, 1": 1, "any, 4": -1}
    assert compare_given(make_given(dict.fromkeys(LABELS, 900), runs=9)) == {}, "nine pairs show nothing"


def test_rules_on_what_is_given_follow_the_runs():
    alike = dict.fromkeys(LABELS, 900)
    slow = find(*make_given(alike | FEW))
    assert RULES["give-enough-parents"](slow) and RULES["more-costs"](slow)
    assert not RULES["give-enough-parents"](find(*make_given(alike | FEW | {"any, 4": None}))), "as bad as they"
    assert not RULES["give-enough-parents"](find(*make_given(alike))) and not RULES["more-costs"](find(
        *make_given(alike | {"any, 4": 700} | FEW)))


def make_bar(near: int, first: int = 0) -> list[ScalingRun]:
    """Ten runs in each room of the bar, so many of which are near the best in the smaller one."""
    return [make_result(buttons=task.buttons, rule=task.rule, run=first + run,
                        near=900 if task.buttons == 20 or run < near else None) for task in BAR for run in range(10)]


@pytest.mark.parametrize(("published", "fresh", "passed"), [(10, 10, True), (9, 10, False), (10, 9, False)])
def test_the_bar_is_passed_by_all_published_and_all_fresh_runs(published: int, fresh: int, passed: bool):
    numbers = find(*make_bar(published), *make_bar(fresh, 100))
    assert RULES["the-bar-is-passed"](numbers) == passed
    assert [own.near_best for own in numbers.scaling.bar if own.runs == 10] == [10, 10, published, fresh]


@pytest.mark.parametrize("option", ["--runs=0", "--runs=-3", "--primitives=0", "--minutes=0"])
def test_a_study_of_nothing_is_refused_and_leaves_earlier_results_alone(tmp_path, capsys, option):
    save("scaling", [make_result()], tmp_path)
    assert main(["scaling", "--docs", str(tmp_path), "--out", str(tmp_path), option]) == 2
    assert "it must be above 0" in capsys.readouterr().err
    assert load("scaling", tmp_path) == [make_result()]


def test_results_of_an_unknown_agent_are_refused():
    with pytest.raises(UnknownNameError, match="smdp-dreamer"):
        find(make_result("smdp-dreamer"))
    with pytest.raises(ComparisonError, match="with the part agents"):
        analyse(find_study("scaling"), make_given({HOLDS: 900}))
