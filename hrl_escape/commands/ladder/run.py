"""Run agents on rungs under a protocol, and report each rung: the same comparison as `hrl-escape compare`.

per-instance learns each test room from nothing; generalise learns in training rooms and is tested in others; transfer
learns in training rooms of one rung and is tested, without learning, in rooms of another; few-shot is generalise with
several trials in each room, through which memories last; tower has a room of every rung in an episode, one after
another, within one horizon.
Finished runs are kept: the same command goes on where it was stopped. `hrl-escape ladder report` sums up the rungs.

Examples:
    hrl-escape ladder run smdp-dqn smdp-random planner --rung doormat pair --protocol per-instance --runs 3
    hrl-escape ladder run smdp-ppo+objects+memory smdp-random --rung lattice --protocol generalise --train-sizes 1 16 64
    hrl-escape ladder run smdp-dqn+objects+memory smdp-random planner --protocol transfer --from chain --rung lattice-5
    hrl-escape ladder run smdp-dqn+objects+memory smdp-random planner --protocol few-shot --trials 4 --rung chain
    hrl-escape ladder run smdp-ppo+objects+memory+no-primitives smdp-random+no-primitives planner --protocol tower
    hrl-escape ladder run smdp-dqn planner --rung chain lattice --out /shared/ladder --shard 3/8
"""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from hrl_escape.commands.launching import LaunchArgs
from hrl_escape.comparison.grid import AgentSpec
from hrl_escape.comparison.protocols import (
    TOWER,
    LadderSettings,
    Protocol,
    choose_floors,
    make_protocol_grid,
    make_tower_grid,
    name_protocol,
)
from hrl_escape.comparison.reporting.report import write_report
from hrl_escape.ladder.benchmark import load_benchmark

FROM = {"word": "from"}
"""Word on the command line of a field whose name Python reserves."""


@dataclasses.dataclass(frozen=True)
class RunArgs(LaunchArgs):
    """Options of `hrl-escape ladder run`."""

    agents: Annotated[tuple[str, ...], tyro.conf.Positional]
    """Agents, as for `hrl-escape compare`: smdp-dqn, smdp-ppo+objects+memory, planner."""
    rung: tuple[str, ...] = ()
    """Names of rungs; all by default, in a tower those with the same primitives."""
    protocol: Protocol = "per-instance"
    """per-instance, generalise, transfer, few-shot or tower."""
    source: Annotated[str | None, tyro.conf.arg(name="from")] = dataclasses.field(default=None, metadata=FROM)
    """Rung to train on with transfer."""
    benchmark: str = "ladder-1"
    """Benchmark that comes with the package, or a manifest file."""
    runs: int = LadderSettings().runs
    """Training seeds in each room or set."""
    first_seed: int = LadderSettings().first_seed
    """Lowest training seed; another one replicates results with fresh seeds."""
    primitives: int | None = None
    """Training budget of a run; the rung's own by default."""
    rooms: int | None = None
    """Rooms of the test set; by default 10 with per-instance and on each floor of a tower, otherwise all."""
    train_sizes: tuple[int, ...] = LadderSettings().train_sizes
    """Numbers of training rooms, with all protocols but per-instance."""
    trials: int = LadderSettings().trials
    """Trials in each room with few-shot."""
    floors: int = LadderSettings().floors
    """Floors of a tower of one rung, whose marks follow one motif in an episode, so that the first floor teaches it."""
    eval_episodes: int | None = None
    """Episodes in an evaluation; by default 20 with per-instance, otherwise one in each test room."""
    observation: str | None = None
    """Observation of all agents; by default features with per-instance if no agent is +objects, otherwise objects."""
    out: Path = Path("runs/ladder")
    """Folder of all rungs and protocols."""

    def format_command(self, rungs: Sequence[str]) -> str:
        """The command line that runs these rungs again."""
        return shlex.join(["hrl-escape", "ladder", "run", *self.agents, "--rung", *rungs,
                           *self.format_options("agents", "rung")])


def run(args: RunArgs) -> int:
    """Run rung by rung; the exit code is 1 if runs failed."""
    bench = load_benchmark(args.benchmark)
    settings = LadderSettings(args.runs, args.primitives, args.rooms, args.train_sizes, args.eval_episodes,
                              args.observation, args.source, args.trials, args.first_seed, args.floors)
    agents = tuple(map(AgentSpec.parse, args.agents))
    console, failed = Console(soft_wrap=True, highlight=False), 0
    rungs = args.rung or tuple(rung.name for rung in bench)
    if args.protocol == TOWER:
        floors = args.rung or choose_floors(bench)
        if left_out := [rung for rung in rungs if rung not in floors]:
            console.print(f"Left out of the tower, as their robots have other primitives: {', '.join(left_out)}")
        parts = {TOWER: (floors, make_tower_grid(bench, floors, agents, settings))}
    else:
        parts = {rung: ((rung,), make_protocol_grid(bench, rung, args.protocol, agents, settings)) for rung in rungs}
    folder = args.out / name_protocol(args.protocol, args.source)
    for name, (chosen, grid) in parts.items():
        if args.dry_run:
            console.print(f"{name}: {args.describe_work(grid, folder / name)}")
            continue
        comparison = args.make_runs(grid, folder / name)
        failed += len(comparison.failures)
        if not args.shard:
            write_report(comparison, args.format_command(chosen))
        console.print(f"{name}: {len(comparison.runs)} runs finished, {len(comparison.failures)} failed; "
                      f"{comparison.out}")
    return 1 if failed else 0
