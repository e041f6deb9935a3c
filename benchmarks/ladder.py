"""Calibration and freezing of a ladder: what agents reach on each rung, and the roots of its sets.

    python -m benchmarks.ladder calibrate --rung doormat pair chain
    python -m benchmarks.ladder calibrate --agents smdp-dqn smdp-ppo --primitives 20000
    python -m benchmarks.ladder calibrate --agents smdp-ppo+objects+memory --protocol generalise
    python -m benchmarks.ladder freeze my-ladder.json
    python -m benchmarks.ladder costs

To freeze is to generate the rooms of every rung, to skip those that look alike, and to write the manifest's roots. A
manifest needs a name and, for each rung, a name and a room configuration; counts have defaults. Give a changed
frozen benchmark another name.

In a calibration every agent is tested in the same few test rooms. Learners train in each of them from nothing, or with
the protocol generalise in as many training rooms. A rung asks for something only where chance stays below 0.5, it is
sound where the planner, which knows the graph, reaches 1, and it is a step too high where a learner falls there from
above 0.9 on the rung before to below 0.1. The exit code is 1 if any of this does not hold.

Costs are seconds of training from the lines of studies, `hrl_escape/benchmark/costs.json`.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import sys
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.table import Table

from benchmarks.freezing import freeze_manifest
from hrl_escape.agents.registry import join_name, list_agents
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.comparison import run_grid
from hrl_escape.benchmark.launching.local import LocalLauncher
from hrl_escape.benchmark.protocols import LadderSettings, make_protocol_grid
from hrl_escape.benchmark.summary import summarise
from hrl_escape.cli import run_script
from hrl_escape.files import write_json
from hrl_escape.sets.benchmark import Benchmark, load_benchmark
from hrl_escape.sets.manifest import load_manifest
from hrl_escape.version import __version__

_ROOT = Path(__file__).parents[1]
_YARDSTICKS = ("random-options", "sweep-random", "sweep", "oracle")
STEP = 0.9, 0.1
"""An agent falls between two neighbouring rungs if it is above the first efficiency, then below the second."""
MOST_CHANCE = 0.5
"""Efficiency that random options must stay below."""


@dataclasses.dataclass(frozen=True)
class Calibrate:
    """Options of the calibration of a benchmark."""

    rung: tuple[str, ...] = ()
    """Names of rungs; all by default."""
    agents: tuple[str, ...] = ()
    """Agents in addition to the random policy, `sweep-random`, `sweep` and the planner."""
    benchmark: str = "ladder-1"
    """Benchmark that comes with the package, or a manifest file."""
    protocol: Literal["per-instance", "generalise"] = "per-instance"
    """Protocol of the learners."""
    rooms: int = 6
    """Test rooms of each rung, and training rooms with the protocol generalise."""
    runs: int = 1
    """Training seeds of learners."""
    primitives: int | None = None
    """Training budget of learners; the rung's own by default."""
    eval_episodes: int = 5
    """Episodes in an evaluation of the protocol per-instance."""
    out: Path = Path("runs/calibration")
    """Folder of runs; finished ones are kept."""
    workers: int | None = None
    """Runs at a time; one a core by default."""
    json: bool = False
    """Print JSON instead of a table."""


@dataclasses.dataclass(frozen=True)
class Freeze:
    """Options of the freezing of a manifest."""

    manifest: Annotated[Path, tyro.conf.Positional]
    """Manifest file; it is rewritten with roots, skipped indices and task overlaps."""


@dataclasses.dataclass(frozen=True)
class Costs:
    """Options of the table of costs."""

    out: Path = _ROOT / "hrl_escape/benchmark/costs.json"
    """File to write."""


def collect_rates(lines: Iterable[Mapping[str, Any]]) -> dict[str, dict[int, float]]:
    """Seconds for a thousand primitives, of agents by their registered names, by the number of buttons.

    Args:
        lines: of studies, with `agent`, `buttons`, `primitives` and `seconds`; two or more make a number.
    """
    known = {name for plain in list_agents() for name in (plain, join_name(plain, True))}
    found: dict[str, dict[int, list[tuple[float, int]]]] = defaultdict(lambda: defaultdict(list))
    for line in lines:
        if line["agent"] in known:
            found[line["agent"]][line["buttons"]].append((line["seconds"], line["primitives"]))
    return {agent: {buttons: round(1000 * sum(seconds for seconds, _ in runs) / sum(count for _, count in runs), 4)
                    for buttons, runs in sorted(own.items()) if len(runs) > 1} for agent, own in sorted(found.items())}


