"""A file of finished runs, a line each, which lets a stopped benchmark continue."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any


def run_missing(file: Path, cells: Iterable[dict[str, Any]], run: Callable[..., dict[str, Any]]
                ) -> list[dict[str, Any]]:
    """Make the runs that a file lacks, and add and print a line for each.

    Args:
        file: JSON lines; it is made with the first run.
        cells: what identifies each run.
        run: takes a cell as keyword arguments, and returns the results of the run.

    Returns:
        All rows of the file: the cell, the results and `seconds` of CPU time.
    """
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    for cell in cells:
        if any(row.items() >= cell.items() for row in rows):
            continue
        started = time.process_time()
        results = run(**cell)
        rows.append(cell | results | {"seconds": round(time.process_time() - started, 1)})
        with file.open("a") as lines:
            lines.write(json.dumps(rows[-1]) + "\n")
        print(json.dumps(rows[-1]), flush=True)
    return rows
