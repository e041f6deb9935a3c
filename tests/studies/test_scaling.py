"""The scaling study: runs in real rooms, studies that go on, and pages made from raw results."""

import dataclasses
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from scipy import stats

from hrl_escape.benchmark.comparison import run_grid
from hrl_escape.benchmark.launching.local import LocalLauncher
from hrl_escape.errors import ComparisonError, RunBusyError, UnknownNameError
from hrl_escape.processes import take_lock
from studies.__main__ import main
from studies.scaling import rounds as scaling
from studies.scaling.difficulty import compute_rank_correlations, tell_difficulty
from studies.scaling.findings import advise_sizes, tell_certainty, tell_replication, tell_sizes
from studies.scaling.followed_runs import count_spared, follow_runs, list_bins
from studies.scaling.results import (
    RoomKind,
    ScalingRun,
    collect_scaling_runs,
)
from studies.scaling.rounds import (
    AGENTS,
    SIZES,
    TOLD,
    TOLD_TASKS,
    Round,
    choose_options,
    make_room,
    run_scaling,
)
from studies.scaling.told import HOLDS, advise_told, compute_told_costs, tell_told, tell_too_few
from studies.store import Store
from studies.study import find_study
from tests.benchmark.small import break_checkpoint
from tests.studies.pages import load, save, tell


def make_result(agent="smdp-factored-r-max", buttons=10, rule="ignore", run=0, graph="layered", first=400, near=900):
    structure = ((100, 0.5, 0.25), (800, 1.0, 1.0)) if agent != "random-options" else ()
    measured = {"best": 50.0, "worst": -1000.0, "budget": 20_000, "primitives": 20_000, "decisions": 900,
                "seconds": 1.5}
    return ScalingRun(graph, buttons, rule, agent, run, "abc", **measured, first_escape=first, near_best=near, edges=4,
                      depth=3, structure=structure)


def make_round(tasks: tuple[RoomKind, ...], agent: str, seed: int) -> Round:
    return Round(tasks, (choose_options(agent),), seed)


def make_console() -> Console:
    return Console(quiet=True)


def run_rounds(out: Path, primitives: int, *rounds: Round, **launcher: Any) -> list[ScalingRun]:
    found = []
    started = LocalLauncher(**launcher)
    for round_ in rounds:
        comparison = run_grid(round_.make_grid(primitives), out, started, make_console())
        assert not comparison.failures, comparison.failures[0].message
        found += collect_scaling_runs(comparison, round_.rooms)
    return found


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
    return sum(log.stat().st_size for log in out.glob("runs/*/training/log.jsonl"))


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
        return forget_time(run_scaling(tmp_path, 1, 60, 1, minutes, make_console(), parts=PARTS))

    first = call()
    assert [run.buttons for run in first] == [2, 2], "60 primitives are too few, so there is no run with 4 buttons"
    results = sorted(tmp_path.glob("runs/*/run_result.json"))
    stamps = [path.stat().st_mtime_ns for path in results]
    results[0].unlink()
    assert call() == first
    assert results[1].stat().st_mtime_ns == stamps[1], "finished runs are kept"


@pytest.mark.nightly
def test_no_run_begins_after_the_time_is_up_and_finished_ones_count(tmp_path, small_study):
    assert run_scaling(tmp_path, 1, 60, 1, 0.0, make_console(), parts=PARTS) == []
    finished = run_scaling(tmp_path, 1, 60, 1, 5.0, make_console(), parts=PARTS)
    assert run_scaling(tmp_path, 1, 60, 1, 0.0, make_console(), parts=PARTS) == finished


def test_a_failed_run_ends_the_study_with_its_message(tmp_path, small_study, monkeypatch):
    monkeypatch.setattr(scaling, "AGENTS", ("smdp-dreamer",))
    with pytest.raises(Exception, match="smdp-dreamer"):
        run_scaling(tmp_path, 1, 60, 1, 5.0, make_console(), parts=PARTS)
    monkeypatch.undo()
    round_ = make_round((RoomKind("chain", 2, "ignore"),), "smdp-r-max", 0)
    (run,) = round_.make_grid(60).make_runs(round_.make_grid(60).make_places())
    break_checkpoint(tmp_path, run)
    monkeypatch.setattr(scaling, "BAR_RUNS", 1)
    monkeypatch.setattr(scaling, "BAR", (RoomKind("chain", 2, "ignore"),))
    monkeypatch.setattr(scaling, "BAR_AGENT", "smdp-r-max")
    with pytest.raises(ComparisonError, match="1 runs of scaling--smdp-r-max--0 failed.*checkpoint"):
        run_scaling(tmp_path, 0, 60, 1, 5.0, make_console(), parts=PARTS)


