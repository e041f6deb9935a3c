"""Commands for the rungs of a benchmark."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.table import Table

from hrl_escape.benchmark.rung_references import RungReferences, load_references
from hrl_escape.commands.room_choice import refuse_options
from hrl_escape.env.presets import describe_config
from hrl_escape.errors import ConfigError
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.sets.manifest import ROLES, list_changes
from hrl_escape.sets.rung import Rung


@dataclasses.dataclass(frozen=True)
class LadderListArgs:
    """Options of `hrl-escape ladder list`."""

    benchmark: str = "ladder-1"
    """Benchmark that comes with the package, or a manifest file."""
    json: bool = False
    """Print JSON instead of a table."""


def run_list(args: LadderListArgs) -> None:
    """List the rungs of a benchmark: rooms, required ability, sizes of sets, and training cost.

    Core hours are estimates for smdp-dqn by published rates, with ten seeds in each of ten test rooms (protocol
    per-instance). Other protocols take a tenth for each number of training rooms; `hrl-escape ladder run --dry-run`
    prints other estimates. Reference efficiencies follow if measured: random options, best search baseline and Bayes
    planner, and the bits of the graph that cues and positions reveal.

    Examples:
        hrl-escape ladder list
        hrl-escape ladder list --benchmark my-ladder.json --json
    """
    bench, known = load_benchmark(args.benchmark), load_references(args.benchmark)
    rows = [{
        "rung": rung.name,
        "isolates": rung.isolates,
        "rooms": describe_config(rung.config),
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
                  *(("random options", "best search", "Bayes planner", "bits told") if known else ()), box=None,
                  pad_edge=False)
    for row in rows:
        counts = "/".join(str(row["sets"].get(role, "-")) for role in ROLES)
        table.add_row(row["rung"], row["rooms"], counts, f"{row['task_overlap']:.0%}",
                      f"{row['core_hours']:.1f}", *(_show_references(known.get(row["rung"])) if known else ()))
    Console(width=120).print(table)


def _show_references(own: RungReferences | None) -> list[str]:
    if own is None:
        return []
    told = "" if own.told is None else f"{own.told:.1f} of {own.hidden:.1f}"
    return [*("" if value is None else f"{value:.2f}" for value in (own.random, own.search, own.bayes)), told]


def _estimate(rung: Rung) -> float:
    from hrl_escape.agents.spec import AgentSpec
    from hrl_escape.benchmark.cost import count_buttons, estimate_hours, load_rates  # these load planners
    from hrl_escape.benchmark.protocols import get_budget

    rooms = [count_buttons(rung.config)] * min(10, rung.record.test.count)
    return round(estimate_hours([AgentSpec("smdp-dqn")], get_budget(rung.name), rooms, 10, load_rates())[0], 2)


Role = Literal["train", "valid", "test", "test_task"]


@dataclasses.dataclass(frozen=True)
class ShowArgs:
    """Options of `hrl-escape ladder show`."""

    rung: Annotated[str, tyro.conf.Positional]
    """Name of the rung, with another benchmark in front: cues-1@7/colours."""
    benchmark: str | None = None
    """Benchmark that comes with the package, or a manifest file; ladder-1 by default."""
    role: Role = "train"
    """Set of the room to draw or save."""
    index: int = 0
    """Number of the room in its set."""
    draw: Path | None = None
    """Picture of the room to write: .svg, .pdf or .png."""
    save: Path | None = None
    """File to write the room to, as JSON."""
    json: bool = False
    """Print JSON instead of tables."""


def run_show(args: ShowArgs) -> None:
    """Show a rung: configuration, sets and their roots; draw or save one of its rooms.

    Examples:
        hrl-escape ladder show lattice
        hrl-escape ladder show cues-1@7/colours
        hrl-escape ladder show clutter --role test --index 3 --draw room.svg --save room.json
    """
    benchmark, _, name = args.rung.rpartition("/")
    if benchmark:
        refuse_options(args, ("benchmark",), f"does not go with {args.rung}, which names its benchmark")
    rung = load_benchmark(benchmark or args.benchmark or "ladder-1")[name]
    report = _describe(rung)
    if args.draw or args.save:
        report["files"] = _write_room(rung, args)
    if args.json:
        print(json.dumps(report, indent=2))
        return
    console = Console(soft_wrap=True, highlight=False, width=120)  # a root has 64 digits
    console.print(f"[bold]{rung.name}[/bold]: {rung.isolates}; {describe_config(rung.config)}")
    table = Table("set", "rooms", "tasks", "skipped", "root", box=None, pad_edge=False)
    for role, row in report["sets"].items():
        table.add_row(role, str(row["rooms"]), str(row["tasks"]), str(row["skipped"]), row["root"])
    console.print(table)
    console.print(f"Test rooms whose task occurs in training: {rung.record.task_overlap:.0%}")
    console.print(f"Room configuration: {json.dumps(report['config'])}")
    for path in report.get("files", []):
        console.print(f"wrote {path}")


def _describe(rung: Rung) -> dict[str, Any]:
    records = {role: getattr(rung.record, role) for role in rung.sets}
    return {
        "benchmark": rung.benchmark, "rung": rung.name, "isolates": rung.isolates,
        "config": list_changes(rung.config), "task_overlap": rung.record.task_overlap,
        "sets": {role: {"rooms": record.count, "tasks": len(set(rung.sets[role].tasks)),
                        "skipped": len(record.skipped), "root": record.root}
                 for role, record in records.items() if record is not None},
    }


def _write_room(rung: Rung, args: ShowArgs) -> list[str]:
    from hrl_escape.env.pictures.maps import save_map  # loads matplotlib

    rooms = rung.sets.get(args.role)
    if rooms is None or not 0 <= args.index < len(rooms):
        raise ConfigError("--index", args.index, f"a room of {rung.name}'s {args.role}, of which there are "
                          f"{0 if rooms is None else len(rooms)}")
    room = rooms[args.index]
    if args.draw is not None:
        save_map(args.draw, room)
    if args.save is not None:
        room.save(args.save)
    return [str(path) for path in (args.draw, args.save) if path is not None]


@dataclasses.dataclass(frozen=True)
class VerifyArgs:
    """Options of `hrl-escape ladder verify`."""

    rungs: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    """Rungs to verify; all by default."""
    benchmark: str = "ladder-1"
    """Benchmark that comes with the package, or a manifest file."""


def run_verify(args: VerifyArgs) -> None:
    """Generate the rooms of a benchmark and verify them against the manifest and each other.

    A rung takes a few seconds, or up to a minute with many obstacles.

    Examples:
        hrl-escape ladder verify
        hrl-escape ladder verify doormat pair
    """
    console = Console(soft_wrap=True, highlight=False)
    load_benchmark(args.benchmark).verify(args.rungs, console.print)
