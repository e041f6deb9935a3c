"""The scaling study: runs in real rooms, studies that go on, and rules with data of other truths."""

import dataclasses
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from hrl_escape.errors import ComparisonError, UnknownNameError
from studies.__main__ import main
from studies.pages.scaling import RULES
from studies.scaling import rounds as scaling
from studies.scaling.analysis import analyse, compare_given
from studies.scaling.followed_runs import count_spared, follow_runs
from studies.scaling.results import RoomKind, ScalingRun
from studies.scaling.rounds import (
    AGENTS,
    BAR,
    GIVEN,
    GIVEN_TASKS,
    HOLDS,
    Round,
    choose_options,
    get_run_folder,
    make_room,
    run_round,
    run_scaling,
)
from studies.store import Store
from studies.study import find_study
from tests.studies.lines import load, save


def make_result(agent="smdp-factored-r-max", buttons=10, rule="ignore", run=0, graph="layered", first=400, near=900):
    structure = ((100, 0.5, 0.25), (800, 1.0, 1.0)) if agent != "random-options" else ()
    measured = {"best": 50.0, "worst": -1000.0, "budget": 20_000, "primitives": 20_000, "decisions": 900,
                "seconds": 1.5}
    return ScalingRun(graph, buttons, rule, agent, run, "abc", **measured, first_escape=first, near_best=near, edges=4,
                      depth=3, structure=structure)


def make_round(tasks: tuple[RoomKind, ...], agent: str, seed: int) -> Round:
    return Round(tasks, (choose_options(agent),), seed)


def run_rounds(out: Path, primitives: int, *rounds: Round, checkpoint_seconds: float = 30.0) -> list[ScalingRun]:
    return [run for part in rounds for run in run_round(part, out, primitives, checkpoint_seconds=checkpoint_seconds)]


def forget_time(runs: list[ScalingRun]) -> set[ScalingRun]:
    return {dataclasses.replace(run, seconds=0.0) for run in runs}


@pytest.mark.slow
def test_factored_r_max_is_near_the_best_of_a_real_room_and_has_its_graph(tmp_path):
    tasks = RoomKind("chain", 4, "ignore"), RoomKind("chain", 4, "reset")
    for run in run_rounds(tmp_path, 4_000, make_round(tasks, "smdp-factored-r-max", 0)):
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
    rounds = [make_round((run.task,), run.agent, run.run) for run in chosen]
    assert len(rounds) == 2
    assert forget_time(run_rounds(tmp_path, 20_000, *rounds)) == forget_time(chosen)


def test_kinds_that_are_one_room_share_its_run(tmp_path):
    """Two buttons have one edge at most, so that families of graphs coincide."""
    tasks = tuple(RoomKind(graph, 2, "ignore") for graph in scaling.GRAPHS)
    round_ = make_round(tasks, "random-options", 0)
    assert len({room.id for room in round_.rooms.values()}) < len(tasks)
    runs = run_rounds(tmp_path, 60, round_)
    assert sorted(run.task for run in runs) == sorted(tasks)
    rooms = {room.id for room in round_.rooms.values()}
    assert len({(run.room, run.primitives, run.first_escape) for run in runs}) == len(rooms)


@pytest.mark.slow
def test_every_agent_runs(tmp_path):
    everybody = Round((RoomKind("chain", 2, "ignore"),), tuple(map(choose_options, AGENTS)), 0)
    runs = run_rounds(tmp_path, 60, everybody)
    assert [run.agent for run in runs] == list(AGENTS)
    assert all(run.primitives >= 60 or run.first_escape is not None for run in runs)


@pytest.mark.slow
def test_a_killed_run_measures_what_an_uninterrupted_one_does(tmp_path):
    task, agent, seed = RoomKind("chain", 4, "reset"), "smdp-factored-r-max", 0
    script = ("import sys\n"
              "from tests.studies.test_scaling import RoomKind, make_round, run_rounds\n"
              "from pathlib import Path\n"
              "if __name__ == '__main__':\n"
              f"    round_ = make_round((RoomKind('chain', 4, 'reset'),), {agent!r}, {seed})\n"
              "    run_rounds(Path(sys.argv[1]), 4_000, round_,\n"
              "               checkpoint_seconds=0.0)\n")
    (tmp_path / "study.py").write_text(script)
    out, rng = tmp_path / "killed", np.random.default_rng(2)
    for _ in range(2):
        before = count_log_bytes(out)
        process = subprocess.Popen([sys.executable, str(tmp_path / "study.py"), str(out)],
                                   env=add_tests_to_path(), stderr=subprocess.DEVNULL)
        deadline = time.monotonic() + 600
        while process.poll() is None and count_log_bytes(out) == before and time.monotonic() < deadline:
            time.sleep(0.02)
        time.sleep(rng.uniform(0.0, 0.3))
        process.send_signal(signal.SIGKILL)
        process.wait()
    alone = run_rounds(tmp_path / "alone", 4_000, make_round((task,), agent, seed))
    assert forget_time(run_rounds(out, 4_000, make_round((task,), agent, seed))) == forget_time(alone)


def count_log_bytes(out: Path) -> int:
    return sum(log.stat().st_size for log in out.glob("*/log.jsonl"))


def add_tests_to_path() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}


PARTS = ("bar", "agents")


