"""Measure steps per second of batched rooms by batch size, eager and compiled, against others.

The others are the Bullet environment in Gymnasium's SyncVectorEnv, CartPole's own vector
environment and, if installed, XLand-MiniGrid and gymnax's CartPole. All take random actions; resets are included.
Repeats are interleaved and each contender's best counts. The memory bound is the rate of copying the bytes that a step
reads and writes: the limit with free arithmetic. The arithmetic bound is the best rate of the additional rooms of a
batch over the next smaller one: the limit with free calls and memory.

Examples:
    python -m benchmarks.batch
    python -m benchmarks.batch --scenes paper-two-button --sizes 8192 --threads 2
    python -m benchmarks.batch --sizes 1024 32768 1048576 --device cuda --plot batch.png
    python -m benchmarks.batch --velocities --no-peers
"""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from benchmarks.machine import describe_machine
from hrl_escape.cli import run_script
from hrl_escape.env.presets import PRESETS
from hrl_escape.errors import ConfigError, UnknownNameError

SCENES = ("paper-two-button", "ten-obstacles", "ten-obstacles-by-hand")


@dataclasses.dataclass(frozen=True)
class Args:
    """Options of the command line."""

    scenes: tuple[str, ...] = SCENES
    """Rooms to measure: presets, ten-obstacles (4 buttons among 10 yawed boxes), ten-obstacles-by-hand (3 joints)."""
    sizes: tuple[int, ...] = (64, 1024, 8192)
    """Rooms in a batch."""
    engines: tuple[str, ...] = ("eager", "compiled")
    """Ways to step the batch; compiling takes about 10 s for each scene and size."""
    instances: int = 1
    """Different instances in a batch."""
    observation: str = "features"
    """Observation of our environments."""
    device: str = "cpu"
    """Device of the batches: cpu, cuda, ..."""
    velocities: bool = False
    """Actions are velocities, each held for a tenth of a second, and no primitives."""
    threads: int = 0
    """Number of torch threads; 0 for its default, one a core."""
    repeats: int = 5
    """Number of measurements of each contender."""
    seconds: float = 0.3
    """Length of one measurement, s."""
    peers: bool = True
    """Measure the other environments too."""
    plot: Path | None = None
    """PNG, SVG or PDF file for a plot of steps per second by batch size."""
    json: bool = False
    """Print JSON instead of a table."""


def run(args: Args) -> None:
    """Measure and print."""
    for scene in args.scenes:
        if scene not in (*SCENES, *PRESETS):
            raise UnknownNameError("scene", scene, (*SCENES, *PRESETS))
    for engine in args.engines:
        if engine not in ("eager", "compiled"):
            raise UnknownNameError("engine", engine, ("eager", "compiled"))
    if args.repeats < 1 or not args.seconds > 0 or min((args.instances, *args.sizes)) < 1 or args.threads < 0:
        raise ConfigError("repeats, seconds, instances, sizes, threads",
                          (args.repeats, args.seconds, args.instances, args.sizes, args.threads),
                          "repeats, instances and sizes of at least 1, threads of at least 0, seconds above 0")
    from benchmarks import batch_contenders as contest  # heavy imports, which --help does without

    contest.set_threads(args.threads)
    contenders: list[contest.Contender] = []
    with Progress(console=Console(stderr=True), transient=True, disable=args.json) as progress:
        batch = contest.BatchSettings(args.instances, args.observation, args.device, args.velocities)
        makers = contest.list_makers(args.scenes, args.sizes, args.engines, args.peers, batch)
        task = progress.add_task("", total=len(makers) * (1 + args.repeats))
        for name, make in makers:
            progress.update(task, description=f"building {name}")
            contenders.append(make())
            progress.advance(task)
        for _ in range(args.repeats):
            for contender in contenders:
                progress.update(task, description=f"measuring {contender.name}, {contender.engine}")
                contender.measure(args.seconds)
                progress.advance(task)
    bandwidth = contest.measure_bandwidth(args.device)
    contest.set_arithmetic_bounds(contenders)
    rows = [contender.summarise(bandwidth) for contender in contenders]
    machine = describe_machine("torch") | contest.describe_torch(args.device)
    if args.plot:
        contest.draw(args.plot, rows)
    if args.json:
        settings = dataclasses.asdict(args) | {"plot": args.plot and str(args.plot)}
        print(json.dumps({"machine": machine, "settings": settings,
                          "bytes_per_second": bandwidth, "contenders": rows}, indent=2))
    else:
        _print(rows, bandwidth, machine)


def _print(rows: list[dict], bandwidth: float, machine: dict) -> None:
    table = Table(box=None, padding=(0, 2), pad_edge=False)
    for heading in ("environment", "engine"):
        table.add_column(heading, no_wrap=True)
    for heading in ("rooms", "steps/s", "a CPU-second", "us a step", "build s", "bytes a room", "memory bound", "of it",
                    "arithmetic", "of it"):
        table.add_column(heading, justify="right")
    for row in rows:
        bounds = [("", "") if row[f"{kind}_bound"] is None else
                  (f"{row[f'{kind}_bound']:,.0f}", f"{row[f'share_of_{kind}_bound']:.0%}")
                  for kind in ("memory", "arithmetic")]
        table.add_row(row["name"], row["engine"], f"{row['rooms']:,}", f"{row['steps_per_second']:,.0f}",
                      f"{row['steps_per_cpu_second']:,.0f}", f"{row['step_us']:,.0f}", f"{row['build_seconds']:.1f}",
                      f"{row['state_bytes']:,}" if row["state_bytes"] else "", *bounds[0], *bounds[1])
    table.caption = (f"random actions, resets included; {machine['threads']} threads on {machine['cores']} cores; "
                     f"memory copies at {bandwidth / 1e9:.1f} GB/s")
    Console(width=160).print(table)


if __name__ == "__main__":
    sys.exit(run_script(run))
