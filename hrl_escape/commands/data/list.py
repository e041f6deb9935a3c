"""List the data sets of the catalogue: what behaved, how much, and whether a tape is there.

Examples:
    hrl-escape data list
    hrl-escape data list --rung lattice --json
"""

from __future__ import annotations

import dataclasses
import json

from rich.console import Console
from rich.table import Table

from hrl_escape.data.catalogue import TAPE_KINDS, find_tape, list_specs
from hrl_escape.errors import FileReadError


@dataclasses.dataclass(frozen=True)
class DataListArgs:
    """Options of `hrl-escape data list`."""

    rung: str | None = None
    """Show this rung's alone."""
    json: bool = False
    """Print JSON instead of a table."""


def run(args: DataListArgs) -> None:
    """Print one row a data set; large ones only where they were recorded."""
    rows = []
    for spec in list_specs():
        try:
            size: int | None = find_tape(spec.name).stat().st_size
        except FileReadError:
            size = None
        if args.rung in (None, spec.rung) and (size is not None or not spec.size):
            what = TAPE_KINDS[spec.kind]
            rows.append({"name": spec.name, "primitives": spec.primitives, "bytes": size, "what": what})
    if args.json:
        print(json.dumps(rows, indent=2))
        return
    table = Table("data set", "primitives", "bytes", "behaviour", box=None, pad_edge=False)
    for row in rows:
        stored = "-" if row["bytes"] is None else f"{row['bytes']:,}"
        table.add_row(str(row["name"]), f"{row['primitives']:,}", stored, str(row["what"]))
    console = Console(width=120)
    console.print(table)
    console.print("Names with 1m or 10m before v1 hold ten or a hundred times as much; to record one: "
                  "hrl-escape data make NAME", highlight=False)
