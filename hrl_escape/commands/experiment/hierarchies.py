"""Measure what hierarchies that are synthesised from a room gain: by structure alone, and with planned leaves.

Writes docs/results/hierarchies.md with a line of JSON a run. Killed, the same command goes on.

Examples:
    hrl-escape experiment hierarchies --workers 2
    hrl-escape experiment hierarchies --runs 20 --out /tmp/runs --docs /tmp/page
    hrl-escape experiment hierarchies --from-raw         # the page anew from the lines, nothing is trained
"""

from __future__ import annotations

from hrl_escape.comparison.baselines.twin_studies import GIVEN_HIERARCHIES
from hrl_escape.comparison.baselines.twins_running import TwinArgs, load_twin_lines, write_page


def run(args: TwinArgs) -> None:
    """Run, write the page, and print its conclusions."""
    write_page(GIVEN_HIERARCHIES, load_twin_lines(GIVEN_HIERARCHIES, args), args)
