"""Runs of a study of twins, or the lines that an earlier run of it left, and the study's page."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from rich.console import Console

from hrl_escape.comparison.baselines.lines import BaselineRun, collect_baselines, load_lines, save_lines
from hrl_escape.comparison.baselines.twins import TwinStudy
from hrl_escape.comparison.baselines.twins_page import write_twins_page
from hrl_escape.comparison.comparison import run_grid
from hrl_escape.comparison.launching.local import LocalLauncher
from hrl_escape.comparison.presets import get_grid
from hrl_escape.comparison.studies.running import StudyArgs, get_raw_file, refuse_failures
from hrl_escape.files import claim_folder

__all__ = ["TwinArgs", "load_twin_lines", "write_page"]


@dataclasses.dataclass(frozen=True)
class TwinArgs(StudyArgs):
    """Options of studies of twins."""

    runs: int = 10
    """Training seeds of each agent in each room."""
    primitives: int = 10_000
    """Training budget of a run."""


def load_twin_lines(study: TwinStudy, args: TwinArgs) -> list[BaselineRun]:
    """Make what of a study's runs is missing, keep a line a run, and return all lines.

    Processes are started, so a script that calls this needs `if __name__ == "__main__":` around it.

    Raises:
        ComparisonError: a run failed.
        FileReadError: `from_raw`, and the file of lines is missing or damaged.
        EscapeError: see `run_grid`.
    """
    raw, grid = get_raw_file(args.docs, study.name), get_grid(study.name)
    if not args.from_raw:
        claim_folder(raw.parent)
        grid = dataclasses.replace(grid, runs=args.runs, primitives=args.primitives, first_seed=args.first_seed)
        comparison = run_grid(grid, args.out / grid.name, LocalLauncher(args.workers))
        refuse_failures(comparison)
        save_lines(raw, collect_baselines(comparison, "per-instance", grid.name))
    return load_lines(raw)


def write_page(study: TwinStudy, lines: Sequence[BaselineRun], args: TwinArgs, more: Sequence[str] = ()) -> None:
    """Write a study's page and print its conclusions; `more` as in `write_twins_page`.

    Raises:
        FileWriteError: the page cannot be written.
    """
    console = Console(highlight=False, soft_wrap=True)
    page = args.docs / f"{study.command}.md"
    for conclusion in write_twins_page(study, lines, page, more):
        console.print(conclusion, markup=False)
    console.print(f"Page: {page}")
