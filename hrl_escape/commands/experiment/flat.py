"""Find out where learning without options breaks as buttons grow from one to six, with and without counts.

Writes docs/results/flat.md with its figure and raw results.

Examples:
    hrl-escape experiment flat --workers 2
    hrl-escape experiment flat --runs 20 --primitives 100000 --out /tmp/runs --docs /tmp/page
    hrl-escape experiment flat --from-raw                # the page anew from the raw results, nothing is trained
"""

from __future__ import annotations

import dataclasses

from rich.console import Console

from hrl_escape.experiments.studies.flat import make_flat_grid, make_paper_grid, write_flat_page
from hrl_escape.experiments.studies.running import StudyArgs, run_study


@dataclasses.dataclass(frozen=True)
class FlatArgs(StudyArgs):
    """Options of `hrl-escape experiment flat`."""

    runs: int = 10
    """Training seeds of each agent in each room."""
    primitives: int = 20_000
    """Training budget of a run."""


def run(args: FlatArgs) -> None:
    """Run, write the page, and print where each agent breaks."""
    grids = [make_paper_grid(args.runs, args.primitives), make_flat_grid(args.runs, args.primitives)]
    breaks = write_flat_page(run_study(grids, args), args.docs)
    console = Console(highlight=False, soft_wrap=True)
    for agent, broken in breaks.items():
        console.print(f"{agent}: {'does not break up to six buttons' if broken is None else f'breaks at {broken}'}")
    console.print(f"Page: {args.docs / 'flat.md'}")
