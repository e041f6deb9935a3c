"""List the rungs of a benchmark: rooms, what each rung asks for, the size of its sets, and what training costs.

Core hours are those of smdp-dqn by published rates, with ten seeds in each of ten test rooms (protocol per-instance);
the other protocols take a tenth for each number of training rooms. `hrl-escape ladder run --dry-run` tells any other.
Where references were measured they follow: efficiency of random choices, of the best searcher that learns nothing and
of smdp-bayes, and how many bits of the hidden graph marks and places tell.

Examples:
    hrl-escape ladder list
    hrl-escape ladder list --benchmark my-ladder.json --json
"""

from __future__ import annotations

import dataclasses
import json

from rich.console import Console
from rich.table import Table

from hrl_escape.comparison.cost import count_buttons, estimate_hours, load_rates
from hrl_escape.comparison.grid import AgentSpec
from hrl_escape.comparison.protocols import get_budget
from hrl_escape.env.presets import describe_schematic
from hrl_escape.ladder.benchmark import load_benchmark
from hrl_escape.ladder.manifest import ROLES, RungReferences, load_references
from hrl_escape.ladder.rung import Rung


@dataclasses.dataclass(frozen=True)
class LadderListArgs:
    """Options of `hrl-escape ladder list`."""

    benchmark: str = "ladder-1"
    """Benchmark that comes with the package, or a manifest file."""
    json: bool = False
    """Print JSON instead of a table."""


def run(args: LadderListArgs) -> None:
    """Print one row a rung."""
    bench, known = load_benchmark(args.benchmark), load_references(args.benchmark)
    rows = [{
        "rung": rung.name,
        "isolates": rung.isolates,
        "rooms": describe_schematic(rung.config),
        "horizon": rung.config.horizon,
        "sets": {role: record.count for role in ROLES if (record := getattr(rung.record, role))},
        "skipped": sum(len(record.skipped) for role in ROLES if (record := getattr(rung.record, role))),
        "task_overlap": rung.record.task_overlap,
        "core_hours": _estimate(rung),
        "references": dataclasses.asdict(known[rung.name]) if rung.name in known else None,
    } for rung in bench]
    if args.json:
        print(json.dumps({"benchmark": bench.name, "rungs": rows}, indent=2))
        return
    table = Table("rung", "rooms", "/".join(ROLES), "task overlap", "core hours",
                  *(("chance", "searcher", "ceiling", "bits told") if known else ()), box=None, pad_edge=False)
    for row in rows:
        counts = "/".join(str(row["sets"].get(role, "-")) for role in ROLES)
        table.add_row(row["rung"], row["rooms"], counts, f"{row['task_overlap']:.0%}",
                      f"{row['core_hours']:.1f}", *(_describe(known.get(row["rung"])) if known else ()))
    Console(width=120).print(table)


def _describe(own: RungReferences | None) -> list[str]:
    if own is None:
        return []
    told = "" if own.told is None else f"{own.told:.1f} of {own.hidden:.1f}"
    return [*("" if value is None else f"{value:.2f}" for value in (own.chance, own.searcher, own.ceiling)), told]


def _estimate(rung: Rung) -> float:
    rooms = [count_buttons(rung.config)] * min(10, rung.record.test.count)
    return round(estimate_hours([AgentSpec("smdp-dqn")], get_budget(rung.name), rooms, 10, load_rates())[0], 2)
