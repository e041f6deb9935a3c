"""Measure every planner on the same queries: success, primitives, ratio to the fewest, times.

The contenders are the search along cached cost-to-go fields and, for each path planner, the
search in a corridor round its path. The fewest primitives come from a slow, near-exact reference.

Examples:
    hrl-escape bench planners
    hrl-escape bench planners --contenders fields RRTConnect PRM --rooms 20 --queries 10
    hrl-escape bench planners --csv planners.csv --plot planners.png
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from hrl_escape.errors import ConfigError, UnknownNameError


@dataclasses.dataclass(frozen=True)
class BenchPlannersArgs:
    """Options of `hrl-escape bench planners`."""

    contenders: tuple[str, ...] = ()
    """Contenders to measure: fields, or path planners by name; all by default."""
    floors: tuple[str, ...] = ()
    """Kinds of rooms, all by default: empty, '10 obstacles', '40 obstacles', 'interior walls'."""
    rooms: int = 3
    """Number of rooms of each kind."""
    queries: int = 5
    """Number of queries in each room."""
    csv: Path | None = None
    """File for one line a query and contender."""
    plot: Path | None = None
    """PNG, SVG or PDF file for a plot of ratios and times."""
    json: bool = False
    """Print JSON instead of a table."""


def run(args: BenchPlannersArgs) -> None:
    """Measure and print."""
    from hrl_escape.commands.bench import planner_contenders as bench  # loads OMPL and numba, which --help does without

    known = bench.list_contenders()
    for name in args.contenders:
        if name not in known:
            raise UnknownNameError("contender", name, known)
    for name in args.floors:
        if name not in bench.FLOORS:
            raise UnknownNameError("floor", name, bench.FLOORS)
    if args.rooms < 1 or args.queries < 1:
        raise ConfigError("bench", (args.rooms, args.queries), "at least 1 room and 1 query")
    contenders, floors = args.contenders or known, args.floors or tuple(bench.FLOORS)
    rows: list[bench.QueryResult] = []
    with Progress(console=Console(stderr=True), transient=True, disable=args.json) as progress:
        task = progress.add_task("", total=len(floors) * args.rooms * args.queries * len(contenders))
        for floor in floors:
            progress.update(task, description=f"{floor}: fewest primitives")
            queries = bench.make_queries(floor, range(args.rooms), args.queries)
            rows += bench.measure(queries, contenders, lambda name, floor=floor: progress.update(
                task, advance=1, description=f"{floor}: {name}"))
    scores = bench.score_contenders(rows)
    if args.csv:
        bench.write_csv(args.csv, rows)
    if args.plot:
        bench.draw_scores(args.plot, rows)
    if args.json:
        print(json.dumps([dataclasses.asdict(score) for score in scores], indent=2))
    else:
        _print(scores)


def _print(scores: list) -> None:
    table = Table(box=None, padding=(0, 2), pad_edge=False)
    for heading in ("floor", "contender"):
        table.add_column(heading, no_wrap=True)
    for heading in ("reached", "primitives", "ratio", "ratio p95", "median ms", "p99 ms"):
        table.add_column(heading, justify="right")
    last = ""
    for score in scores:
        table.add_row(score.floor if score.floor != last else "", score.contender, f"{score.success:.1%}",
                      f"{score.primitives:.1f}", f"{score.ratio:.3f}", f"{score.ratio_p95:.3f}",
                      f"{score.median_ms:.2f}", f"{score.p99_ms:.1f}")
        last = score.floor
    table.caption = "ratio: primitives divided by the near-exact fewest, over goals that were reached"
    Console(width=120, soft_wrap=True).print(table)
