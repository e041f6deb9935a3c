"""Share of a core that the launching process needs on Ray, with short runs of the random policy.

python benchmarks/ray_driver.py --runs 200 --workers 2
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
import time
from pathlib import Path

from rich.console import Console

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.comparison import run_grid
from hrl_escape.benchmark.grid import Grid
from hrl_escape.benchmark.launching.clusters import RayLauncher
from hrl_escape.benchmark.launching.local import Listener


@dataclasses.dataclass(frozen=True)
class TimedLauncher:
    """Ray's launcher, with the seconds of launching and the processor's seconds of this process meanwhile."""

    ray: RayLauncher
    seconds: list[float]

    def run(self, runs: list, out: Path, listener: Listener) -> None:
        """Execute the runs."""
        started, used = time.perf_counter(), time.process_time()
        self.ray.run(runs, out, listener)
        self.seconds.extend((time.perf_counter() - started, time.process_time() - used))


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--primitives", type=int, default=2_000)
    arguments = parser.parse_args()
    grid = Grid("driver", agents=(AgentSpec("random"),), runs=arguments.runs, primitives=arguments.primitives,
                eval_every=arguments.primitives)
    launcher = TimedLauncher(RayLauncher(arguments.workers, resources={"max_calls": 1_000}), [])
    with tempfile.TemporaryDirectory() as folder, open("/dev/null", "w") as nowhere:
        comparison = run_grid(grid, folder, launcher, Console(file=nowhere))
    wall, used = launcher.seconds
    print(f"{len(comparison.runs)} runs finished, {len(comparison.failures)} failed, in {wall:.0f} s "
          f"({arguments.workers * wall / arguments.runs:.2f} s a run and worker); the launching process used "
          f"{used:.1f} s, {used / wall:.1%} of a core, {1000 * used / arguments.runs:.1f} ms a run")


if __name__ == "__main__":
    main()