def test_one_study_at_a_time_in_a_folder(tmp_path):
    with open(tmp_path / "lock", "wb") as lock:
        assert take_lock(lock)
        with pytest.raises(RunBusyError, match="another comparison is running in this folder"):
            run_scaling(tmp_path, 1, 60, 1, 5.0, make_console(), parts=PARTS)


@pytest.mark.nightly
def test_raw_results_come_back_and_the_page_tells_them(tmp_path):
    results = [make_result(), make_result(run=1, first=600, near=None), make_result(rule="reset"),
               make_result("random-options", first=None, near=None), make_result(buttons=20)]
    save("scaling", results, tmp_path)
    assert load("scaling", tmp_path) == results
    assert main(["scaling", "--from-raw", "--docs", str(tmp_path)]) == 0
    page = (tmp_path / "scaling.md").read_text()
    assert "| ignore | smdp-factored-r-max | — | — | — | 2 of 2; 500 | — | 1 of 1; 400 |" in page
    assert "| ignore | smdp-factored-r-max | — | — | — | 1 of 2; 10,450 | — | 1 of 1; 900 |" in page
    failed = "0 of 1; 20,000"
    assert page.count(f"| ignore | random-options | — | — | — | {failed} | {failed} | {failed} |") == 1, \
        "failures count where they were not tried again, and it learns nothing to evaluate"
    assert "| 20 buttons, layered, ignore | 1 | 1 | 400 | 1.000 (1.00) | 1.000 (1.00) | 1 of 1 |" in page
    for figure in ("scaling", "scaling-structure"):
        assert "<svg" in (tmp_path / "figures" / f"{figure}.svg").read_text()[:1_000]
    before = page, (tmp_path / "figures" / "scaling.svg").read_bytes()
    assert (tell("scaling", results[::-1], tmp_path), (tmp_path / "figures" / "scaling.svg").read_bytes()) == before


@pytest.mark.nightly
def test_a_part_of_some_agents_joins_the_results_that_are_there(tmp_path, monkeypatch):
    """A run that was made again takes its line's place; all other lines stay, and what they tell stays on the page."""
    for name, value in (("GRAPHS", ("chain",)), ("RULES", ("ignore",)), ("SIZES", (2,))):
        monkeypatch.setattr(scaling, name, value)
    kept = [dataclasses.replace(run, budget=60) for run in (make_result(buttons=20), make_result(TOLD[1].label))]
    old = dataclasses.replace(make_result("smdp-r-max", 2, graph="chain"), budget=60, room="old")
    other = dataclasses.replace(old, agent="smdp-q-learning")
    save("scaling", [*kept, old, other], tmp_path)
    call = ["scaling", "--docs", str(tmp_path), "--out", str(tmp_path), "--runs", "1", "--workers", "1"]
    assert main([*call, "--primitives", "60", "--parts", "agents", "--agents", "smdp-r-max"]) == 0
    found = {run.place: run for run in load("scaling", tmp_path)}
    assert len(found) == 4 and all(found[run.place] == run for run in (*kept, other))
    assert found[old.place].room != "old" and found[old.place].budget == 60
    assert "| ignore | all-on, 2 | 1 | 1 | 1 | 1 | 60 | 60 |" in (tmp_path / "scaling.md").read_text()


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


@pytest.mark.nightly_for("1-commands0")
@pytest.mark.parametrize(("told_runs", "commands"), [
    (1, ["python -m studies scaling --runs 1 --primitives 20000"]),
    (3, ["python -m studies scaling --parts bar agents --runs 1 --primitives 20000",
         "python -m studies scaling --parts told --runs 3 --primitives 20000"]),
])
def test_the_page_ends_with_commands_that_make_its_runs_again(told_runs, commands):
    told = [make_result(spec.label, run=run) for spec in TOLD for run in range(told_runs)]
    page = tell("scaling", [make_result(buttons=4), make_result(rule="reset", run=9), *told])
    assert page.endswith("\n".join(["```console", *commands, "```", ""]))


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


