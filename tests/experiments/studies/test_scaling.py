"""The scaling study: which edges count, trials in real rooms, studies that go on, and pages made from raw results."""

import dataclasses

import pytest

from hrl_escape.cli import main
from hrl_escape.errors import FileReadError
from hrl_escape.experiments.studies import scaling
from hrl_escape.experiments.studies.scaling import (
    AGENTS,
    Trial,
    TrialResult,
    compare_graphs,
    find_edges_that_matter,
    load_results,
    run_trial,
    run_trials,
    save_results,
)
from hrl_escape.experiments.studies.scaling_page import write_scaling_page


def make_result(agent="smdp-factored-r-max", buttons=10, rule="ignore", run=0, graph="layered", first=400, near=900):
    structure = ((100, 0.5, 0.25), (800, 1.0, 1.0)) if agent != "smdp-random" else ()
    measured = {"best": 50.0, "worst": -1000.0, "primitives": 20_000, "decisions": 900, "seconds": 1.5}
    return TrialResult(graph, buttons, rule, agent, run, "abc", **measured, first_escape=first, near_best=near, edges=4,
                       structure=structure)


def test_an_edge_that_a_longer_way_implies_does_not_matter():
    assert find_edges_that_matter([(0, 1), (1, 2), (0, 2)], goal=2) == {(0, 1), (1, 2)}


def test_edges_to_what_the_goal_does_not_need_do_not_matter():
    assert find_edges_that_matter([(0, 1), (0, 3), (3, 4), (1, 2)], goal=2) == {(0, 1), (1, 2)}
    assert find_edges_that_matter([(0, 1)], goal=0) == set()


def test_a_believed_graph_may_have_cycles():
    found = find_edges_that_matter([(0, 1), (1, 0), (1, 2)], goal=2)
    assert found == {(0, 1), (1, 0), (1, 2)}


def test_precision_and_recall_of_edges():
    true = frozenset({(0, 1), (1, 2)})
    assert compare_graphs(frozenset({(0, 1), (0, 2), (5, 6), (7, 8)}), true) == (0.25, 0.5)
    assert compare_graphs(frozenset(), true) == (0.0, 0.0)
    assert compare_graphs(frozenset(), frozenset()) == (1.0, 1.0)


@pytest.mark.parametrize("rule", ["ignore", "reset"])
def test_factored_r_max_is_near_the_best_of_a_real_room_and_has_its_graph(rule):
    result = run_trial(Trial("chain", 4, rule, "smdp-factored-r-max", 0), primitives=4_000)
    assert result.first_escape is not None and result.near_best is not None
    assert result.first_escape <= result.near_best < result.primitives < 4_000, "it stops once nothing is left to note"
    assert result.edges == 3
    assert result.structure[-1][1:] == (1.0, 1.0)


@pytest.mark.parametrize("agent", AGENTS)
def test_every_agent_is_tried(agent):
    result = run_trial(Trial("chain", 2, "ignore", agent, 0), primitives=60)
    assert result.primitives >= 60 or result.first_escape is not None


def test_a_study_goes_on_where_it_was_stopped_and_tries_no_hopeless_rooms(tmp_path, monkeypatch):
    for name, value in (("GRAPHS", ("chain",)), ("RULES", ("ignore",)), ("SIZES", (2, 4)), ("BAR_RUNS", 0),
                        ("AGENTS", ("smdp-r-max", "smdp-q-learning"))):
        monkeypatch.setattr(scaling, name, value)
    heard = []

    def call():
        heard.clear()
        found = run_trials(tmp_path, 1, 60, 1, 5.0, lambda result, number, total: heard.append(result.trial))
        return {dataclasses.replace(result, seconds=0.0) for result in found}

    first = call()
    assert [trial.buttons for trial in heard] == [2, 2], "60 primitives are too few, so 4 buttons are not tried"
    (tmp_path / f"{heard[0].name}.json").unlink()
    assert call() == first and len(heard) == 1
    (tmp_path / f"{heard[0].name}.json").write_text('{"budget": 60, "result": {}}')
    with pytest.raises(FileReadError, match="damaged"):
        call()


def test_raw_results_come_back_and_the_page_tells_them(tmp_path):
    results = [make_result(), make_result(run=1, first=600, near=None), make_result(rule="reset"),
               make_result("smdp-random", first=None, near=None), make_result(buttons=20)]
    raw = tmp_path / "raw" / "scaling.csv"
    save_results(raw, results)
    assert set(load_results(raw)) == set(results)
    assert main(["experiment", "scaling", "--from-raw", "--docs", str(tmp_path)]) == 0
    page = (tmp_path / "scaling.md").read_text()
    assert "| ignore | smdp-factored-r-max | — | — | — | 2 of 2; 500 | — | 1 of 1; 400 |" in page
    assert "| ignore | smdp-factored-r-max | — | — | — | 1 of 2; 900 | — | 1 of 1; 900 |" in page
    assert page.count("| ignore | smdp-random | — | — | — | 0 of 1 | — | — |") == 1, "it learns nothing to evaluate"
    assert "| 20 buttons, layered, ignore | 1 | 1 | 400 | 1.000 (1.00) | 1.000 (1.00) | 1 of 1 |" in page
    for figure in ("scaling", "scaling-structure"):
        assert "<svg" in (tmp_path / "figures" / f"{figure}.svg").read_text()[:1_000]
    before = page, (tmp_path / "figures" / "scaling.svg").read_bytes()
    write_scaling_page(load_results(raw), tmp_path)
    assert ((tmp_path / "scaling.md").read_text(), (tmp_path / "figures" / "scaling.svg").read_bytes()) == before


@pytest.mark.parametrize("option", ["--runs=0", "--runs=-3", "--primitives=0", "--minutes=0"])
def test_a_study_of_nothing_is_refused_and_leaves_earlier_results_alone(tmp_path, capsys, option):
    raw = tmp_path / "raw" / "scaling.csv"
    save_results(raw, [make_result()])
    assert main(["experiment", "scaling", "--docs", str(tmp_path), "--out", str(tmp_path), option]) == 2
    assert "it must be above 0" in capsys.readouterr().err
    assert load_results(raw) == [make_result()]


def test_results_of_an_unknown_agent_are_refused(tmp_path):
    save_results(tmp_path / "scaling.csv", [make_result(), make_result("smdp-dreamer")])
    with pytest.raises(FileReadError, match="line 2.*smdp-dreamer"):
        load_results(tmp_path / "scaling.csv")


def test_no_trial_makes_no_page(tmp_path, capsys):
    save_results(tmp_path / "raw" / "scaling.csv", [])
    assert main(["experiment", "scaling", "--from-raw", "--docs", str(tmp_path)]) == 2
    assert "holds no trial" in capsys.readouterr().err