@pytest.fixture
def small_study(monkeypatch):
    for name, value in (("GRAPHS", ("chain",)), ("RULES", ("ignore",)), ("SIZES", (2, 4)), ("BAR_RUNS", 0),
                        ("AGENTS", ("smdp-r-max", "smdp-q-learning"))):
        monkeypatch.setattr(scaling, name, value)


@pytest.mark.nightly
def test_a_study_goes_on_where_it_was_stopped_and_tries_no_hopeless_rooms(tmp_path, small_study):
    def call(minutes=5.0):
        return forget_time(run_scaling(tmp_path, 1, 60, 1, minutes, parts=PARTS))

    first = call()
    assert [run.buttons for run in first] == [2, 2], "60 primitives are too few, so there is no run with 4 buttons"
    results = sorted(tmp_path.glob("*/result.json"))
    stamps = [path.stat().st_mtime_ns for path in results]
    results[0].unlink()
    assert call() == first
    assert results[1].stat().st_mtime_ns == stamps[1], "finished runs are kept"


@pytest.mark.nightly
def test_no_run_begins_after_the_time_is_up_and_finished_ones_count(tmp_path, small_study):
    assert run_scaling(tmp_path, 1, 60, 1, 0.0, parts=PARTS) == []
    finished = run_scaling(tmp_path, 1, 60, 1, 5.0, parts=PARTS)
    assert run_scaling(tmp_path, 1, 60, 1, 0.0, parts=PARTS) == finished


def test_a_failed_run_ends_the_study_with_its_message(tmp_path, small_study, monkeypatch):
    monkeypatch.setattr(scaling, "AGENTS", ("smdp-dreamer",))
    with pytest.raises(UnknownNameError, match="smdp-dreamer"):
        run_scaling(tmp_path, 1, 60, 1, 5.0, parts=PARTS)
    monkeypatch.undo()
    task = RoomKind("chain", 2, "ignore")
    round_ = make_round((task,), "smdp-r-max", 0)
    folder = get_run_folder(tmp_path, round_.rooms[task], round_.agents[0], 0)
    folder.mkdir(parents=True)
    (folder / "checkpoint.npz").write_bytes(b"no checkpoint")
    with pytest.raises(ComparisonError, match="smdp-r-max in RoomKind.*failed: .*checkpoint"):
        run_rounds(tmp_path, 60, round_)


def test_failures_count_where_they_were_not_tried_again():
    results = [make_result(), make_result(run=1, first=600, near=None), make_result(rule="reset"),
               make_result("random-options", first=None, near=None), make_result(buttons=20)]
    escapes = find(*results[1:]).scaling.escapes
    assert str(escapes["ignore", "smdp-factored-r-max", 10]) == "2 of 2; 500"
    assert str(escapes["ignore", "random-options", 20]) == "0 of 1; 20,000"
    assert ("ignore", "smdp-factored-r-max", 15) not in escapes
    assert find(*results[:0:-1]).scaling.escapes == escapes, "the order of lines does not matter"


@pytest.mark.nightly
def test_a_part_of_some_agents_joins_the_results_that_are_there(tmp_path, monkeypatch):
    """A repeated run takes the place of its line; all other lines stay."""
    for name, value in (("GRAPHS", ("chain",)), ("RULES", ("ignore",)), ("SIZES", (2,))):
        monkeypatch.setattr(scaling, name, value)
    kept = [dataclasses.replace(run, budget=60) for run in (make_result(buttons=20), make_result(GIVEN[1].label))]
    old = dataclasses.replace(make_result("smdp-r-max", 2, graph="chain"), budget=60, room="old")
    other = dataclasses.replace(old, agent="smdp-q-learning")
    save("scaling", [*kept, old, other], tmp_path)
    call = ["scaling", "--docs", str(tmp_path), "--out", str(tmp_path), "--runs", "1", "--workers", "1"]
    assert main([*call, "--primitives", "60", "--parts", "agents", "--agents", "smdp-r-max"]) == 0
    found = {run.place: run for run in load("scaling", tmp_path)}
    assert len(found) == 4 and all(found[run.place] == run for run in (*kept, other))
    assert found[old.place].room != "old" and found[old.place].budget == 60


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
    own = [make_result(first=first) for first in (100, 300, 500)]
    followed = follow_runs(own, 1, 1_000, lambda run: run.first_escape)
    assert followed is not None and followed.median == 300
    assert followed.restricted_mean == pytest.approx(100 + 0.75 * 200 + 0.5 * 200 + 0.25 * 500)
    assert str(followed) == "3 of 4; 475"
    hopeless = follow_runs(own[:1], 2, 1_000, lambda run: run.first_escape)
    assert hopeless is not None and hopeless.median is None
    assert follow_runs([], 0, 1_000, lambda run: run.first_escape) is None


def test_runs_spared_by_failures_are_told_from_those_not_begun():
    failed, escaped = make_result(buttons=6, first=None), make_result(buttons=6, run=1)
    results = [failed, escaped, make_result(buttons=4)]
    assert count_spared(results, "ignore", failed.agent, 10) == 1, "run 1 escaped: time stopped it"
    assert count_spared(results, "ignore", failed.agent, 6) == 0
    assert count_spared(results, "reset", failed.agent, 10) == 0


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