def test_bins_cover_all_rooms_once():
    results = [dataclasses.replace(make_result(run=run), edges=edges, depth=1)
               for run, edges in enumerate((1, 1, 2, 3, 5, 8, 13))]
    bins = list_bins(results, "edges")
    assert bins == [(1, 1), (2, 4), (5, 7), (8, 13)]
    assert list_bins(results[:2], "edges") == [(1, 1)] == list_bins(results, "depth")


def make_rooms(read):
    """Rooms of all sizes in which edges and depth go their own ways; the first escape follows one of the measures."""
    rooms = [(buttons, edges, depth) for buttons in SIZES for edges in (1, 9, 4) for depth in (3, 1)]
    return [dataclasses.replace(make_result(agent, buttons, run=run, first=100 + 50 * read(buttons, edges, depth)),
                                edges=edges, depth=depth)
            for agent in AGENTS[:3] for run, (buttons, edges, depth) in enumerate(rooms)]


@pytest.mark.parametrize(("read", "said"), [
    (lambda buttons, edges, depth: edges, "Edges that matter order rooms best"),
    (lambda buttons, edges, depth: depth, "Depth orders rooms best"),
    (lambda buttons, edges, depth: buttons, "Buttons order rooms best"),
    (lambda buttons, edges, depth: SIZES.index(buttons) + 2 * (1, 4, 9).index(edges),
     "Buttons order rooms better than depth and edges that matter order rooms better than depth by"),
    (lambda buttons, edges, depth: (7 * buttons + 3 * edges + 5 * depth) % 11,
     "No measure is shown to order rooms better than another"),
])
def test_what_makes_rooms_difficult_is_read_off_the_runs(read, said):
    sentence, = tell_difficulty(make_rooms(read), np.random.default_rng(0))
    assert said in sentence


def test_rank_correlations_are_spearmans_averaged_over_agents_and_rules():
    rooms = [run for run in make_rooms(lambda buttons, edges, depth: buttons * edges + depth) if run.agent == AGENTS[0]]
    rooms += [dataclasses.replace(run, rule="reset", first_escape=None if run.edges == 9 else run.buttons)
              for run in rooms]
    found = compute_rank_correlations(rooms)
    for measure, read in (("buttons", lambda run: run.buttons), ("edges that matter", lambda run: run.edges)):
        expected = [stats.spearmanr([read(run) for run in own], [run.first_escape or run.budget for run in own])[0]
                    for own in (rooms[:36], rooms[36:])]
        assert found[measure] == pytest.approx(np.mean(expected))


def test_sizes_that_all_runs_master_are_told_agent_by_agent():
    results = [make_result(AGENTS[0], buttons) for buttons in SIZES]
    results += [make_result(AGENTS[2], buttons, first=None if buttons == 6 else 400) for buttons in (2, 4, 6)]
    results += [make_result(AGENTS[3], 2, first=None), make_result(AGENTS[4], 2)]
    assert tell_sizes(results) == [
        "With the ignore rule all planned runs escape up to 20 buttons for `factored-r-max`; up to 4 buttons for "
        "`r-max`; up to 2 buttons for `dqn` (not tried with more); with no number of buttons for `q-learning`."]
    assert advise_sizes(results).startswith("For many buttons take `factored-r-max`, which comes furthest whatever the")
    hard = [*results, *(make_result(AGENTS[0], buttons, rule="reset", first=None if buttons > 2 else 400)
                        for buttons in SIZES)]
    assert "take `r-max`, which comes furthest whatever the rule, up to 4 buttons" in advise_sizes(hard)
    assert "Begin with fewer buttons" in advise_sizes(results[-2:-1])


@pytest.mark.parametrize(("escapes", "said"), [
    (3, "up to 15 buttons; the lead is not told apart: with 15 buttons under `ignore` 4 of 4 runs of `factored-r-max` "
        "escape, 3 of 4 of `r-max`."),
    (0, "up to 15 buttons."),
])
def test_a_lead_of_a_run_is_not_called_one(escapes: int, said: str):
    """By Fisher's test 4 of 4 are told from 0 of 4 (p = 0.029), and not from 3 of 4 (p = 1)."""
    first = [make_result(AGENTS[0], buttons, run=run) for buttons in SIZES[:-1] for run in range(4)]
    second = [make_result("smdp-r-max", buttons, run=run, first=400 if buttons < 15 or run < escapes else None)
              for buttons in SIZES[:-1] for run in range(4)]
    assert advise_sizes([*first, *second]).endswith(said), advise_sizes([*first, *second])


