"""The page of the study of generalisation, with its figure, from the lines of its runs alone."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hrl_escape.comparison.baselines.calibration import CHANCE
from hrl_escape.comparison.baselines.generalisation import (
    DEPTHS,
    FLAT,
    FLAT_CHANCE,
    MEMORY,
    OBJECTS,
    TRAINED,
    VECTORS,
    GeneralisationArgs,
)
from hrl_escape.comparison.baselines.generalisation_findings import tell_puzzle_depths, tell_room_numbers
from hrl_escape.comparison.baselines.lines import LEAST_RUNS, BaselineRun
from hrl_escape.comparison.studies.paper_figures import FIGURE_STYLE, finish_axes
from hrl_escape.env.drawing import palette
from hrl_escape.env.drawing.maps import save_figure
from hrl_escape.files import write_text
from hrl_escape.names import count_nouns, join_words

__all__ = ["draw_sizes", "write_generalisation_page"]

_NAMES = {FLAT: "primitives", VECTORS: "options, a vector", OBJECTS: "options, objects",
          MEMORY: "options, objects, memory"}
_CHANCES = dict.fromkeys(_NAMES, CHANCE) | {FLAT: FLAT_CHANCE}
_COLOURS = dict(zip(_NAMES, ("#777777", "#0072b2", "#e69f00", "#d55e00"), strict=True))
_COMMAND = "hrl-escape experiment generalisation"
_Key = TypeVar("_Key")


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
    rungs = {rung: [line for line in sizes if line.rung == rung] for rung in dict.fromkeys(line.rung for line in sizes)}
    text = ["# Generalisation", ""]
    if sizes:
        save_figure(docs / "figures" / "generalisation.svg", draw_sizes(rungs))
        text += ["![Efficiency against training rooms](figures/generalisation.svg)", "",
                 "Solid: in rooms that no run was trained in. Dotted: in rooms trained in. Dots: single runs, agents "
                 "side by side. Dashed: random choices among the options.", ""]
    for own in rungs.values():
        cells = _group((line.agent, _count_rooms(line), line) for line in own)
        text += [_summarise(own), "", _describe(own), "", *_tabulate_sizes(own), "",
                 *_list(tell_room_numbers(cells, tuple(_NAMES), _CHANCES))]
    text += ["## Deeper than trained", ""]
    if depth:
        told = tell_puzzle_depths(_group((line.agent, line.rung, line) for line in depth), tuple(_NAMES), CHANCE)
        text += [f"Trained in rooms of {TRAINED}. {_describe(depth)}", "", *_tabulate_depths(depth), "", *_list(told)]
    else:
        text += ["Not run yet.", ""]
    commands = [_make_command(own) for own in (*rungs.values(), depth) if own]
    text += ["```console", *commands, "```", "", "Every run is a line of `raw/generalisation.jsonl`.", ""]
    write_text(docs / "generalisation.md", "\n".join(text))


def _group(lines: Iterable[tuple[str, _Key, BaselineRun]]) -> dict[tuple[str, _Key], list[BaselineRun]]:
    """Runs by agent and a second key."""
    cells: dict[tuple[str, _Key], list[BaselineRun]] = {}
    for agent, key, line in lines:
        cells.setdefault((agent, key), []).append(line)
    return cells


def _list(sentences: Sequence[str]) -> list[str]:
    """A list in the text, with what it rests on; nothing without sentences."""
    if not sentences:
        return []
    return [f"Efficiency in unseen rooms, by pairs of runs of the same training seed in cells of {LEAST_RUNS} seeds or "
            "more (Student's t, with Holm's correction; the intervals are of each question alone):", "",
            *(f"- {sentence}" for sentence in sentences), ""]


def _make_command(lines: Sequence[BaselineRun]) -> str:
    """The command line that makes at least these runs, all of one rung or of the part `depth`."""
    first = lines[0]
    part = f" --part sizes --rung {first.rung}" if first.protocol == "sizes" else " --part depth"
    return (f"{_COMMAND}{part} --primitives {max(line.primitives for line in lines)} --rooms {first.episodes} "
            f"--runs {1 + max(line.seed for line in lines)}")


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
    agents = [agent for agent in _NAMES if any(line.agent == agent for line in lines)]
    for number, agent in enumerate(agents):
        own = [line for line in lines if line.agent == agent]
        counts = sorted(set(map(_count_rooms, own)))
        unseen = [_average([line.efficiency for line in own if _count_rooms(line) == count]) for count in counts]
        seen = [_average([line.seen or 0.0 for line in own if _count_rooms(line) == count]) for count in counts]
        axes.plot(counts, unseen, color=_COLOURS[agent], marker="o", markersize=4, linewidth=1.5, label=_NAMES[agent])
        axes.plot(counts, seen, color=_COLOURS[agent], linestyle=":", linewidth=1)
        shift = 1.1 ** (number - (len(agents) - 1) / 2)
        axes.scatter([shift * _count_rooms(line) for line in own], [line.efficiency for line in own],
                     color=_COLOURS[agent], s=8, alpha=0.5, linewidths=0)
    chance = [line.efficiency for line in lines if line.agent == CHANCE]
    if chance:
        axes.axhline(_average(chance), color=palette.MUTED, linestyle="--", linewidth=1, label="options, at random")
    axes.set_xscale("log")
    axes.set_ylim(-0.03, 1.03)
    axes.set_xlabel("training rooms", color=palette.INK)
    finish_axes(axes)
    counts = sorted(set(map(_count_rooms, lines)))
    axes.set_xticks(counts, [f"{count:,}" for count in counts])
    axes.minorticks_off()


def _count_rooms(line: BaselineRun) -> int:
    found = re.search(r"train\[:(\d+)\]", line.rooms)
    assert found is not None
    return int(found[1])


def _average(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else float("nan")


def _describe(lines: Sequence[BaselineRun]) -> str:
    budgets = sorted({line.primitives for line in lines if line.primitives})
    cells = Counter((line.agent, line.rung, line.rooms) for line in lines if line.primitives)
    fewest, most, episodes = min(cells.values()), max(cells.values()), max(line.episodes for line in lines)
    seeds = f"{fewest} to {most} training seeds" if fewest < most else count_nouns(most, "training seed")
    few = f" Nothing is concluded from fewer than {LEAST_RUNS} seeds." if fewest < LEAST_RUNS else ""
    own = GeneralisationArgs().primitives
    less = f" That is less than the budget of the study itself, {own:,}." if max(budgets, default=own) < own else ""
    return (f"{len(lines)} runs: {seeds}, "
            f"{join_words(f'{budget:,}' for budget in budgets)} primitives, tested in {episodes} rooms "
            f"that no run was trained in.{less}{few}")


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
    agents = {line.agent for line in lines}
    for agent in [*(agent for agent in _NAMES if agent in agents), *sorted(agents - set(_NAMES))]:
        cells = []
        for count in counts:
            own = [line for line in lines if line.agent == agent and _count_rooms(line) == count]
            seen = [line.seen for line in own if line.seen is not None]
            cells.append(f"{_format_cell(own)} ({_average(seen):.2f})" if own else "-")
        rows.append(f"| `{agent}` | " + " | ".join(cells) + " |")
    return [*rows, "", "In brackets: the efficiency at the end in rooms that were trained in. Bold: "
            f"{LEAST_RUNS} seeds or more."]


def _tabulate_depths(lines: Sequence[BaselineRun]) -> list[str]:
    rows = ["| agent | " + " | ".join(DEPTHS) + " | rooms trained in |", "|---" * (len(DEPTHS) + 2) + "|"]
    for agent in dict.fromkeys(line.agent for line in lines):
        own = [line for line in lines if line.agent == agent]
        cells = [_format_cell([line for line in own if line.rung == name]) for name in DEPTHS]
        seen = [line.seen for line in own if line.seen is not None]
        rows.append(f"| `{agent}` | {' | '.join(cells)} | {f'{_average(seen):.2f}' if seen else '-'} |")
    return [*rows, "", f"Bold: {LEAST_RUNS} seeds or more."]


def _format_cell(lines: Sequence[BaselineRun]) -> str:
    """Mean efficiency in unseen rooms, bold where it is of many seeds."""
    mean = f"{_average([line.efficiency for line in lines]):.2f}"
    return "-" if not lines else f"**{mean}**" if len(lines) >= LEAST_RUNS else mean
