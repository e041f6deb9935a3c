"""Run agents on rungs under a protocol, and report each rung: the same comparison as `hrl-escape compare`.

per-instance learns each test room from nothing; generalise learns in training rooms and is tested in others; transfer
learns in training rooms of one rung and is tested, without learning, in rooms of another.
Finished runs are kept: the same command goes on where it was stopped. `hrl-escape ladder report` sums up the rungs.

Examples:
    hrl-escape ladder run smdp-dqn smdp-random planner --rung doormat pair --protocol per-instance --runs 3
    hrl-escape ladder run smdp-ppo+objects+memory smdp-random --rung lattice --protocol generalise --train-sizes 1 16 64
    hrl-escape ladder run smdp-dqn+objects+memory smdp-random planner --protocol transfer --from chain --rung lattice-5
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from hrl_escape.experiments.comparison import Shard, run_grid
from hrl_escape.experiments.grid import AgentSpec
from hrl_escape.experiments.launching.local import LocalLauncher
from hrl_escape.experiments.protocols import LadderSettings, Protocol, make_protocol_grid, name_protocol
from hrl_escape.experiments.reporting.report import write_report
from hrl_escape.ladder.benchmark import load_benchmark


@dataclasses.dataclass(frozen=True)
class RunArgs:
    """Options of `hrl-escape ladder run`."""

    agents: Annotated[tuple[str, ...], tyro.conf.Positional]
    """Agents, as for `hrl-escape compare`: smdp-dqn, smdp-ppo+objects+memory, planner."""
    rung: tuple[str, ...]
    """Names of rungs."""
    protocol: Protocol = "per-instance"
    """per-instance, generalise or transfer."""
    source: Annotated[str | None, tyro.conf.arg(name="from")] = None
    """Rung to train on with transfer."""
    benchmark: str = "ladder-1"
    """Benchmark that comes with the package, or a manifest file."""
    runs: int = LadderSettings().runs
    """Training seeds in each room or set."""
    primitives: int | None = None
    """Training budget of a run; the rung's own by default."""
    rooms: int | None = None
    """Rooms of the test set; 10 with per-instance and else all by default."""
    train_sizes: tuple[int, ...] = LadderSettings().train_sizes
    """Numbers of training rooms with generalise and transfer."""
    eval_episodes: int | None = None
    """Episodes in an evaluation; 20 with per-instance, and else one in each test room, by default."""
    observation: str = LadderSettings().observation
    """Observation of all agents."""
    out: Path = Path("runs/ladder")
    """Folder of all rungs and protocols."""
    workers: int | None = None
    """Runs at a time; one a core by default."""
    shard: str = "1/1"
    """Part of each rung's runs to make, such as 2/8."""


def run(args: RunArgs) -> int:
    """Run rung by rung; the exit code is 1 if runs failed."""
    bench = load_benchmark(args.benchmark)
    settings = LadderSettings(args.runs, args.primitives, args.rooms, args.train_sizes, args.eval_episodes,
                              args.observation, args.source)
    agents, shard = tuple(map(AgentSpec.parse, args.agents)), Shard.parse(args.shard)
    grids = {rung: make_protocol_grid(bench, rung, args.protocol, agents, settings) for rung in args.rung}
    console, failed = Console(soft_wrap=True, highlight=False), 0
    folder = args.out / name_protocol(args.protocol, args.source)
    for rung, grid in grids.items():
        comparison = run_grid(grid, folder / rung, LocalLauncher(args.workers), shard=shard)
        failed += len(comparison.failures)
        if shard.parts == 1:
            write_report(comparison, f"hrl-escape ladder run {' '.join(args.agents)} --rung {rung} --protocol "
                         f"{args.protocol}" + (f" --from {args.source}" if args.source else ""))
        console.print(f"{rung}: {len(comparison.runs)} runs finished, {len(comparison.failures)} failed; "
                      f"{comparison.out}")
    return 1 if failed else 0
