"""Jobs of a Slurm array, run here by submitit's local executor, execute the same runs to the same numbers."""

from __future__ import annotations

from pathlib import Path

import pytest

from hrl_escape.benchmark.comparison import Comparison
from hrl_escape.benchmark.launching.clusters import SlurmLauncher
from hrl_escape.errors import ConfigError
from tests.benchmark.small import break_checkpoint, change, run_quietly

pytest.importorskip("submitit", reason="needs the extra slurm")


@pytest.mark.slow
def test_jobs_give_the_results_of_local_processes_and_tell_what_failed(finished: Comparison, tmp_path: Path):
    grid = change(runs=1)
    break_checkpoint(tmp_path, grid.make_runs(grid.make_places())[1])
    comparison = run_quietly(grid, tmp_path, SlurmLauncher(2))
    assert len(list((tmp_path / "slurm").glob("*_result.pkl"))) == 2, "two jobs"
    assert [failure.run.agent.label for failure in comparison.failures] == ["q-learning"]
    assert "damaged" in comparison.failures[0].message
    made = [result for _, result in comparison.runs]
    assert made == [finished.runs[number][1] for number in (0, 2, 3)]


def test_parameters_that_submitit_does_not_know_are_refused_before_anything_runs(tmp_path: Path):
    with pytest.raises(ConfigError, match="parameters of submitit"):
        run_quietly(change(runs=1), tmp_path, SlurmLauncher(2, resources={"slurm_partion": "long"}))
    assert not list((tmp_path / "runs").glob("*/run_result.json"))
    with pytest.raises(ConfigError, match="1 or more"):
        SlurmLauncher(0)
