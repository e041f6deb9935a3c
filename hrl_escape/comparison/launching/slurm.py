"""Launcher on Slurm: static parts of the runs as the jobs of an array, through submitit.

submitit is optional; the extra `slurm` installs it. Where there is no Slurm, submitit runs the jobs as processes of
this machine.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hrl_escape.comparison.grid import GridRun
from hrl_escape.comparison.launching.local import (
    TICK_SECONDS,
    Failure,
    Listener,
    LocalLauncher,
    report_outcome,
)
from hrl_escape.comparison.runs import RunResult, load_run_result
from hrl_escape.errors import ConfigError, MissingExtraError

Errors = dict[str, dict[str, str]]
"""Message and traceback of failed runs, by folder."""


@dataclass(frozen=True)
class SlurmLauncher:
    """Jobs of a Slurm array, each of which makes every n-th run in a folder that all machines share."""

    jobs: int  # number of jobs
    checkpoint_seconds: float = 10.0  # between checkpoints of a run, so the most that a kill costs
    resources: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """Parameters of submitit's `AutoExecutor` for each job, such as `timeout_min` (240), `mem_gb`, `cpus_per_task` (1:
    runs at a time), `slurm_partition` and `slurm_array_parallelism`."""

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise ConfigError("slurm", self.jobs, "the number of jobs, 1 or more")

    def run(self, runs: Sequence[GridRun], out: Path, listener: Listener) -> None:
        """Execute the runs; an interruption cancels the jobs, and the runs can go on another time."""
        if not runs:
            return
        executor = _import_submitit().AutoExecutor(folder=out / "slurm")
        asked = {"name": "hrl-escape", "timeout_min": 240, "cpus_per_task": 1, **self.resources}
        try:
            executor.update_parameters(**asked)
        except (NameError, AssertionError, TypeError, ValueError) as error:
            reason = " ".join(str(error).split())
            raise ConfigError("resources", dict(self.resources), f"parameters of submitit ({reason})") from error
        parts = [list(runs[number :: self.jobs]) for number in range(min(self.jobs, len(runs)))]
        part = _Part(out, asked["cpus_per_task"], self.checkpoint_seconds)
        pending = dict(zip(executor.map_array(part, parts), parts, strict=True))
        try:
            while pending:
                for job in [job for job in pending if job.done()]:
                    done = pending.pop(job)
                    errors = _get_errors(job, done, out)
                    for run in done:
                        report_outcome(out, run, None, errors.get(run.folder), listener)
                listener.tick({}, len(pending) * asked["cpus_per_task"])
                time.sleep(TICK_SECONDS)
        finally:
            for job in pending:
                job.cancel()


@dataclass(frozen=True)
class _Part:
    """Function of a job; a job that is preempted or out of time is queued again and goes on."""

    out: Path
    workers: int
    checkpoint_seconds: float

    def __call__(self, runs: Sequence[GridRun]) -> Errors:
        """Make those runs that are not finished."""
        listener = _Listener({})
        unfinished = [run for run in runs if load_run_result(self.out, run) is None]
        LocalLauncher(self.workers, self.checkpoint_seconds).run(unfinished, self.out, listener)
        return listener.errors

    def checkpoint(self, runs: Sequence[GridRun]) -> Any:
        """Submission that goes on."""
        return _import_submitit().helpers.DelayedSubmission(self, runs)


@dataclass(frozen=True)
class _Listener:
    """Keeps the errors of failed runs; results travel through files."""

    errors: Errors

    def finish(self, run: GridRun, result: RunResult) -> None:
        """Keep nothing: the run's folder holds its result."""

    def fail(self, failure: Failure) -> None:
        """Note the message and traceback under the run's folder."""
        self.errors[failure.run.folder] = {"message": failure.message, "traceback": failure.traceback}

    def tick(self, progress: Mapping[str, int], workers: int) -> None:
        """Show nothing: a job on a cluster has no terminal."""


def _get_errors(job: Any, runs: Sequence[GridRun], out: Path) -> Errors:
    """Errors of a job's runs; where the job itself was lost, that of each unfinished run."""
    lost = job.exception()
    if lost is None:
        return job.result()
    message = f"job {job.job_id} ended without its runs: {str(lost).strip().splitlines()[-1]}"
    return {run.folder: {"message": message, "traceback": str(lost)} for run in runs
            if load_run_result(out, run) is None}


def _import_submitit() -> Any:
    try:
        import submitit  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise MissingExtraError("submitit", "slurm", "running a comparison on Slurm") from error
    return submitit
