"""Launchers on clusters whose machines share the comparison's folder: Ray, and Slurm through submitit.

Both are optional (extras `ray` and `slurm`). Ray's cluster is found through its own RAY_ADDRESS, and without one Ray is
started on this machine; where there is no Slurm, submitit runs its jobs as processes of this machine. The process that
launches does little: it hands Ray the grid once, keeps a bounded number of tasks queued, and takes all results that are
ready twice a second; Slurm gets static parts of the runs as the jobs of an array.
"""

from __future__ import annotations

import dataclasses
import itertools
import logging
import os
import time
import traceback
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from hrl_escape.benchmark.grid import Grid, GridRun
from hrl_escape.benchmark.launching.local import (
    TICK_SECONDS,
    Failure,
    Listener,
    LocalLauncher,
    read_progress,
    report_outcome,
)
from hrl_escape.benchmark.runs import RunResult, load_run_result
from hrl_escape.errors import ConfigError, MissingExtraError

MOST_QUEUED = 1_000
"""Tasks that Ray knows of at a time: enough for a cluster to see what there is to do."""
PROGRESS_SECONDS = 5.0
"""Between looks at the logs of running runs."""


@dataclass(frozen=True)
class RayLauncher:
    """Ray tasks, by default of one core each, every run in a process of its own."""

    workers: int | None = None  # cores of a Ray that is started here; None for all. A cluster has its own.
    checkpoint_seconds: float = 10.0  # between checkpoints of a run, so the most that a kill costs
    resources: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """Options of `ray.remote` for each run, such as `num_cpus`, `num_gpus`, `memory` (bytes), `max_retries` (5: a run
    whose worker or node is lost goes on from its checkpoint elsewhere) and `max_calls` (1: runs in one process, one
    after another)."""

    def run(self, runs: Sequence[GridRun], out: Path, listener: Listener) -> None:
        """Execute runs of one grid; an interruption cancels the tasks, which can go on another time."""
        if not runs:
            return
        ray = _import_extra("ray", "ray", "running a comparison on Ray")
        try:
            task = ray.remote(**{"num_cpus": 1, "max_retries": 5, "max_calls": 1, **self.resources})(_run_guarded)
        except (ValueError, TypeError) as error:
            raise ConfigError("resources", dict(self.resources), f"options of ray.remote ({error})") from error
        is_ours = not ray.is_initialized()
        if is_ours and "RAY_ADDRESS" in os.environ:
            ray.init(log_to_driver=False)
        elif is_ours:
            ray.init(address="local", num_cpus=self.workers, include_dashboard=False, log_to_driver=False,
                     logging_level=logging.WARNING, _node_ip_address="127.0.0.1")
        pending: dict[Any, GridRun] = {}
        try:
            self._run_all(ray, task, runs, out, listener, pending)
        finally:
            for reference in pending:
                ray.cancel(reference, force=True)
            if is_ours:
                ray.shutdown()

    def _run_all(self, ray: Any, task: Any, runs: Sequence[GridRun], out: Path, listener: Listener,
                 pending: dict[Any, GridRun]) -> None:
        waiting, grid, looked = deque(runs), ray.put(runs[0].grid), 0.0
        while waiting or pending:
            while waiting and len(pending) < MOST_QUEUED:
                run = waiting.popleft()
                pending[task.remote(grid, _list_fields(run), out, self.checkpoint_seconds)] = run
            done, _ = ray.wait(list(pending), num_returns=len(pending), timeout=TICK_SECONDS)
            for reference in done:
                exit_code, error = _get_outcome(ray, reference)
                report_outcome(out, pending.pop(reference), exit_code, error, listener)
            if time.monotonic() - looked > PROGRESS_SECONDS:
                cores = max(1, int(ray.cluster_resources().get("CPU", 1)))  # a cluster may grow
                oldest = itertools.islice(pending.values(), cores)  # those behind them are queued
                progress = {run.folder: read_progress(out, run) for run in oldest}
                listener.tick({folder: primitives for folder, primitives in progress.items() if primitives})
                looked = time.monotonic()


def _list_fields(run: GridRun) -> dict[str, Any]:
    """Fields of a run beside its grid, which travels once."""
    return {field.name: getattr(run, field.name) for field in dataclasses.fields(run) if field.name != "grid"}


def _run_guarded(grid: Grid, fields: Mapping[str, Any], out: Path, checkpoint_seconds: float) -> dict[str, str] | None:
    from hrl_escape.benchmark.launching.worker import run_guarded  # brings torch in, which only the task needs

    return run_guarded(GridRun(grid, **fields), out, checkpoint_seconds)


def _get_outcome(ray: Any, reference: Any) -> tuple[int | None, dict[str, str] | None]:
    """Exit code of a task and the error that ended its run; no code where its process died for good."""
    try:
        return 0, ray.get(reference)
    except ray.exceptions.RayTaskError as error:  # raised before the run: that machine cannot import what it needs
        cause = "".join(traceback.format_exception_only(error.cause)).strip()
        return None, {"message": f"its task could not begin: {cause}", "traceback": str(error)}
    except ray.exceptions.RayError as error:
        return None, {"message": f"Ray lost its process, and retries of it: {str(error).strip().splitlines()[0]}",
                      "traceback": str(error)}


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
                listener.tick({})
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

    def tick(self, progress: Mapping[str, int]) -> None:
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
    return _import_extra("submitit", "slurm", "running a comparison on Slurm")


def _import_extra(package: str, extra: str, purpose: str) -> Any:
    try:
        return import_module(package)
    except ImportError as error:
        raise MissingExtraError(package, extra, purpose) from error
