"""Measure what hierarchies gain that are learned: options, skills and causal structure, over planned presses.

Places the options that were learned beside planned ones that fail with a known probability. Writes
docs/results/learned.md with a line of JSON a run. Killed, the same command goes on.

Examples:
    hrl-escape experiment learned --workers 2
    hrl-escape experiment learned --runs 20 --out /tmp/runs --docs /tmp/page
    hrl-escape experiment learned --from-raw             # the page anew from the lines, nothing is trained
"""

from __future__ import annotations

from hrl_escape.comparison.baselines.dial import DIAL, DialLine, make_dial_section, measure_dial
from hrl_escape.comparison.baselines.lines import load_data_lines
from hrl_escape.comparison.baselines.twin_studies import LEARNED_HIERARCHIES
from hrl_escape.comparison.baselines.twins_running import TwinArgs, load_twin_lines, write_page
from hrl_escape.comparison.studies.running import get_raw_file


def run(args: TwinArgs) -> None:
    """Run, write the page, and print its conclusions."""
    lines, dial = load_twin_lines(LEARNED_HIERARCHIES, args), get_raw_file(args.docs, "option-dial")
    if not args.from_raw:
        seeds = range(args.first_seed, args.first_seed + args.runs)
        measure_dial(DIAL, dial, seeds, args.primitives)
    write_page(LEARNED_HIERARCHIES, lines, args, make_dial_section(DIAL, load_data_lines(dial, DialLine)))
