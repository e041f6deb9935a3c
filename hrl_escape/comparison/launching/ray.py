"""Launcher on Ray: on a cluster whose machines share the comparison's folder, or on this machine.

Ray is optional; the extra `ray` installs it. A cluster is found through Ray's own RAY_ADDRESS. The process that
launches does little: it hands Ray the grid once, keeps a bounded number of tasks queued, and takes all results that
are ready twice a second.
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
from pathlib import Path
from typing import Any

from hrl_escape.comparison.grid import Grid, GridRun
from hrl_escape.comparison.launching.local import TICK_SECONDS, Listener, read_progress, report_outcome
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
        ray = _import_ray()
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
                listener.tick({folder: primitives for folder, primitives in progress.items() if primitives}, cores)
                looked = time.monotonic()


def _list_fields(run: GridRun) -> dict[str, Any]:
    """Fields of a run beside its grid, which travels once."""
    return {field.name: getattr(run, field.name) for field in dataclasses.fields(run) if field.name != "grid"}


def _run_guarded(grid: Grid, fields: Mapping[str, Any], out: Path, checkpoint_seconds: float) -> dict[str, str] | None:
    from hrl_escape.comparison.launching.worker import run_guarded  # brings torch in, which only the task needs

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


def _import_ray() -> Any:
    try:
        import ray  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise MissingExtraError("ray", "ray", "running a comparison on Ray") from error
    return ray
