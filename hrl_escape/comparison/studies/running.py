"""Runs the grids of a study, or reads what an earlier run of them left, and keeps the raw results beside the page."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from hrl_escape.comparison.comparison import Comparison, run_grid
from hrl_escape.comparison.grid import Grid
from hrl_escape.comparison.launching.local import LocalLauncher
from hrl_escape.comparison.studies.raw import RawRun, collect_runs, load_runs, save_runs
from hrl_escape.comparison.summary import summarise
from hrl_escape.errors import ComparisonError
from hrl_escape.files import claim_folder

__all__ = ["StudyArgs", "get_raw_file", "refuse_failures", "run_study"]


@dataclasses.dataclass(frozen=True)
class StudyArgs:
    """Options that the commands of all studies share."""

    docs: Path = Path("docs/results")
    """Folder of the page, its figures and the raw results."""
    out: Path = Path("runs")
    """Folder of the runs, one of its own for each grid; finished runs in it are kept."""
    workers: int | None = None
    """Runs at a time; one a core by default."""
    first_seed: int = 0
    """Lowest training seed; those from 100 on are fresh. Give another `--docs` too, or the page is written over."""
    from_raw: bool = False
    """Train nothing: write the page anew from the raw results."""


def get_raw_file(docs: Path, name: str) -> Path:
    """Path of a grid's raw results beside the page."""
    return docs / "raw" / f"{name}.jsonl"


def run_study(grids: Sequence[Grid], args: StudyArgs) -> dict[str, list[RawRun]]:
    """Run grids one after another, keep their raw results, and return these by the grids' names.

    Processes are started, so a script that calls this needs `if __name__ == "__main__":` around it.

    Raises:
        ComparisonError: a run failed.
        FileWriteError: the page's folder cannot be written.
        FileReadError: `from_raw`, and a file of raw results is missing or damaged.
        EscapeError: see `run_grid`.
    """
    claim_folder(args.docs / "raw")
    found = {}
    for grid in (dataclasses.replace(grid, first_seed=args.first_seed) for grid in grids):
        path = get_raw_file(args.docs, grid.name)
        if not args.from_raw:
            comparison = run_grid(grid, args.out / grid.name, LocalLauncher(args.workers))
            refuse_failures(comparison)
            save_runs(path, collect_runs(summarise(comparison), comparison))
        found[grid.name] = load_runs(path)
    return found


def refuse_failures(comparison: Comparison) -> None:
    """Refuse a comparison in which runs failed, because a study tells of all of them.

    Raises:
        ComparisonError: runs failed; names the first and its error.
    """
    if comparison.failures:
        first = comparison.failures[0]
        raise ComparisonError(f"{len(comparison.failures)} runs of {comparison.grid.name} failed; {first.run.name}: "
                              f"{first.message}. The same command tries them again")