def test_few_runs_that_all_escape_leave_much_open():
    runs = [make_result(run=run) for run in range(4)] + [make_result(buttons=6, run=run) for run in range(10)]
    low = [stats.binomtest(count, count).proportion_ci(0.95, "exact").low for count in (4, 10)]
    assert tell_certainty(runs) == (
        f"Where all runs of a cell escape, the share that would is {low[0]:.2f} or more with 4 runs and {low[1]:.2f} "
        "or more with 10 runs (Clopper and Pearson).")
    assert tell_certainty([make_result(first=None)]) == ""


def test_what_structure_learners_are_told_is_what_the_labels_say():
    assert len({spec.label for spec in TOLD}) == len(TOLD) == 8
    for spec in TOLD:
        settings = spec.resolve_settings()
        assert spec.label == f"{settings['conditions']}, {settings['max_parents']}"
    noisy, exact = make_room(TOLD_TASKS[1]), make_room(TOLD_TASKS[0])
    assert (noisy.dynamics.noise, noisy.dynamics.slip) == (0.1, 0.1)
    assert dataclasses.replace(noisy, name=exact.name, dynamics=exact.dynamics) == exact


@pytest.mark.nightly
def test_the_page_says_what_being_told_less_costs_and_what_fresh_seeds_give(tmp_path):
    told = make_told({label: 900 for label in LABELS} | {"all-on, 1": None, "any, 1": None})
    bar = [make_result(run=run, rule="reset") for run in range(10)]
    failed = [dataclasses.replace(run, run=run.run + 100, near_best=None) for run in bar]
    with pytest.raises(ComparisonError, match="with the part agents"):
        tell("scaling", told)
    save("scaling", [*told, *bar, *failed], tmp_path)
    assert main(["scaling", "--from-raw", "--docs", str(tmp_path)]) == 0
    page = (tmp_path / "scaling.md").read_text()
    assert "<summary>What structure learners are told</summary>" in page and "(seeds 100 to 109)" in page


LABELS = [spec.label for spec in TOLD]


def make_told(waits, runs=10, rule="ignore"):
    """Runs of the labels that are near the best with the whole graph after so many primitives, or never."""
    exact, part = ((800, 1.0, 1.0),), ((100, 1.0, 0.5),)
    return [dataclasses.replace(
        make_result(label, run=run, rule=rule, near=wait), primitives=20_000 if wait is None else wait,
        structure=part if wait is None else exact) for label, wait in waits.items() for run in range(runs)]


def test_being_told_less_costs_what_the_runs_show():
    """By hand: 20,000 in place of 900 is 19,100 more; the signs of ten pairs have p = 2 / 1,024, times 7 by Holm."""
    told = make_told({label: 900 for label in LABELS} | {"all-on, 1": None, "any, 4": 700})
    told = [dataclasses.replace(run, primitives=600 + 100 * (run.run % 7)) if run.agent == "all-on, 3" else run
            for run in told]
    sentence, power = tell_told(told)
    assert power.startswith("A study of this size has 80 % power to detect a difference of "), "one varies"
    assert advise_told(told) == "Tell `factored-r-max` `any, 4`, which is shown to help beyond what holds."
    slow = make_told({label: 900 for label in LABELS} | {"all-on, 1": None})
    assert advise_told(slow) == ("Tell `factored-r-max` what holds and nothing else: told `all-on, 1` it takes longer.")
    assert "is not shown to change how long it takes." in advise_told(make_told({label: 900 for label in LABELS}))
    assert "all runs have the whole graph told `all-on, 2`, `all-on, 3`, `all-on, 4`, `any, 1`, `any, 2`, `any, 3` " \
        "or `any, 4`; not all do told `all-on, 1` (0 of 10)." in sentence
    assert "it takes more primitives told `all-on, 1` (19,100, 19,100 to 19,100, in 10 of 10 pairs); it takes " \
        "fewer primitives told " \
        "`any, 4` (200, 200 to 200, in 10 of 10 pairs); no difference is " \
        "shown told `all-on, 3`, `all-on, 4`, `any, 1`, `any, 2` " \
        "or `any, 3`." in sentence
    costs = {cost.label: cost for cost in compute_told_costs(told)}
    assert HOLDS not in costs and costs["all-on, 1"].p == pytest.approx(7 * 2 / 2**10) == costs["any, 4"].p
    own = [run.primitives - 900 for run in told if run.agent == "all-on, 3"]
    assert costs["all-on, 3"].more == pytest.approx(np.mean(own)) and costs["all-on, 3"].p == 1
    everywhere = [dataclasses.replace(run, rule=task.rule) for task in TOLD_TASKS for run in told]
    shown = [cost.p for cost in compute_told_costs(everywhere) if cost.is_shown]
    assert shown == pytest.approx(6 * [21 * 2 / 2**10])


