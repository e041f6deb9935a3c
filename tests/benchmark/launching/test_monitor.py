"""The monitor's progress line: runs that have ended, with the primitives of those under way."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from hrl_escape import progress
from hrl_escape.benchmark.comparison import Monitor
from hrl_escape.benchmark.launching.local import Failure, read_progress
from tests.benchmark.made_up import compare


def test_the_line_counts_what_has_ended_and_the_primitives_of_what_runs(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(progress.LogDisplay, "seconds", 0.0)
    runs = compare({"dqn": [[90.0] * 4] * 6}).runs
    shown = io.StringIO()
    monitor = Monitor([run for run, _ in runs], Console(file=shown))
    monitor.keep(*runs[0])
    with monitor.watch():
        monitor.finish(*runs[1])
        monitor.fail(Failure(runs[2][0], "lost"))
        budget = runs[3][0].grid.primitives
        monitor.tick({runs[3][0].folder: budget // 2, runs[4][0].folder: 2 * budget})
        line = shown.getvalue().splitlines()[-1]
        assert f"{3.5 * budget:,.0f}/{5 * budget:,}" in line and "3 of 6 finished return" in line
        assert "success 100%" in line and "/s" in line and "left" in line


def test_a_run_that_has_not_begun_has_made_no_progress(tmp_path):
    (run, _), *_ = compare({"dqn": [[90.0] * 4]}).runs
    assert read_progress(tmp_path, run) == 0
