"""References of rungs: what is published, and that measuring gives the same."""

from __future__ import annotations

import json

import pytest

from hrl_escape.benchmark.rung_references import load_references
from hrl_escape.cli import main
from hrl_escape.sets.benchmark import list_benchmarks, load_benchmark

MEASURED = [name for name in list_benchmarks() if load_references(name)]


@pytest.mark.parametrize("name", MEASURED)
def test_nobody_is_above_the_ceiling_and_the_planner_above_all(name: str):
    """Means over the same rooms: chance, the best baseline, who knows how rooms are drawn, who knows the graph."""
    known = load_references(name)
    assert list(known) == [rung.name for rung in load_benchmark(name) if rung.name in known]
    for rung, own in known.items():
        assert 0 <= own.random <= 1 and own.search <= own.oracle <= 1, rung
        if own.bayes is not None:
            assert own.search <= own.bayes + 0.03, f"{rung}: best in expectation, played in few rooms"
            assert own.bayes <= own.oracle, rung
        if own.told is not None and own.hidden is not None:
            assert -1e-9 <= own.told <= own.hidden, rung


def test_the_list_of_rungs_has_their_references(capsys: pytest.CaptureFixture[str]):
    assert main(["ladder", "list", "--benchmark", "ladder-2", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rungs"]
    assert {row["rung"]: row["references"]["search"] for row in rows if row["references"]} == {
        name: own.search for name, own in load_references("ladder-2").items()}
