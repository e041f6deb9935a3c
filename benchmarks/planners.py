"""Measure planners on the same queries: success, primitives, ratio to the fewest, times.

The contenders are the search along cost-to-go fields, for each path planner the search in a corridor
round its path, and the method auto, which chooses between the two. A path planner's bare path is measured as well, for
a base that needs no primitives. The fewest primitives come from a
slow, near-exact reference; on floors of 60 m and more, from the best contender.
Times are for the first query in a room, for a goal that is new to a known room, and for the same goal again, all
without compilation.

Examples:
    python -m benchmarks.planners
    python -m benchmarks.planners --contenders fields RRTConnect BITstar --floors empty 'interior walls'
    python -m benchmarks.planners --csv planners.csv --plot planners.png
"""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from pathlib import Path

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from hrl_escape.cli import run_script
from hrl_escape.errors import ConfigError, UnknownNameError


@dataclasses.dataclass(frozen=True)
class Args:
    """Options of the command line."""

    contenders: tuple[str, ...] = ("auto", "fields", "RRTConnect", "BITstar", "RRTConnect-path")
    """Contenders to measure: auto, fields, path planners by name, or the bare path of one, as RRTConnect-path."""
    floors: tuple[str, ...] = ()
    """Kinds of queries, all by default: empty, '10 obstacles', '40 obstacles', 'interior walls', 'narrow passages',
    '60 m', '200 m', 'places, 10 obstacles', 'places, interior walls', 'places, 60 m', 'places, 200 m'."""
    rooms: int = 3
    """Number of instance seeds of each kind; some rooms of 200 m cannot be certified and are left out."""
    queries: int = 5
    """Number of queries in each room."""
    csv: Path | None = None
    """File for one line a query and contender."""
    plot: Path | None = None
    """PNG, SVG or PDF file for a plot of ratios and times."""
    json: bool = False
    """Print JSON instead of a table."""


def run(args: Args) -> None:
    """Measure and print."""
    from benchmarks import planner_contenders as contest  # heavy imports, which --help does without

    known = contest.list_contenders()
    for name in args.contenders:
        if name not in known:
            raise UnknownNameError("contender", name, known)
    for name in args.floors:
        if name not in contest.FLOORS:
            raise UnknownNameError("floor", name, contest.FLOORS)
    if args.rooms < 1 or args.queries < 1:
        raise ConfigError("rooms, queries", (args.rooms, args.queries), "at least 1 room and 1 query")
    contenders, floors = args.contenders, args.floors or tuple(contest.FLOORS)
    rows: list[contest.QueryResult] = []
    with Progress(console=Console(stderr=True), transient=True, disable=args.json) as progress:
        task = progress.add_task("", total=len(floors) * args.rooms * args.queries * len(contenders))
        for floor in floors:
            progress.update(task, description=f"{floor}: fewest primitives")
            queries = contest.make_queries(floor, range(args.rooms), args.queries)
            rows += contest.measure(queries, contenders, lambda name, floor=floor: progress.update(
                task, advance=1, description=f"{floor}: {name}"))
    scores = contest.score_contenders(rows)
    if args.csv:
        contest.write_csv(args.csv, rows)
    if args.plot:
        contest.draw_scores(args.plot, rows)
    if args.json:
        print(json.dumps([dataclasses.asdict(score) for score in scores], indent=2))
    else:
        _print(scores)


def _print(scores: list) -> None:
    table = Table(box=None, padding=(0, 2), pad_edge=False)
    for heading in ("floor", "contender"):
        table.add_column(heading, no_wrap=True)
    for heading in ("reached", "primitives", "ratio", "p95", "metres", "seconds", "cold ms", "new ms", "again ms",
                    "p99 ms"):
        table.add_column(heading, justify="right")
    last = ""
    for score in scores:
        table.add_row(score.floor if score.floor != last else "", score.contender, f"{score.success:.1%}",
                      *(_show(value, digits) for value, digits in ((score.primitives, 1), (score.ratio, 3),
                                                                   (score.ratio_p95, 3), (score.metres, 1),
                                                                   (score.seconds, 1))),
                      f"{score.cold_ms:.1f}", f"{score.new_ms:.1f}", f"{score.median_ms:.2f}", f"{score.p99_ms:.1f}")
        last = score.floor
    table.caption = ("ratio: primitives divided by the near-exact fewest, over goals that were reached; "
                     "metres, seconds: way of the base, and its time at 1 m/s, 1 m/s^2 and 1.5 rad/s; "
                     "ms: medians of planning, and the 99th percentile of the same goal again")
    Console(width=140, soft_wrap=True).print(table)


def _show(value: float, digits: int) -> str:
    """A number; a dash where there is none."""
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


if __name__ == "__main__":
    sys.exit(run_script(run))
