"""Run the three experiments of Menashe and Stone (2019) again, and test the paper's claims one by one.

Writes docs/results/paper.md with its figures and raw results.

Examples:
    hrl-escape experiment paper --workers 2
    hrl-escape experiment paper --from-raw               # the page anew from the raw results, nothing is trained
"""

from __future__ import annotations

import dataclasses

from rich.console import Console

from hrl_escape.comparison.presets import get_grid
from hrl_escape.comparison.studies.claims import FIGURES
from hrl_escape.comparison.studies.paper_page import write_paper_page
from hrl_escape.comparison.studies.running import StudyArgs, run_study


@dataclasses.dataclass(frozen=True)
class PaperArgs(StudyArgs):
    """Options of `hrl-escape experiment paper`."""


def run(args: PaperArgs) -> None:
    """Run, write the page, and say what came of each claim."""
    results = run_study([get_grid(name) for name in FIGURES], args)
    console = Console(highlight=False, soft_wrap=True)
    for number, finding in enumerate(write_paper_page(results, args.docs), 1):
        console.print(f"{number:2} {finding.claim.says} [bold]{finding.agrees}[/bold]")
    console.print(f"Page: {args.docs / 'paper.md'}")
