"""Runs cells on Ray: on a cluster whose machines share the comparison's folder, or on this machine.

A launcher like the local one (`launcher.py`); Ray is optional, the extra `ray` brings it. A cluster is found
through Ray's own RAY_ADDRESS.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hrl_escape.errors import MissingExtraError
from hrl_escape.experiments.grid import Cell
from hrl_escape.experiments.launcher import TICK_SECONDS, Listener, read_progress, report_outcome

__all__ = ["RayLauncher"]


@dataclass(frozen=True)
class RayLauncher:
    """Ray tasks of one core each, every cell in a process of its own.

    Attributes:
        workers: cores of a Ray that is started here; None for all. A cluster has its own.
        checkpoint_seconds: between checkpoints of a run: what a kill may cost.
    """

    workers: int | None = None
    checkpoint_seconds: float = 10.0

    def run(self, cells: Sequence[Cell], out: Path, listener: Listener) -> None:
        """Run them; on an interruption the tasks are cancelled, and can go on another time."""
        ray = _import_ray()
        is_ours = not ray.is_initialized()
        if is_ours and "RAY_ADDRESS" in os.environ:
            ray.init(log_to_driver=False)
        elif is_ours:
            ray.init(address="local", num_cpus=self.workers, include_dashboard=False, log_to_driver=False,
                     logging_level=logging.WARNING, _node_ip_address="127.0.0.1")
        task = ray.remote(num_cpus=1, max_retries=0, max_calls=1)(_run_guarded)
        pending = {task.remote(cell, out, self.checkpoint_seconds): cell for cell in cells}
        try:
            while pending:
                done, _ = ray.wait(list(pending), timeout=TICK_SECONDS)
                for reference in done:
                    report_outcome(out, pending.pop(reference), _get_exit_code(ray, reference), listener)
                progress = {cell.folder: read_progress(out, cell) for cell in pending.values()}
                listener.tick({folder: primitives for folder, primitives in progress.items() if primitives})
        finally:
            for reference in pending:
                ray.cancel(reference, force=True)
            if is_ours:
                ray.shutdown()


def _run_guarded(cell: Cell, out: Path, checkpoint_seconds: float) -> None:
    from hrl_escape.experiments.worker import run_guarded  # brings torch in, which only the task needs

    run_guarded(cell, out, checkpoint_seconds)


def _get_exit_code(ray: Any, reference: Any) -> int | None:
    try:
        ray.get(reference)
    except ray.exceptions.RayError:  # the task's process died; what the cell itself raised is in its folder
        return None
    return 0


def _import_ray() -> Any:
    try:
        import ray  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise MissingExtraError("ray", "ray", "running a comparison on Ray") from error
    return ray
