"""Run the published baselines of the ladder: every agent on every rung, from nothing and in unseen rooms.

Writes docs/results/ladder.md with a line of JSON a run. Killed or out of time, the same command goes on.

Examples:
    hrl-escape experiment ladder --minutes 600
    hrl-escape experiment ladder --rung doormat pair chain --rooms 2 --runs 1 --minutes 10 --docs /tmp/page
    hrl-escape experiment ladder --from-raw              # the page anew from the lines, nothing is trained
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from pathlib import Path

from rich.console import Console

from hrl_escape.comparison.baselines.lines import joining_lines, load_lines
from hrl_escape.comparison.baselines.page import write_baselines_page
from hrl_escape.comparison.baselines.running import (
    BaselineArgs,
    collect_lines,
    list_missing,
    run_baselines,
    ship_agents,
)
from hrl_escape.comparison.studies.running import get_raw_file
from hrl_escape.errors import ConfigError
from hrl_escape.files import claim_folder
from hrl_escape.ladder.benchmark import load_benchmark


@dataclasses.dataclass(frozen=True)
class LadderArgs(BaselineArgs):
    """Options of `hrl-escape experiment ladder`."""

    minutes: float = 240.0
    """Begin no run after so long."""
    ship: Path | None = None
    """Folder to copy the best agent of each rung to."""


def run(args: LadderArgs) -> None:
    """Run, write lines and page, and say where they are."""
    bench, raw = load_benchmark("ladder-1"), get_raw_file(args.docs, "ladder")
    console = Console(highlight=False, soft_wrap=True)
    known, new = load_lines(raw) if raw.exists() else [], []
    if not args.from_raw:
        for name in ("rooms", "runs", "minutes"):
            if getattr(args, name) <= 0:
                raise ConfigError(name, getattr(args, name), "above 0")
        claim_folder(raw.parent)
        found = run_baselines(bench, args, args.minutes)
        new = collect_lines(found)
        if args.ship is not None:
            for rung, agent in ship_agents(found, args.ship).items():
                console.print(f"{rung}: {agent}", markup=False)
        failures = [failure for comparison in found.values() for failure in comparison.failures]
        for message, count in Counter(failure.message for failure in failures).items():
            console.print(f"{count} runs failed: {message}", markup=False)
        console.print(f"{list_missing(found) - len(failures)} runs are left for another time")
    if not known and not new:
        raise ConfigError("docs", str(args.docs), "a folder with raw/ladder.jsonl, or leave out --from-raw")
    with joining_lines(raw, new) as lines:
        write_baselines_page(lines, [rung.name for rung in bench], args.docs / "ladder.md",
                             [rung.name for rung in bench if rung.config.dynamics.is_random])
    console.print(f"Page: {args.docs / 'ladder.md'}")
