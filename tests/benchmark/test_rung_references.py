"""References of rungs: what is published, and that measuring gives the same."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hrl_escape.benchmark.rung_references import load_references
from hrl_escape.benchmark.standings import LEAST_HEADROOM
from hrl_escape.cli import main
from hrl_escape.sets.benchmark import list_benchmarks, load_benchmark

DOCS = Path(__file__).parents[2] / "docs"
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


def test_the_page_of_the_ladder_has_the_references_of_each_axis():
    known, text = load_references("ladder-2"), (DOCS / "ladder.md").read_text(encoding="utf-8")
    for axis in load_benchmark("ladder-2").manifest.axes:
        (line,) = [line for line in text.splitlines() if line.startswith(f"| `{axis.name}` |") and line.count("|") == 5]
        *_, gaps, normalised, _ = line.split(" | ") + [""]
        own = [known[rung] for rung in axis.rungs]
        assert gaps == ", ".join("-" if each.bayes is None else f"{round(each.bayes - each.search, 2) + 0:.2f}"
                                 for each in own), axis.name
        wide = [f"`{rung}`" for rung in axis.rungs if (gap := known[rung].headroom) and gap[1] > LEAST_HEADROOM]
        assert normalised.removesuffix(" |") == (", ".join(wide) or "none"), axis.name


def test_the_list_of_rungs_has_their_references(capsys: pytest.CaptureFixture[str]):
    assert main(["ladder", "list", "--benchmark", "ladder-2", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rungs"]
    assert {row["rung"]: row["references"]["search"] for row in rows if row["references"]} == {
        name: own.search for name, own in load_references("ladder-2").items()}
