"""Generalisation: efficiency by number of training rooms, in deeper puzzles, and in other rungs than trained in."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.errors import ComparisonError
from hrl_escape.files import read_toml
from studies.baseline import BaselineRun
from studies.figures import Theme, make_figure, write_label
from studies.ladder.calibration import CHANCE
from studies.statistics import Difference, compare_strata
from studies.study import Findings, Study
from studies.tables import format_interval, make_table

__all__ = ["AT_ONCE", "CEILING", "DEPTHS", "FLAT", "MEMORY", "OBJECTS", "SEARCH_BASELINES", "TRANSFER", "VECTORS",
           "analyse", "compare_cells", "prefer_at_once"]

_DATA = read_toml(Path(__file__).with_name("study.toml"))
DEPTHS: dict[str, dict[str, Any]] = _DATA["depths"]
TRANSFER: tuple[str, ...] = tuple(_DATA["transfer"])
NAMES: dict[str, str] = _DATA["names"]
FLAT, VECTORS, OBJECTS, MEMORY = NAMES
AT_ONCE = ", many rooms at once"
"""End of the labels of agents that learn from many rooms at once."""
SEARCH_BASELINES: dict[str, str] = _DATA["searchers"]
CEILING: dict[str, str] = _DATA["ceiling"]

Cells = Mapping[tuple[str, Any], Mapping[int, float]]
"""Efficiency by training seed, by agent and number of training rooms or kind of room tested in."""


def prefer_at_once(lines: Sequence[BaselineRun]) -> list[BaselineRun]:
    """Lines of a part, of each learner those from many rooms at once where there are any, by its own label."""
    at_once = [dataclasses.replace(line, agent=line.agent.removesuffix(AT_ONCE)) for line in lines
               if line.agent.endswith(AT_ONCE)]
    there = {(line.rung, line.agent) for line in at_once}
    alone = [line for line in lines if not line.agent.endswith(AT_ONCE) and (line.rung, line.agent) not in there]
    return sorted([*at_once, *alone], key=lambda line: line.place)


def compare_cells(cells: Cells, questions: Mapping[str, tuple[tuple[str, Any], tuple[str, Any]]]
                  ) -> dict[str, Difference]:
    """Compare pairs of cells by training seed, as one family (Student's t, Holm).

    Raises:
        ComparisonError: a cell has no run.
    """
    gaps = []
    for first, second in questions.values():
        if missing := [cell for cell in (first, second) if cell not in cells]:
            raise ComparisonError(f"there is no run of {missing[0]}")
        seeds = sorted(cells[first].keys() & cells[second].keys())
        gaps.append([np.array([cells[first][seed] - cells[second][seed] for seed in seeds])])
    return dict(zip(questions, compare_strata(gaps), strict=True))


def analyse(study: Study, lines: Sequence[BaselineRun]) -> Findings:
    """Mean efficiency in unseen rooms, and what memory and more training rooms add.

    Raises:
        ComparisonError: runs are missing.
    """
    rung = study.data["shown"]
    parts = {part: [line for line in lines if line.protocol == part] for part in ("sizes", "depth", "transfer")}
    sizes = prefer_at_once([line for line in parts["sizes"] if line.rung == rung])
    seen = _group((line.agent, _count_rooms(line), line.seed, line.seen) for line in sizes if line.seen is not None)
    cells = _group((line.agent, _count_rooms(line), line.seed, line.efficiency) for line in sizes)
    depths = _group((line.agent, line.rung, line.seed, line.efficiency) for line in prefer_at_once(parts["depth"]))
    counts = sorted({count for _, count in cells})
    most = max(count for agent, count in cells if agent == MEMORY)
    gains = compare_cells(cells, {"memory": ((MEMORY, most), (OBJECTS, most)),
                                  "rooms": ((MEMORY, most), (MEMORY, counts[0]))})
    across = {(_read_source(line), line.rung, line.seed): line.efficiency
              for line in parts["transfer"] if line.primitives}
    learned = {(source, target): float(np.mean([value for (*pair, _), value in across.items()
                                                if pair == [source, target]]))
               for source in TRANSFER for target in TRANSFER}
    known = {(line.agent, line.rung): line.efficiency for line in parts["transfer"] if not line.primitives}
    search = {target: max(known[name, target] for name in SEARCH_BASELINES) for target in TRANSFER}
    bayes = {target: known[name, target] for name in CEILING for target in TRANSFER}
    means = {cell: float(np.mean([*own.values()])) for cell, own in cells.items()}
    deep = {cell: float(np.mean([*own.values()])) for cell, own in depths.items()}
    return Findings(
        SimpleNamespace(means=means, depths=deep, gains=gains, search=search, bayes=bayes, most=most,
                        seeds=len(cells[MEMORY, most]), rooms=sizes[0].episodes, data=study.data),
        {"sizes": make_table(["agent", *(f"{count:,}" for count in counts)], [
            [_title(agent), *(_format(means, seen, agent, count) for count in counts)]
            for agent in dict.fromkeys([*NAMES, *SEARCH_BASELINES, *CEILING, CHANCE, *(name for name, _ in cells)])
            if any(agent == other for other, _ in cells)]),
         "memory": make_table(["question", "gain"], [
             [f"with memory, {most:,} training rooms, against the same without memory",
              format_interval(gains["memory"], "+.2f")],
             [f"with memory, {most:,} training rooms against {counts[0]}", format_interval(gains["rooms"], "+.2f")]]),
         "depths": make_table(["agent", *DEPTHS], [
             [_title(agent), *(f"{deep[agent, kind]:.2f}" if (agent, kind) in deep else "" for kind in DEPTHS)]
             for agent in dict.fromkeys(agent for agent, _ in depths)]),
         "transfer": make_table(["", *(f"`{target}`" for target in TRANSFER)], [
             *([f"trained in `{source}`", *(f"{learned[source, target]:.2f}" for target in TRANSFER)]
               for source in TRANSFER),
             ["search baseline", *(f"{search[target]:.2f}" for target in TRANSFER)],
             ["Bayes planner", *(f"{bayes[target]:.2f}" for target in TRANSFER)]])},
        {"generalisation": lambda theme: draw(cells, means, theme)})


def _group(lines: Any) -> dict[tuple[str, Any], dict[int, float]]:
    cells: dict[tuple[str, Any], dict[int, float]] = {}
    for agent, key, seed, value in lines:
        cells.setdefault((agent, key), {})[seed] = value
    return cells


def _title(agent: str) -> str:
    return NAMES[agent] if agent in NAMES else AgentSpec.parse(agent).title


def _format(means: Mapping[tuple[str, int], float], seen: Cells, agent: str, count: int) -> str:
    if (agent, count) not in means:
        return ""
    known = seen.get((agent, count))
    return f"{means[agent, count]:.2f}" + (f" ({np.mean([*known.values()]):.2f})" if known else "")


def _read_source(line: BaselineRun) -> str:
    """Rung that a run was trained in."""
    return line.rooms.split("/train")[0].rpartition("/")[2]


def _count_rooms(line: BaselineRun) -> int:
    found = re.search(r"train#0\.\.(\d+)", line.rooms)
    assert found is not None
    return int(found[1])


def draw(cells: Cells, means: Mapping[tuple[str, int], float], theme: Theme) -> Figure:
    """Draw the efficiency in unseen rooms against the number of training rooms; dots are runs."""
    heights = {MEMORY: 0.73, OBJECTS: 0.36}

    def draw_axes(axes: Axes) -> None:
        for agent, name, colour in zip(NAMES, NAMES.values(), (theme.lines[3], theme.lines[2], theme.lines[1],
                                                               theme.lines[0]), strict=True):
            own = {count: middle for (other, count), middle in sorted(means.items()) if other == agent}
            for count in own:
                runs = [*cells[agent, count].values()]
                axes.plot([count] * len(runs), runs, ".", color=colour, alpha=0.35, markersize=5)
            axes.plot(list(own), list(own.values()), "o-", color=colour, linewidth=2.2, markersize=4)
            place = (max(own) / 1.2, 0.04) if len(own) == 1 else (5 if agent == MEMORY else 1.15,
                                                                  heights.get(agent, 0.07))
            write_label(axes, *place, name, colour, ha="right" if len(own) == 1 else "left")
        search = max(means[agent, count] for agent, count in means if agent in SEARCH_BASELINES)
        axes.axhline(search, color=theme.muted, linestyle="--", linewidth=1.6)
        write_label(axes, 1.15, search + 0.05, "search baseline", theme.muted)
        counts = sorted({count for _, count in means})
        axes.set(xscale="log", ylim=(-0.03, 1.0), xlabel="training rooms", ylabel="efficiency in unseen rooms")
        axes.set_xticks(counts, [f"{count:,}" for count in counts])
        axes.minorticks_off()

    return make_figure(theme, draw_axes)
