"""References of rungs: what is published, and that measuring gives the same."""

from __future__ import annotations

import json

import pytest

from benchmarks.references import measure_rung
from hrl_escape.benchmark.rung_references import load_references
from hrl_escape.cli import main
from hrl_escape.sets.benchmark import list_benchmarks, load_benchmark

MEASURED = [name for name in list_benchmarks() if load_references(name)]


@pytest.mark.parametrize("name", MEASURED)
def test_nobody_is_above_the_ceiling_and_the_planner_above_all(name: str):
    """Means over the same rooms: chance, the best searcher, who knows how rooms are drawn, who knows the graph."""
    known = load_references(name)
    assert list(known) == [rung.name for rung in load_benchmark(name) if rung.name in known]
    for rung, own in known.items():
        assert 0 <= own.random <= 1 and own.search <= own.oracle <= 1, rung
        if own.bayes is not None:
            assert own.search <= own.bayes + 0.03, f"{rung}: best in expectation, played in few rooms"
            assert own.bayes <= own.oracle, rung
        if own.told is not None and own.hidden is not None:
            assert -1e-9 <= own.told <= own.hidden, rung


def test_the_regularities_of_marks_3_tell_bits_and_their_control_none():
    known = load_references("marks-3")
    assert known["places"].told == known["places"].hidden == pytest.approx(6.907, abs=1e-3)  # log2 of 5!
    assert known["scattered"].told == 0 < known["deceived"].told < 6.9
    assert known["storeys"].told == pytest.approx(6.907 - 4.585, abs=0.01), "24 orders are left, all alike"


def test_the_list_of_rungs_has_their_references(capsys: pytest.CaptureFixture[str]):
    assert main(["ladder", "list", "--benchmark", "marks-3", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rungs"]
    assert {row["rung"]: row["references"]["search"] for row in rows} == {
        name: own.search for name, own in load_references("marks-3").items()}
    assert main(["ladder", "list", "--benchmark", "marks-3"]) == 0
    assert "6.9 of 6.9" in capsys.readouterr().out
    assert main(["ladder", "list", "--benchmark", "marks-1"]) == 0
    assert "bits told" not in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("rung", ["places", "scattered"])
def test_published_references_are_measured_again(rung: str):
    assert measure_rung(load_benchmark("marks-3")[rung], 64) == load_references("marks-3")[rung]
