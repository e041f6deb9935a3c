"""Compile all kernels of the planners now, so that no first plan waits for them.

    hrl-escape warm

Plans escapes from a few rooms, one process a core. The compiled code stays in the cache of this version, in
`~/.cache/hrl_escape` (XDG_CACHE_HOME or NUMBA_CACHE_DIR moves it), and in the virtual environment. New caches begin
with those kernels. Kernels that the cache has already are loaded, which takes seconds.
"""

from __future__ import annotations

import dataclasses
import multiprocessing
import os
import time
from concurrent.futures import ProcessPoolExecutor
from typing import Any

from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError

WARMING: tuple[tuple[str, dict[str, Any]], ...] = (
    ("clutter", {}), ("arm-two-button", {}), ("paper-two-button", {"footprint": "rectangle"}))
"""Presets, and changes of their robots, whose escapes use every kernel of the planner."""


@dataclasses.dataclass(frozen=True)
class WarmArgs:
    """Options of `hrl-escape warm`."""

    jobs: int = 0
    """Number of processes; 0 for one a core, up to four."""


def run(args: WarmArgs) -> None:
    """Compile or load the kernels and print the time."""
    from hrl_escape.kernels import keep_in_installation  # loads numba

    if args.jobs < 0:
        raise ConfigError("jobs", args.jobs, "at least 0")
    began, jobs = time.perf_counter(), args.jobs or min(os.cpu_count() or 1, len(WARMING) + 1)
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        done = [pool.submit(_make_batch), *(pool.submit(_escape, *each) for each in WARMING)]
        for each in done:
            each.result()
    kept = ", also for new caches of this environment" if keep_in_installation() else ""
    print(f"kernels are ready after {time.perf_counter() - began:.0f} s{kept}")


def _make_batch() -> None:
    from hrl_escape.options.batched.env import BatchedOptionsEnv  # loads torch

    BatchedOptionsEnv(1, "clutter")


def _escape(preset: str, robot: dict[str, Any]) -> None:
    from hrl_escape.planning.planner import RoomPlanner

    config = get_preset(preset)
    config = dataclasses.replace(config, robot=dataclasses.replace(config.robot, **robot))
    planner = RoomPlanner(generate(config, 0))
    planner.solve(planner.rules.make_state(planner.instance.starts[0]))
