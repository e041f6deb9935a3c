"""Ray executes the same runs to the same numbers."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

import pytest

from hrl_escape.benchmark.comparison import Comparison
from hrl_escape.benchmark.launching.clusters import RayLauncher
from hrl_escape.errors import ConfigError
from tests.benchmark.small import break_checkpoint, change, run_quietly

pytest.importorskip("ray", reason="needs the extra ray")


@pytest.mark.slow
def test_ray_gives_the_results_of_local_processes(finished: Comparison, tmp_path: Path):
    one_seed = change(runs=1)
    comparison = run_quietly(one_seed, tmp_path, RayLauncher(2))
    assert not comparison.failures
    assert [result for _, result in comparison.runs] == [result for _, result in finished.runs[:4]]


@pytest.mark.slow
def test_a_failed_run_is_told_and_stops_no_others(tmp_path: Path):
    grid = change(runs=1, agents=["random", "dqn"], primitives=200)
    break_checkpoint(tmp_path, grid.make_runs(grid.make_places())[1])
    comparison = run_quietly(grid, tmp_path, RayLauncher(2))
    assert [run.agent.label for run, _ in comparison.runs] == ["random"]
    assert "damaged" in comparison.failures[0].message


def find_worker() -> int | None:
    """Process of a Ray task that a Ray of this process runs: a grandchild, by way of the raylet."""
    parents, titles = {}, {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parents[int(folder.name)] = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            titles[int(folder.name)] = (folder / "cmdline").read_text()
        except OSError:
            continue
    mine = (pid for pid, title in titles.items()
            if "_run_guarded" in title and parents.get(parents.get(pid, 0)) == os.getpid())
    return next(mine, None)


@pytest.mark.slow
def test_a_run_whose_worker_is_killed_is_made_again(tmp_path: Path):
    killed = []

    def kill() -> None:
        until = time.monotonic() + 600
        while time.monotonic() < until and not killed:
            if (worker := find_worker()) is not None:
                os.kill(worker, signal.SIGKILL)
                killed.append(worker)
            time.sleep(0.01)

    killer = threading.Thread(target=kill, daemon=True)  # Ray may not start at all
    killer.start()
    comparison = run_quietly(change(runs=1, agents=["q-learning"]), tmp_path, RayLauncher(1))
    killer.join()
    assert killed and len(comparison.runs) == 1 and not comparison.failures


def test_options_that_ray_does_not_know_are_refused(tmp_path: Path):
    with pytest.raises(ConfigError, match="options of ray.remote"):
        run_quietly(change(runs=1), tmp_path, RayLauncher(1, resources={"num_cpu": 2}))
