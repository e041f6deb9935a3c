"""Measure the price of flatness: what learning over primitives costs beside learning over options.

Writes docs/results/price.md with its figure and a line of JSON a run. Killed, the same command goes on.

Examples:
    hrl-escape experiment price
    hrl-escape experiment price --minutes 30             # begins no run after half an hour
    hrl-escape experiment price --from-raw               # the page anew from the lines, nothing is trained
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

from rich.console import Console

from hrl_escape.comparison.baselines.lines import load_data_lines
from hrl_escape.comparison.price.price_page import write_price_page
from hrl_escape.comparison.price.price_runs import PriceRun, measure_price_runs
from hrl_escape.comparison.studies.running import get_raw_file
from hrl_escape.files import claim_folder


@dataclasses.dataclass(frozen=True)
class PriceArgs:
    """Options of `hrl-escape experiment price`."""

    docs: Path = Path("docs/results")
    """Folder of the page, its figure and the lines."""
    replicates: int = 10
    """Rooms of each size, each with a training seed of its own."""
    first_replicate: int = 0
    """Lowest replicate; those from 200 on are fresh. Give another `--docs` too, or the page tells of both."""
    minutes: float | None = None
    """Minutes after which no further run is begun."""
    from_raw: bool = False
    """Train nothing: write the page anew from the lines."""


def run(args: PriceArgs) -> None:
    """Make the runs that are missing, write the page, and print its conclusions."""
    console = Console(highlight=False, soft_wrap=True)
    raw = get_raw_file(args.docs, "price")
    if not args.from_raw:
        claim_folder(raw.parent)
        for made in measure_price_runs(raw, args.first_replicate, args.replicates, args.minutes):
            console.print(f"{made}", markup=False)
    for conclusion in write_price_page(load_data_lines(raw, PriceRun), args.docs):
        console.print(conclusion, markup=False)
    console.print(f"Page: {args.docs / 'price.md'}")
