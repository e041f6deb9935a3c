"""Launcher on Ray: on a cluster whose machines share the comparison's folder, or on this machine.

Ray is optional; the extra `ray` installs it. A cluster is found through Ray's own RAY_ADDRESS.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hrl_escape.errors import MissingExtraError
from hrl_escape.experiments.grid import GridRun
from hrl_escape.experiments.launching.local import TICK_SECONDS, Listener, read_progress, report_outcome

__all__ = ["RayLauncher"]


@dataclass(frozen=True)
class RayLauncher:
    """Ray tasks of one core each, every run in a process of its own.

    Attributes:
        workers: cores of a Ray that is started here; None for all. A cluster has its own.
        checkpoint_seconds: between checkpoints of a run, so the most that a kill costs.
    """

    workers: int | None = None
    checkpoint_seconds: float = 10.0

    def run(self, runs: Sequence[GridRun], out: Path, listener: Listener) -> None:
        """Execute the runs; an interruption cancels the tasks, which can go on another time."""
        ray = _import_ray()
        is_ours = not ray.is_initialized()
        if is_ours and "RAY_ADDRESS" in os.environ:
            ray.init(log_to_driver=False)
        elif is_ours:
            ray.init(address="local", num_cpus=self.workers, include_dashboard=False, log_to_driver=False,
                     logging_level=logging.WARNING, _node_ip_address="127.0.0.1")
        task = ray.remote(num_cpus=1, max_retries=0, max_calls=1)(_run_guarded)
        pending = {task.remote(run, out, self.checkpoint_seconds): run for run in runs}
        try:
            while pending:
                done, _ = ray.wait(list(pending), timeout=TICK_SECONDS)
                for reference in done:
                    exit_code, error = _get_outcome(ray, reference)
                    report_outcome(out, pending.pop(reference), exit_code, error, listener)
                progress = {run.folder: read_progress(out, run) for run in pending.values()}
                listener.tick({folder: primitives for folder, primitives in progress.items() if primitives})
        finally:
            for reference in pending:
                ray.cancel(reference, force=True)
            if is_ours:
                ray.shutdown()


def _run_guarded(run: GridRun, out: Path, checkpoint_seconds: float) -> dict[str, str] | None:
    from hrl_escape.experiments.launching.worker import run_guarded  # brings torch in, which only the task needs

    return run_guarded(run, out, checkpoint_seconds)


def _get_outcome(ray: Any, reference: Any) -> tuple[int | None, dict[str, str] | None]:
    """Exit code of a task and the error that ended its run; no code where its process died."""
    try:
        return 0, ray.get(reference)
    except ray.exceptions.RayError:
        return None, None


def _import_ray() -> Any:
    try:
        import ray  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise MissingExtraError("ray", "ray", "running a comparison on Ray") from error
    return ray
