"""Generalisation: efficiency by numbers of training rooms and in deeper puzzles, with its figure."""

from __future__ import annotations

import dataclasses
import re
import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeVar

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hrl_escape.benchmark.comparison import run_grid
from hrl_escape.benchmark.launching.local import LocalLauncher
from hrl_escape.benchmark.statistics import LEAST_RUNS
from hrl_escape.env.pictures import palette
from hrl_escape.sets.benchmark import Benchmark, load_benchmark
from studies.baseline import BaselineRun, collect_baselines
from studies.figures import FIGURE_STYLE, finish_axes
from studies.generalisation.findings import advise, tell_best, tell_puzzle_depths, tell_room_numbers
from studies.generalisation.grids import (
    AT_ONCE,
    CEILING,
    DEPTHS,
    FLAT,
    FLAT_CHANCE,
    MEMORY,
    NAMES,
    OBJECTS,
    SEARCH_BASELINES,
    TRAINED,
    TRANSFER,
    GeneralisationArgs,
    make_depth_grid,
    make_sizes_grid,
)
from studies.generalisation.many import STREAMS, measure_courses, measure_many, name_rooms, run_reference
from studies.generalisation.transfer import draw_transfers, read_transfers, tabulate_transfers, tell_transfers
from studies.ladder.calibration import CHANCE
from studies.page import make_table
from studies.running import refuse_failures
from studies.store import Store
from studies.study import Page, Study

__all__ = ["Args", "analyse", "draw_sizes", "measure", "prefer_at_once", "split_at_once"]

Args = GeneralisationArgs
_CHANCES = dict.fromkeys(NAMES, CHANCE) | {FLAT: FLAT_CHANCE}
_COLOURS = dict(zip(NAMES, ("#777777", "#0072b2", "#e69f00", "#d55e00"), strict=True))
_Key = TypeVar("_Key")


def measure(study: Study, args: GeneralisationArgs, store: Store) -> None:
    """Run the parts that are asked for; in the part `depth` a line's rung is the kind of room tested in."""
    bench, out = load_benchmark(study.data["benchmark"]), args.out / "generalisation"
    for part in args.part:
        if part == "many":
            _measure_many(bench, args, store)
            continue
        if part in ("many-depth", "transfer"):
            _measure_courses(bench, args, store, (TRAINED,) if part == "many-depth" else TRANSFER)
            continue
        grid = make_sizes_grid(bench, args) if part == "sizes" else make_depth_grid(bench, args, out / "sets")
        comparison = run_grid(grid, out / part, LocalLauncher(args.workers))
        refuse_failures(comparison)
        lines = collect_baselines(comparison, part, args.rung)
        store.add(lines if part == "sizes" else [dataclasses.replace(line, rung=line.rooms.split(" > ")[1])
                                                 for line in lines])


def _measure_many(bench: Benchmark, args: GeneralisationArgs, store: Store) -> None:
    """Runs from many rooms at once that are missing, each kept as soon as it is done."""
    sizes = [size for size in args.sizes if size <= bench[args.rung].record.train.count]
    known = {(line.agent.removesuffix(AT_ONCE), _count_rooms(line), line.seed)
             for line in _list_at_once(args, store, "sizes") if line.rung == args.rung}
    jobs = [job for agent in args.agents or NAMES for size in sizes for seed in _list_seeds(args)
            if (job := (agent, size, seed)) not in known]
    for line in measure_many(bench.name, args.rung, jobs, args.primitives, args.rooms, args.workers or 1):
        store.add([line])
        print(f"{line.agent}, {_count_rooms(line)} rooms, seed {line.seed}: {line.efficiency:.3f}", file=sys.stderr)


def _measure_courses(bench: Benchmark, args: GeneralisationArgs, store: Store, courses: Sequence[str]) -> None:
    """Tests of courses that are missing, those of a run kept as soon as they are done; over rungs references first."""
    part = "depth" if courses == (TRAINED,) else "transfer"
    if part == "transfer":
        there = {(line.rung, line.agent) for line in store.load() if line.protocol == part}
        store.add(run_reference(bench.name, rung, agent, args.rooms) for rung in courses
                  for agent in (*SEARCH_BASELINES, *CEILING, CHANCE) if (rung, agent) not in there)
    names = {course: TRAINED if course == TRAINED else name_rooms(bench.name, course, "train", args.shallow_rooms)
             for course in courses}
    known = {(line.rooms.split(" > ")[0], line.agent.removesuffix(AT_ONCE), line.seed)
             for line in _list_at_once(args, store, part)}
    defaults = (OBJECTS, MEMORY) if part == "depth" else (MEMORY,)
    jobs = [(course, agent, seed) for course in courses for agent in args.agents or defaults
            for seed in _list_seeds(args) if (names[course], agent, seed) not in known]
    for lines in measure_courses(bench.name, jobs, args.primitives, args.shallow_rooms, args.rooms, args.workers or 1):
        store.add(lines)
        print(lines[0].rooms.split(" > ")[0], ", ".join(f"{line.rung}: {line.efficiency:.3f}" for line in lines),
              file=sys.stderr)


