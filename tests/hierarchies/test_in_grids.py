"""Agents with synthesised hierarchies in comparisons: budgets, scores and words as for all others, privileges named."""

from __future__ import annotations

from pathlib import Path

import pytest

from hrl_escape.benchmark.summary import summarise
from hrl_escape.benchmark.verdict import write_verdict
from tests.benchmark.small import OneProcess, change, run_quietly


@pytest.mark.nightly
def test_a_comparison_runs_them_and_names_what_they_are_told(tmp_path: Path):
    grid = change(agents=("maxq-q+planned", "hamq+learned"), runs=1, primitives=100, eval_every=100)
    comparison = run_quietly(grid, tmp_path, OneProcess())
    assert not comparison.failures
    summary = summarise(comparison)
    planned, learned = summary.agents
    assert planned.success.value == 1.0 and planned.efficiency.value > 0.8 > learned.efficiency.value
    assert all(100 <= result.primitives <= 180 for _, result in summary.runs), "primitives count as for all"
    words = " ".join(sentence.text for sentence in write_verdict(summary))
    assert "`maxq-q+planned` (task graph, state, planner) and `hamq+learned` (program, state)" in words
    assert planned.efficiency.value == 1.0 or "its planned low level put out of reach" in words
