"""The page of the study of generalisation, with its figure, from the lines of its runs alone."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from hrl_escape.env.drawing import palette
from hrl_escape.env.drawing.maps import save_figure
from hrl_escape.experiments.baselines.generalisation import DEPTHS, FLAT, MEMORY, OBJECTS, VECTORS
from hrl_escape.experiments.baselines.lines import LEAST_RUNS, BaselineRun
from hrl_escape.experiments.studies.paper_figures import FIGURE_STYLE, finish_axes
from hrl_escape.files import write_text
from hrl_escape.names import join_words

__all__ = ["draw_sizes", "write_generalisation_page"]

_NAMES = {FLAT: "primitives", VECTORS: "options, a vector", OBJECTS: "options, objects",
          MEMORY: "options, objects, memory"}
_COLOURS = dict(zip(_NAMES, ("#777777", "#0072b2", "#e69f00", "#d55e00"), strict=True))
_COMMAND = "hrl-escape experiment generalisation"


def write_generalisation_page(lines: Sequence[BaselineRun], docs: Path) -> None:
    """Write the page and its figure.

    Args:
        lines: runs of the protocols `sizes` and `depth`, at least one.
        docs: folder of the page.

    Raises:
        FileWriteError: a file cannot be written.
    """
    sizes = [line for line in lines if line.protocol == "sizes"]
    depth = [line for line in lines if line.protocol == "depth"]
    text = ["# Generalisation", ""]
    if sizes:
        save_figure(docs / "figures" / "generalisation.svg", draw_sizes(sizes))
        text += [_summarise(sizes), "", "![Efficiency against training rooms](figures/generalisation.svg)", "",
                 _describe(sizes), "", *_tabulate_sizes(sizes), ""]
    text += ["## Deeper than trained", ""]
    text += [_describe(depth), "", *_tabulate_depths(depth)] if depth else ["Not run yet."]
    text += ["", "```console", _make_command(sizes or depth), "```", "",
             "Every run is a line of `raw/generalisation.jsonl`.", ""]
    write_text(docs / "generalisation.md", "\n".join(text))


def _make_command(lines: Sequence[BaselineRun]) -> str:
    """The command line that makes these runs."""
    first = lines[0]
    part = f" --part sizes --rung {first.rung}" if first.protocol == "sizes" else " --part depth"
    return (f"{_COMMAND}{part} --primitives {max(line.primitives for line in lines)} --rooms {first.episodes} "
            f"--runs {1 + max(line.seed for line in lines)}")


def draw_sizes(lines: Sequence[BaselineRun]) -> Figure:
    """Efficiency against training rooms: solid in unseen rooms, dotted in rooms trained in; dots are runs."""
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(6.4, 3.6), facecolor=palette.BACKGROUND, layout="constrained")
        axes = figure.subplots()
        for agent, name in _NAMES.items():
            own = [line for line in lines if line.agent == agent]
            counts = sorted(set(map(_count_rooms, own)))
            unseen = [_average([line.efficiency for line in own if _count_rooms(line) == count]) for count in counts]
            seen = [_average([line.seen or 0.0 for line in own if _count_rooms(line) == count]) for count in counts]
            axes.plot(counts, unseen, color=_COLOURS[agent], marker="o", markersize=4, linewidth=1.5, label=name)
            axes.plot(counts, seen, color=_COLOURS[agent], linestyle=":", linewidth=1)
            axes.scatter([_count_rooms(line) for line in own], [line.efficiency for line in own],
                         color=_COLOURS[agent], s=8, alpha=0.5)
        chance = [line.efficiency for line in lines if line.agent not in _NAMES]
        if chance:
            axes.axhline(_average(chance), color=palette.MUTED, linestyle="--", linewidth=1, label="chance")
        axes.set_xscale("log")
        axes.set_ylim(-0.03, 1.03)
        axes.set_xlabel("training rooms", color=palette.INK)
        axes.set_ylabel("efficiency in unseen rooms", color=palette.INK)
        finish_axes(axes)
        counts = sorted(set(map(_count_rooms, lines)))
        axes.set_xticks(counts, [f"{count:,}" for count in counts])
        axes.minorticks_off()
        axes.legend(fontsize=8, frameon=False)
    return figure


def _count_rooms(line: BaselineRun) -> int:
    found = re.search(r"train\[:(\d+)\]", line.rooms)
    assert found is not None
    return int(found[1])


def _average(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else float("nan")


def _describe(lines: Sequence[BaselineRun]) -> str:
    budgets = sorted({line.primitives for line in lines if line.primitives})
    seeds, episodes = len({line.seed for line in lines}), max(line.episodes for line in lines)
    few = f" Nothing is concluded from fewer than {LEAST_RUNS} seeds." if seeds < LEAST_RUNS else ""
    return (f"{len(lines)} runs: {seeds} training {'seed' if seeds == 1 else 'seeds'}, "
            f"{join_words(f'{budget:,}' for budget in budgets)} primitives, tested in {episodes} rooms "
            f"that no run was trained in.{few}")


def _summarise(lines: Sequence[BaselineRun]) -> str:
    """Efficiency of each agent with the fewest and the most training rooms."""
    words = []
    for agent, name in _NAMES.items():
        own = [line for line in lines if line.agent == agent]
        if not own:
            continue
        ends = sorted({min(map(_count_rooms, own)), max(map(_count_rooms, own))})
        words.append(f"{name} " + " and ".join(
            f"{_average([line.efficiency for line in own if _count_rooms(line) == count]):.2f} with {count:,}"
            for count in ends))
    return f"**Efficiency in unseen rooms of `{lines[0].rung}` by training rooms: {'; '.join(words)}.**"


def _tabulate_sizes(lines: Sequence[BaselineRun]) -> list[str]:
    counts = sorted(set(map(_count_rooms, lines)))
    rows = ["| agent | " + " | ".join(f"{count:,}" for count in counts) + " |", "|---" * (len(counts) + 1) + "|"]
    for agent in [*_NAMES, *sorted({line.agent for line in lines} - set(_NAMES))]:
        cells = []
        for count in counts:
            own = [line for line in lines if line.agent == agent and _count_rooms(line) == count]
            seen = [line.seen for line in own if line.seen is not None]
            cells.append(f"{_average([line.efficiency for line in own]):.2f} ({_average(seen):.2f})" if own else "-")
        rows.append(f"| `{agent}` | " + " | ".join(cells) + " |")
    return [*rows, "", "In brackets: the efficiency at the end in rooms that were trained in."]


def _tabulate_depths(lines: Sequence[BaselineRun]) -> list[str]:
    rows = ["| agent | " + " | ".join(DEPTHS) + " | rooms trained in |", "|---" * (len(DEPTHS) + 2) + "|"]
    for agent in dict.fromkeys(line.agent for line in lines):
        own = [line for line in lines if line.agent == agent]
        by_name = [[line.efficiency for line in own if line.rung == name] for name in DEPTHS]
        cells = [f"{_average(values):.2f}" if values else "-" for values in by_name]
        seen = [line.seen for line in own if line.seen is not None]
        rows.append(f"| `{agent}` | {' | '.join(cells)} | {f'{_average(seen):.2f}' if seen else '-'} |")
    return rows
