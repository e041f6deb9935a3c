"""Calibrate a benchmark: how efficient chance, the order of the numbers, the planner and learners are on each rung.

Every agent is tested in the same few test rooms; learners train in as many training rooms first. A rung asks for
something only where chance stays below 0.5, and it is sound where the planner, who knows the graph, reaches 1.

Examples:
    hrl-escape ladder calibrate --rung doormat pair chain
    hrl-escape ladder calibrate --agents smdp-ppo+objects+memory+no-primitives --primitives 5000
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

from rich.console import Console
from rich.table import Table

from hrl_escape.experiments.comparison import run_grid
from hrl_escape.experiments.grid import AgentSpec
from hrl_escape.experiments.launching.local import LocalLauncher
from hrl_escape.experiments.protocols import LadderSettings, find_miscalibration, make_protocol_grid
from hrl_escape.experiments.summary import summarise
from hrl_escape.ladder.benchmark import load_benchmark

_YARDSTICKS = ("smdp-random+no-primitives", "smdp-shuffled-round+no-primitives", "smdp-index-order+no-primitives",
               "planner")


@dataclasses.dataclass(frozen=True)
class CalibrateArgs:
    """Options of `hrl-escape ladder calibrate`."""

    rung: tuple[str, ...] = ()
    """Names of rungs; all by default."""
    agents: tuple[str, ...] = ()
    """Learners beside chance, a shuffled round, the order of the numbers and the planner."""
    benchmark: str = "ladder-1"
    """Benchmark that comes with the package, or a manifest file."""
    rooms: int = 6
    """Test rooms of each rung, and training rooms of learners."""
    primitives: int = 100
    """Training budget of learners."""
    out: Path = Path("runs/calibration")
    """Folder of runs; finished ones are kept."""
    workers: int | None = None
    """Runs at a time; one a core by default."""
    json: bool = False
    """Print JSON instead of a table."""


def run(args: CalibrateArgs) -> int:
    """Print a row a rung; the exit code is 1 if a rung is not calibrated."""
    bench = load_benchmark(args.benchmark)
    agents = tuple(AgentSpec.parse(text) for text in (*_YARDSTICKS, *args.agents))
    settings = LadderSettings(1, args.primitives, args.rooms, (args.rooms,), args.rooms)
    rows = {}
    for rung in args.rung or [rung.name for rung in bench]:
        grid = make_protocol_grid(bench, rung, "generalise", agents, settings)
        summary = summarise(run_grid(grid, args.out / rung, LocalLauncher(args.workers)))
        rows[rung] = {agent.label: round(agent.efficiency.value, 4) for agent in summary.agents}
    faults = {rung: find_miscalibration(row[_YARDSTICKS[0]], row[_YARDSTICKS[-1]], bench[rung].config.dynamics.is_random)
              for rung, row in rows.items()}
    if args.json:
        print(json.dumps({"efficiency": rows, "faults": faults}, indent=2))
    else:
        table = Table("rung", *(agent.label for agent in agents), "faults", box=None, pad_edge=False)
        for rung, row in rows.items():
            table.add_row(rung, *(f"{row[agent.label]:.2f}" for agent in agents), "; ".join(faults[rung]))
        Console(width=140, highlight=False).print(table)
    return 1 if any(faults.values()) else 0