def read_lines() -> list[dict[str, Any]]:
    """Lines of the studies with seconds of single runs."""
    return [json.loads(line) for study in ("scaling", "price")
            for line in (_ROOT / f"studies/{study}/raw.jsonl").read_text(encoding="utf-8").splitlines()
            if '"seconds"' in line]


def write_costs(args: Costs) -> int:
    """Write the table of costs."""
    write_json(args.out, collect_rates(read_lines()), indent=1)
    print(f"wrote {args.out}")
    return 0


def find_miscalibration(chance: float, planner: float, is_stochastic: bool = False) -> list[str]:
    """Faults of a rung, in words, by the efficiency of random choices among its options and of the planner.

    In rooms with noise the planner is measured by its own expectation. A few episodes differ from it by 0.05 or less.
    """
    faults = [f"chance reaches {chance:.2f}, not below {MOST_CHANCE:g}"] if chance >= MOST_CHANCE else []
    least = 0.95 if is_stochastic else 1.0
    return faults + ([f"the planner reaches {planner:.2f}, not 1"] if planner < least else [])


def find_steps(rows: Mapping[str, Mapping[str, float]], learners: Iterable[str]) -> dict[str, list[str]]:
    """Find learners that fall from mastery to nothing from one rung to the next; the rungs between are missing.

    Args:
        rows: efficiency of each agent on each rung, the rungs in order.
        learners: agents to look at.

    Returns:
        Faults of each rung, in words.
    """
    faults: dict[str, list[str]] = {rung: [] for rung in rows}
    for (before, high), (after, low) in itertools.pairwise(rows.items()):
        faults[after] += [f"{agent} falls from {high[agent]:.2f} on {before} to {low[agent]:.2f}"
                          for agent in learners if high[agent] > STEP[0] and low[agent] < STEP[1]]
    return faults


def freeze(args: Freeze) -> int:
    """Write the manifest with roots, skipped indices and task overlaps."""
    frozen = freeze_manifest(load_manifest(args.manifest), __version__)
    frozen.save(args.manifest)
    print(f"{frozen.name}: {len(frozen.rungs)} rungs; wrote {args.manifest}")
    return 0


def calibrate(args: Calibrate) -> int:
    """Print a row a rung; the exit code is 1 if a rung is not calibrated."""
    bench = load_benchmark(args.benchmark)
    learners = tuple(map(AgentSpec.parse, args.agents))
    rows = {rung: _measure(bench, rung, learners, args) for rung in args.rung or [rung.name for rung in bench]}
    faults = find_steps(rows, [agent.label for agent in learners])
    for rung, row in rows.items():
        faults[rung] += find_miscalibration(row[_YARDSTICKS[0]], row[_YARDSTICKS[-1]],
                                            bench[rung].config.dynamics.is_random)
    if args.json:
        print(json.dumps({"efficiency": rows, "faults": faults}, indent=2))
    else:
        labels = [*_YARDSTICKS, *(agent.label for agent in learners)]
        table = Table("rung", *labels, "faults", box=None, pad_edge=False)
        for rung, row in rows.items():
            table.add_row(rung, *(f"{row[label]:.2f}" for label in labels), "; ".join(faults[rung]))
        Console(width=140, highlight=False).print(table)
    return 1 if any(faults.values()) else 0


def _measure(bench: Benchmark, rung: str, learners: Sequence[AgentSpec], args: Calibrate) -> dict[str, float]:
    """Efficiency of every agent on a rung."""
    plain = LadderSettings(1, 100, args.rooms, (args.rooms,), args.rooms)  # yardsticks do not train
    settings = LadderSettings(args.runs, args.primitives, args.rooms, (args.rooms,),
                              args.eval_episodes if args.protocol == "per-instance" else args.rooms)
    grids = [make_protocol_grid(bench, rung, "generalise", tuple(map(AgentSpec.parse, _YARDSTICKS)), plain)]
    if learners:
        grids.append(make_protocol_grid(bench, rung, args.protocol, learners, settings))
    found = {}
    for name, grid in zip(("yardsticks", args.protocol), grids, strict=False):
        summary = summarise(run_grid(grid, args.out / name / rung, LocalLauncher(args.workers)))
        found |= {agent.label: round(agent.efficiency.value, 4) for agent in summary.agents}
    return found


def run(args: Calibrate | Freeze | Costs) -> int:
    """Calibrate a benchmark, freeze a manifest or write costs; the exit code is 1 if a rung is not calibrated."""
    return (freeze(args) if isinstance(args, Freeze) else write_costs(args) if isinstance(args, Costs)
            else calibrate(args))


if __name__ == "__main__":
    sys.exit(run_script(run))
