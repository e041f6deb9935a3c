"""Measure what learning from the primitives inside options gains, with options that follow plans and with Markov ones.

Writes docs/results/intra-option.md with a line of JSON a run. Killed, the same command goes on.

Examples:
    hrl-escape experiment intra-option --workers 2
    hrl-escape experiment intra-option --runs 20 --out /tmp/runs --docs /tmp/page
    hrl-escape experiment intra-option --from-raw        # the page anew from the lines, nothing is trained
"""

from __future__ import annotations

import dataclasses

from hrl_escape.comparison.baselines.twin_studies import INTRA_OPTION
from hrl_escape.comparison.baselines.twins_running import TwinArgs, load_twin_lines, write_page


@dataclasses.dataclass(frozen=True)
class IntraOptionArgs(TwinArgs):
    """Options of `hrl-escape experiment intra-option`."""

    primitives: int = 5_000
    """Training budget of a run; routes are planned at every primitive, which takes most of the time."""


def run(args: IntraOptionArgs) -> None:
    """Run, write the page, and print its conclusions."""
    write_page(INTRA_OPTION, load_twin_lines(INTRA_OPTION, args), args)
