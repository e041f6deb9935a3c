"""The monitor's table: who has finished, and how long the rest takes on all workers."""

import dataclasses
import io

from rich.console import Console

from hrl_escape.comparison.comparison import Monitor
from hrl_escape.comparison.launching.local import Failure, read_progress
from tests.comparison.made_up import compare


def test_time_left_counts_all_workers_of_a_cluster_and_runs_that_are_under_way():
    comparison = compare({"dqn": [[90.0] * 4] * 6, "sarsa": [[-100.0] * 4] * 2})
    runs = [run for run, _ in comparison.runs]
    text = io.StringIO()
    monitor = Monitor(runs, Console(file=text, width=100))
    for run, result in comparison.runs[:2]:
        monitor.finish(run, dataclasses.replace(result, seconds=(0.0, 600.0)))
    monitor.fail(Failure(runs[2], "lost"))
    half = runs[3].grid.primitives // 2
    monitor.tick({runs[3].folder: half}, workers=3)
    text.truncate(0)
    monitor.console.print(monitor._draw())
    shown = text.getvalue()
    assert "2/6, 1 failed" in shown and "50%" in shown and "3 of 8 runs" in shown
    assert "about 15 min left" in shown, "4.5 runs of 10 minutes on 3 workers"


def test_a_run_that_has_not_begun_has_made_no_progress(tmp_path):
    (run, _), *_ = compare({"dqn": [[90.0] * 4]}).runs
    assert read_progress(tmp_path, run) == 0
