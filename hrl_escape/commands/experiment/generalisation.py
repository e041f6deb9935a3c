"""Measure efficiency in unseen rooms against the number of training rooms, and in deeper puzzles than trained on.

Writes docs/results/generalisation.md with its figure and a line of JSON a run. Killed, the same command goes on.

Examples:
    hrl-escape experiment generalisation
    hrl-escape experiment generalisation --rung pair --primitives 10000 --rooms 8 --part sizes
    hrl-escape experiment generalisation --from-raw      # the page anew from the lines, nothing is trained
"""

from __future__ import annotations

import dataclasses

from rich.console import Console

from hrl_escape.comparison.baselines.generalisation import (
    GeneralisationArgs,
    make_depth_grid,
    make_sizes_grid,
)
from hrl_escape.comparison.baselines.generalisation_page import write_generalisation_page
from hrl_escape.comparison.baselines.lines import BaselineRun, collect_baselines, joining_lines, load_lines
from hrl_escape.comparison.comparison import run_grid
from hrl_escape.comparison.launching.local import LocalLauncher
from hrl_escape.comparison.studies.running import get_raw_file, refuse_failures
from hrl_escape.errors import ConfigError
from hrl_escape.files import claim_folder
from hrl_escape.ladder.benchmark import load_benchmark


def run(args: GeneralisationArgs) -> None:
    """Run, write lines, page and figure, and say where they are."""
    raw = get_raw_file(args.docs, "generalisation")
    known = load_lines(raw) if raw.exists() else []
    if not args.from_raw:
        claim_folder(raw.parent)
    elif not known:
        raise ConfigError("docs", str(args.docs), "a folder with raw/generalisation.jsonl, or leave out --from-raw")
    with joining_lines(raw, [] if args.from_raw else _make_runs(args)) as lines:
        write_generalisation_page(lines, args.docs)
    Console(highlight=False, soft_wrap=True).print(f"Page: {args.docs / 'generalisation.md'}")


def _make_runs(args: GeneralisationArgs) -> list[BaselineRun]:
    """Lines of the runs of all parts."""
    bench, out = load_benchmark("ladder-1"), args.out / "generalisation"
    lines = []
    for part in args.part:
        grid = make_sizes_grid(bench, args) if part == "sizes" else make_depth_grid(bench, args, out / "sets")
        comparison = run_grid(grid, out / part, LocalLauncher(args.workers))
        refuse_failures(comparison)
        found = collect_baselines(comparison, part, args.rung)
        lines += found if part == "sizes" else [dataclasses.replace(line, rung=line.rooms.split(" > ")[1])
                                                for line in found]
    return lines