def test_too_few_parents_are_called_the_worst_only_where_they_are():
    few = {"all-on, 1": None, "any, 1": None}
    told = make_told({label: 900 for label in LABELS} | few)
    told = [dataclasses.replace(run, structure=((800, 1.0, 1.0),)) if run.run < 3 and run.agent in few else run
            for run in told]
    sentence = ("Too few parents are the worst to be told: with `all-on, 1` or `any, 1` it finds the whole graph in at "
                "most 3 of 10 runs, with the others in at least 10 of 10.")
    assert tell_too_few(told) == sentence and advise_told(told).endswith(f" it takes longer. {sentence}")
    assert tell_too_few(make_told({label: 900 for label in LABELS} | few | {"any, 4": None})) == "", "as bad as they"
    assert tell_too_few(make_told({label: 900 for label in LABELS})) == ""
    assert tell_too_few(make_told({label: 900 for label in LABELS} | few, runs=9)) == ""


def test_nothing_is_concluded_of_fewer_than_ten_runs_or_without_what_holds():
    told = make_told({label: 900 for label in LABELS} | {"all-on, 1": None}, runs=9, rule="reset")
    assert tell_told(told) == ["Rule reset: nothing is concluded from 9 runs of a label."]
    assert {cost.p for cost in compute_told_costs(told)} == {1.0}
    sentence, = tell_told(make_told({"all-on, 1": None, "any, 1": None}))
    assert "told nothing here all runs have the whole graph (`all-on, 1` (0 of 10) and `any, 1` (0 of 10))." in sentence
    assert f"None was told `{HOLDS}`" in sentence


def test_fresh_seeds_are_held_against_the_published_ones_by_fishers_test():
    """Of 10 and 10 runs, 10 against 5 has p = 0.033, twice that by Holm where the bar has two rooms; 10 against 4 has
    0.011 and 0.022."""
    def make_bar(near, runs=10, first=0):
        return [make_result(run=first + run, rule="reset", near=900 if run < near else None) for run in range(runs)]

    def make_twenty():
        return [make_result(buttons=20, run=run) for run in range(10)]

    assert "which does not differ significantly from the published 10 of 10" in \
        tell_replication(make_bar(10), make_bar(10))[0]
    assert "5 of 10 reach 95% of the best return (seeds 100 to 109), fewer than the published 10 of 10" in \
        tell_replication(make_bar(5, first=100), make_bar(10))[0]
    for near, said in ((5, "which does not differ significantly from"), (4, "fewer than")):
        first, second = tell_replication([*make_bar(near), *make_twenty()], [*make_bar(10), *make_twenty()])
        assert "which does not differ significantly from" in first and said in second
    assert "10 of 10 reach" in (sentence := tell_replication(make_bar(10), make_bar(4))[0])
    assert "more than the published 4 of 10" in sentence
    assert "too few runs to compare with" in tell_replication(make_bar(0, runs=9), make_bar(10))[0]


@pytest.mark.parametrize("option", ["--runs=0", "--runs=-3", "--primitives=0", "--minutes=0"])
def test_a_study_of_nothing_is_refused_and_leaves_earlier_results_alone(tmp_path, capsys, option):
    save("scaling", [make_result()], tmp_path)
    assert main(["scaling", "--docs", str(tmp_path), "--out", str(tmp_path), option]) == 2
    assert "it must be above 0" in capsys.readouterr().err
    assert load("scaling", tmp_path) == [make_result()]


def test_results_of_an_unknown_agent_are_refused():
    with pytest.raises(UnknownNameError, match="smdp-dreamer"):
        tell("scaling", [make_result(), make_result("smdp-dreamer")])