def _list_seeds(args: GeneralisationArgs) -> range:
    return range(args.first_seed, args.first_seed + args.runs)


def _list_at_once(args: GeneralisationArgs, store: Store, part: str) -> list[BaselineRun]:
    """Lines of a part that are there, of learners from many rooms at once with this budget and as many tests."""
    return [line for line in store.load() if line.agent.endswith(AT_ONCE)
            and (line.protocol, line.primitives, line.episodes) == (part, args.primitives, args.rooms)]


def split_at_once(lines: Sequence[BaselineRun]) -> tuple[list[BaselineRun], list[BaselineRun]]:
    """Lines of learners from many rooms at once, by their own labels, and all others but theirs on the same rungs."""
    at_once = [dataclasses.replace(line, agent=line.agent.removesuffix(AT_ONCE)) for line in lines
               if line.agent.endswith(AT_ONCE)]
    there = {(line.rung, line.agent) for line in at_once}
    return at_once, [line for line in lines
                     if not line.agent.endswith(AT_ONCE) and (line.rung, line.agent) not in there]


def prefer_at_once(lines: Sequence[BaselineRun]) -> list[BaselineRun]:
    """Lines of a part, of each learner those from many rooms at once where there are any, by its own label."""
    at_once, alone = split_at_once(lines)
    return sorted([*at_once, *alone], key=lambda line: line.place)


def analyse(study: Study, lines: Sequence[BaselineRun]) -> Page:
    """Tables, sentences and the figure of lines of the protocols `sizes` and `depth`."""
    lines = sorted(lines, key=lambda line: line.place)
    sizes, depth = ([line for line in lines if line.protocol == part] for part in ("sizes", "depth"))
    rungs = {rung: [line for line in sizes if line.rung == rung] for rung in dict.fromkeys(line.rung for line in sizes)}
    kept = {rung: prefer_at_once(own) for rung, own in rungs.items()}
    cells = {rung: _group((line.agent, _count_rooms(line), line) for line in own) for rung, own in kept.items()}
    deeper = prefer_at_once(depth)
    transfers = read_transfers([line for line in lines if line.protocol == "transfer"])
    return Page({
        "rungs": {rung: _describe_both(own) | {
            "ends": _summarise(kept[rung]), "table": _tabulate_sizes(kept[rung]),
            "best": tell_best(cells[rung], tuple(NAMES)),
            "told": tell_room_numbers(cells[rung], tuple(NAMES), _CHANCES)} for rung, own in rungs.items()},
        "depth": _describe_both(depth) | {
            "table": _tabulate_depths(deeper),
            "told": tell_puzzle_depths(_group((line.agent, line.rung, line) for line in deeper), tuple(NAMES),
                                       CHANCE)} if depth else None,
        "advice": " ".join(dict.fromkeys(
            advice for own in cells.values() if (advice := advise(own, MEMORY, OBJECTS)))),
        "transfers": {"told": tell_transfers(transfers), "table": tabulate_transfers(transfers), **_describe(
            [line for line in lines if line.protocol == "transfer" and line.primitives])} if transfers else None,
        "trained": TRAINED, "own": GeneralisationArgs.primitives, "streams": STREAMS,
    }, ({"generalisation": draw_sizes(kept)} if sizes else {})
        | ({"transfer": draw_transfers(transfers)} if transfers else {}))


def _group(lines: Iterable[tuple[str, _Key, BaselineRun]]) -> dict[tuple[str, _Key], list[BaselineRun]]:
    """Runs by agent and a second key."""
    cells: dict[tuple[str, _Key], list[BaselineRun]] = {}
    for agent, key, line in lines:
        cells.setdefault((agent, key), []).append(line)
    return cells


def _describe_both(lines: Sequence[BaselineRun]) -> dict[str, Any]:
    """Numbers of the runs that are told, all of one rung or of the part `depth`.

    Besides, those of learners from many rooms at once, and those of all others; None where there are none.
    """
    parts = dict(zip(("at_once", "alone"), split_at_once(lines), strict=True))
    return _describe(prefer_at_once(lines)) | {name: _describe(own) if own else None for name, own in parts.items()}


def _describe(lines: Sequence[BaselineRun]) -> dict[str, Any]:
    cells = Counter((line.agent, line.rung, line.rooms) for line in lines if line.primitives)
    return {
        "count": len(lines), "fewest": min(cells.values(), default=0), "most": max(cells.values(), default=0),
        "budgets": sorted({line.primitives for line in lines if line.primitives}),
        "episodes": max(line.episodes for line in lines), "runs": 1 + max(line.seed for line in lines),
        "primitives": max(line.primitives for line in lines), "rooms": lines[0].episodes,
    }


