"""Measure what hierarchies that are synthesised from a room gain: by structure alone, and with planned leaves.

Writes docs/results/hierarchies.md with a line of JSON a run. Killed, the same command goes on.

Examples:
    hrl-escape experiment hierarchies --workers 2
    hrl-escape experiment hierarchies --runs 20 --out /tmp/runs --docs /tmp/page
    hrl-escape experiment hierarchies --from-raw         # the page anew from the lines, nothing is trained
"""

from __future__ import annotations

import dataclasses

from rich.console import Console

from hrl_escape.experiments.baselines.hierarchies_page import GRID_NAME, write_hierarchies_page
from hrl_escape.experiments.baselines.lines import collect_baselines, load_lines, save_lines
from hrl_escape.experiments.comparison import run_grid
from hrl_escape.experiments.launching.local import LocalLauncher
from hrl_escape.experiments.presets import get_grid
from hrl_escape.experiments.studies.running import StudyArgs, get_raw_file, refuse_failures
from hrl_escape.files import claim_folder

_GRID = get_grid(GRID_NAME)


@dataclasses.dataclass(frozen=True)
class HierarchiesArgs(StudyArgs):
    """Options of `hrl-escape experiment hierarchies`."""

    runs: int = _GRID.runs
    """Training seeds of each agent in each room."""
    primitives: int = _GRID.primitives
    """Training budget of a run."""


def run(args: HierarchiesArgs) -> None:
    """Run, write the page, and print its conclusions."""
    raw = get_raw_file(args.docs, _GRID.name)
    if not args.from_raw:
        claim_folder(raw.parent)
        grid = dataclasses.replace(_GRID, runs=args.runs, primitives=args.primitives, first_seed=args.first_seed)
        comparison = run_grid(grid, args.out / grid.name, LocalLauncher(args.workers))
        refuse_failures(comparison)
        save_lines(raw, collect_baselines(comparison, "per-instance", _GRID.name))
    console = Console(highlight=False, soft_wrap=True)
    page = args.docs / "hierarchies.md"
    for conclusion in write_hierarchies_page(load_lines(raw), page):
        console.print(conclusion, markup=False)
    console.print(f"Page: {page}")
