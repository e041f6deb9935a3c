"""The monitor's bar: how many runs have ended, with the shares of those under way."""

from __future__ import annotations

import io

from rich.console import Console

from hrl_escape.benchmark.comparison import Monitor
from hrl_escape.benchmark.launching.local import Failure, read_progress
from tests.benchmark.made_up import compare


def test_the_bar_counts_what_has_ended_and_the_shares_of_what_runs():
    runs = compare({"dqn": [[90.0] * 4] * 6}).runs
    monitor = Monitor([run for run, _ in runs], Console(file=io.StringIO(), force_terminal=True))
    monitor.keep(*runs[0])
    with monitor.watch():
        monitor.finish(*runs[1])
        monitor.fail(Failure(runs[2][0], "lost"))
        monitor.tick({runs[3][0].folder: runs[3][0].grid.primitives // 2})
        assert monitor._bar is not None
        (task,) = monitor._bar.tasks
        assert (task.completed, task.total) == (2.5, 5)


def test_a_run_that_has_not_begun_has_made_no_progress(tmp_path):
    (run, _), *_ = compare({"dqn": [[90.0] * 4]}).runs
    assert read_progress(tmp_path, run) == 0