def _summarise(lines: Sequence[BaselineRun]) -> dict[str, dict[int, float]]:
    """Efficiency of each learner, by name, with the fewest and the most training rooms."""
    found = {}
    for agent, name in NAMES.items():
        own = [line for line in lines if line.agent == agent]
        counts = sorted(map(_count_rooms, own))
        if own:
            found[name] = {count: _average([line.efficiency for line in own if _count_rooms(line) == count])
                           for count in (counts[0], counts[-1])}
    return found


def _tabulate_sizes(lines: Sequence[BaselineRun]) -> str:
    counts = sorted(set(map(_count_rooms, lines)))
    agents = {line.agent for line in lines}
    rows = []
    for agent in [*(agent for agent in NAMES if agent in agents), *sorted(agents - set(NAMES))]:
        cells = []
        for count in counts:
            own = [line for line in lines if line.agent == agent and _count_rooms(line) == count]
            seen = [line.seen for line in own if line.seen is not None]
            cells.append(_format_cell(own) + (f" ({_average(seen):.2f})" if seen else ""))
        rows.append([f"`{agent}`", *cells])
    return make_table(["agent", *(f"{count:,}" for count in counts)], rows)


def _tabulate_depths(lines: Sequence[BaselineRun]) -> str:
    rows = []
    for agent in dict.fromkeys(line.agent for line in lines):
        own = [line for line in lines if line.agent == agent]
        seen = [line.seen for line in own if line.seen is not None]
        rows.append([f"`{agent}`", *(_format_cell([line for line in own if line.rung == name]) for name in DEPTHS),
                     f"{_average(seen):.2f}" if seen else "-"])
    return make_table(["agent", *DEPTHS, "rooms trained in"], rows)


def _format_cell(lines: Sequence[BaselineRun]) -> str:
    """Mean efficiency in unseen rooms, bold where it is of many seeds."""
    mean = f"{_average([line.efficiency for line in lines]):.2f}"
    return "-" if not lines else f"**{mean}**" if len(lines) >= LEAST_RUNS else mean


def draw_sizes(rungs: Mapping[str, Sequence[BaselineRun]]) -> Figure:
    """Efficiency against training rooms, a panel a rung, from the runs of each.

    Solid in unseen rooms, dotted in rooms trained in; dots are runs, those of different agents side by side.
    """
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(2.8 + 3.6 * len(rungs), 3.6), facecolor=palette.BACKGROUND, layout="constrained")
        panels = figure.subplots(1, len(rungs), squeeze=False)[0]
        for axes, (rung, lines) in zip(panels, rungs.items(), strict=True):
            _draw_panel(axes, lines)
            axes.set_title(rung, fontsize=9, color=palette.INK)
        panels[0].set_ylabel("efficiency", color=palette.INK)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside right center", fontsize=8, frameon=False)
    return figure


def _draw_panel(axes: Axes, lines: Sequence[BaselineRun]) -> None:
    """Curves of one rung."""
    agents = [agent for agent in NAMES if any(line.agent == agent for line in lines)]
    for number, agent in enumerate(agents):
        own = [line for line in lines if line.agent == agent]
        counts = sorted(set(map(_count_rooms, own)))
        unseen = [_average([line.efficiency for line in own if _count_rooms(line) == count]) for count in counts]
        seen = [_average([line.seen or 0.0 for line in own if _count_rooms(line) == count]) for count in counts]
        axes.plot(counts, unseen, color=_COLOURS[agent], marker="o", markersize=4, linewidth=1.5, label=NAMES[agent])
        axes.plot(counts, seen, color=_COLOURS[agent], linestyle=":", linewidth=1)
        shift = 1.1 ** (number - (len(agents) - 1) / 2)
        axes.scatter([shift * _count_rooms(line) for line in own], [line.efficiency for line in own],
                     color=_COLOURS[agent], s=8, alpha=0.5, linewidths=0)
    beside = {CHANCE: "options, at random"} | SEARCH_BASELINES | CEILING
    for (agent, name), style in zip(beside.items(), ("--", "-.", ":", "-"), strict=True):
        values = [line.efficiency for line in lines if line.agent == agent]
        if values:
            axes.axhline(_average(values), color=palette.MUTED, linestyle=style, linewidth=1, label=name)
    axes.set_xscale("log")
    axes.set_ylim(-0.03, 1.03)
    axes.set_xlabel("training rooms", color=palette.INK)
    finish_axes(axes)
    counts = sorted(set(map(_count_rooms, lines)))
    axes.set_xticks(counts, [f"{count:,}" for count in counts])
    axes.minorticks_off()


def _count_rooms(line: BaselineRun) -> int:
    found = re.search(r"train#0\.\.(\d+)", line.rooms)
    assert found is not None
    return int(found[1])


def _average(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else float("nan")
