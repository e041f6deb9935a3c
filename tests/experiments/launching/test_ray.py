"""Ray executes the same runs to the same numbers."""

from __future__ import annotations

from pathlib import Path

import pytest
from rich.console import Console

from hrl_escape.experiments.comparison import Comparison, run_grid
from hrl_escape.experiments.launching.ray import RayLauncher
from tests.experiments.small import change

pytest.importorskip("ray", reason="needs the extra ray")


def test_ray_gives_the_results_of_local_processes(finished: Comparison, tmp_path: Path):
    one_seed = change(runs=1)
    with open("/dev/null", "w") as nowhere:
        comparison = run_grid(one_seed, tmp_path, RayLauncher(2), Console(file=nowhere))
    assert not comparison.failures
    assert [result for _, result in comparison.runs] == [result for _, result in finished.runs[:4]]


def test_a_failed_cell_is_told_and_stops_no_others(tmp_path: Path):
    grid = change(runs=1, agents=["random", "dqn"], primitives=200)
    runs = grid.make_runs(grid.make_places())
    broken = tmp_path / "runs" / runs[1].folder / "training" / "checkpoint.npz"
    broken.parent.mkdir(parents=True)
    broken.write_bytes(b"no checkpoint")
    with open("/dev/null", "w") as nowhere:
        comparison = run_grid(grid, tmp_path, RayLauncher(2), Console(file=nowhere))
    assert [run.agent.label for run, _ in comparison.runs] == ["random"]
    assert "damaged" in comparison.failures[0].message
