"""Show a rung: its schematic, its sets and their roots; draw or save one of its rooms.

Examples:
    hrl-escape ladder show lattice
    hrl-escape ladder show clutter --role test --index 3 --draw room.svg --save room.json
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.table import Table

from hrl_escape.env.presets import describe_schematic
from hrl_escape.errors import ConfigError
from hrl_escape.ladder.benchmark import load_benchmark
from hrl_escape.ladder.manifest import list_changes
from hrl_escape.ladder.rung import Rung

Role = Literal["train", "valid", "test", "test_task"]


@dataclasses.dataclass(frozen=True)
class ShowArgs:
    """Options of `hrl-escape ladder show`."""

    rung: Annotated[str, tyro.conf.Positional]
    """Name of the rung."""
    benchmark: str = "ladder-1"
    """Benchmark that comes with the package, or a manifest file."""
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


def run(args: ShowArgs) -> None:
    """Print the rung; draw and save a room as the options say."""
    rung = load_benchmark(args.benchmark)[args.rung]
    report = _describe(rung)
    if args.draw or args.save:
        report["files"] = _write_room(rung, args)
    if args.json:
        print(json.dumps(report, indent=2))
        return
    console = Console(soft_wrap=True, highlight=False, width=120)  # a root has 64 digits
    console.print(f"[bold]{rung.name}[/bold]: {rung.isolates}; {describe_schematic(rung.config)}")
    table = Table("set", "rooms", "tasks", "skipped", "root", box=None, pad_edge=False)
    for role, row in report["sets"].items():
        table.add_row(role, str(row["rooms"]), str(row["tasks"]), str(row["skipped"]), row["root"])
    console.print(table)
    console.print(f"Test rooms whose task occurs in training: {rung.record.task_overlap:.0%}")
    console.print(f"Schematic: {json.dumps(report['config'])}")
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
    from hrl_escape.env.drawing.maps import save_map  # loads matplotlib

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
