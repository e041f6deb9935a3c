"""Tables and figures of learned options at scale. Curves and medians are of cells with all of their rooms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hrl_escape.names import count_nouns
from studies.crossover.analysis import Ratio
from studies.figures import Theme, make_figure, mark_counts, write_key
from studies.learned_options.answers import Cells, Gain, Times
from studies.learned_options.runs import TRIAL, Learner, ScaleRun
from studies.statistics import compute_median_interval
from studies.tables import format_interval, format_short, make_table

__all__ = ["SHOWN", "draw_curves", "draw_escapes", "tabulate_cells", "tabulate_gains", "tabulate_missing",
           "tabulate_rates", "tabulate_reuse", "tabulate_trials"]

SHOWN = ("ppo", "dqn, novelty", "dac", "ppoc", "a2oc")
"""Agents shown in the figures: PPO, the best flat agent of the first comparisons, and all that learn options."""


def tabulate_cells(sizes: Mapping[int, Cells], learners: Mapping[str, Learner], least: int) -> str:
    """Each cell with runs: rooms, escapes, first escapes and late efficiency.

    A cell with fewer rooms than a comparison needs has no median.
    """
    rows = []
    for buttons, cells in sizes.items():
        for label, learner in learners.items():
            runs = list(cells.get(label, {}).values())
            if not runs:
                continue
            median, low, high = compute_median_interval([run.first_escape or np.inf for run in runs])
            late = [run.late for run in runs if run.episodes]
            first = f"{median:,.0f} ({low:,.0f} to {high:,.0f})".replace("inf", "never") if len(runs) >= least else ""
            rows.append([buttons, learner.title, f"{runs[0].budget:,}", len(runs),
                         sum(run.first_escape is not None for run in runs), first,
                         f"{np.mean(late):.2f} ({min(late):.2f} to {max(late):.2f})" if late else ""])
    return make_table(["buttons", "learner", "primitives", "rooms", "escaped", "first escape, median",
                       "late efficiency, mean (lowest to highest)"], rows)


def tabulate_gains(gains: Mapping[tuple[int, str], Gain], learners: Mapping[str, Learner]) -> str:
    """Comparisons with the best flat learner of each size."""
    return make_table(["buttons", "learner", "best flat", "rooms", "late efficiency", "p, Holm", "first escape, ratio",
                       "credit, ratio", "answer"], [
        [buttons, learners[label].title, learners[gain.flat].title, gain.rooms, format_interval(gain.late, "+.2f"),
         f"{gain.late.p:.3f}", *map(_describe, gain.times), gain.verdict]
        for (buttons, label), gain in gains.items()])


def tabulate_reuse(reuse: Mapping[int, Times]) -> str:
    """Times with options of training rooms, over those with options that are learned anew."""
    return make_table(["buttons", "rooms", "first escape, ratio", "credit, ratio"], [
        [buttons, times.first.rooms, *map(_describe, times)] for buttons, times in reuse.items()])


def _describe(ratio: Ratio) -> str:
    return f"{format_short(ratio.value)} ({format_short(ratio.low)} to {format_short(ratio.high)})"


def tabulate_missing(data: Mapping[str, Any], jobs: Sequence[ScaleRun], known: set[tuple[Any, ...]]) -> str:
    """Runs that are there, of those registered, by block and learner."""
    titles = {table["label"]: table["title"] for table in data["learners"]}
    counts: dict[tuple[Any, ...], dict[int, list[int]]] = {}
    for job in jobs:
        is_fresh = job.seed >= data["slices"]["confirmation"]
        cell = titles[job.agent], job.part, job.buttons, job.rule, "confirmation" if is_fresh else "first"
        own = counts.setdefault(cell, {}).setdefault(data["budgets"].index(max(job.budget, data["budgets"][0])), [0, 0])
        own[0] += job.place in known
        own[1] += 1
    return make_table(["learner", "part", "buttons", "wrong press", "rooms", *(
        f"{budget:,} primitives" for budget in data["budgets"])], [
        [cell[0], cell[1], cell[2], f"`{cell[3]}`", cell[4], *(
            "{} of {}".format(*own[stage]) if stage in own else "" for stage in range(len(data["budgets"])))]
        for cell, own in counts.items()])


def tabulate_rates(learners: Mapping[str, Learner], lines: Sequence[ScaleRun], left_out: Sequence[Mapping[str, str]]
                   ) -> str:
    """Primitives a second of processor time, median over all runs, and the agents left out with their reasons."""
    rows = []
    for label, learner in learners.items():
        rates = [line.primitives / line.seconds for line in lines if line.agent == label and line.seconds]
        rows.append([learner.title, f"`{label}`", learner.copies if learner.agent != "archive" else 1, len(rates),
                     f"{np.median(rates):,.0f}" if rates else ""])
    return make_table(["learner", "label", "copies of a room", "runs", "primitives a second"], [
        *rows, *([table["title"], "left out", "", 0, table["reason"]] for table in left_out)])


def tabulate_trials(lines: Sequence[ScaleRun], data: Mapping[str, Any], learners: Mapping[str, Learner],
                    choices: Mapping[str, int]) -> str:
    """Trials of settings; the chosen one is bold."""
    rows = []
    for line in sorted((line for line in lines if line.part == TRIAL),
                       key=lambda line: (list(learners).index(line.agent), line.choice)):
        learner = learners[line.agent]
        settings = ", ".join(f"{name} {value:g}" for name, value in data["menus"][learner.menu][line.choice].items())
        mark = "**" if choices[line.agent] == line.choice else ""
        rows.append([learner.title, f"{mark}{settings}{mark}",
                     "never" if line.first_escape is None else f"{line.first_escape:,}", f"{line.late:.2f}"])
    return make_table(["learner", "settings", "first escape", "late efficiency"], rows)


def draw_curves(sizes: Mapping[int, Cells], learners: Mapping[str, Learner], least: int, theme: Theme) -> Figure:
    """Mean efficiency of training episodes against primitives, a panel a size, of cells with all of their rooms."""
    counts = [buttons for buttons in sizes if buttons <= 3]

    def paint(panels: Any) -> None:
        for axes, buttons in zip(panels, counts, strict=True):
            for label, colour in zip(SHOWN, theme.lines, strict=True):
                runs = list(sizes[buttons].get(label, {}).values())
                if len(runs) >= least:
                    parts = np.array([[np.nan if worth is None else worth for worth in run.curve] for run in runs])
                    ends = (np.arange(parts.shape[1]) + 1) / parts.shape[1] * runs[0].budget
                    seen = np.isfinite(parts).any(axis=0)
                    axes.plot(ends[seen], np.nanmean(parts[:, seen], axis=0), color=colour, linewidth=2)
            if not axes.lines:
                axes.text(0.5, 0.5, f"no cell with {least} rooms yet", transform=axes.transAxes, ha="center",
                          color=theme.muted)
            axes.set(ylabel=f"efficiency, {count_nouns(buttons, 'button')}", ylim=(0, 1))
            mark_counts(axes.xaxis)
        write_key(panels[0], [(learners[label].title, colour) for label, colour in
                              zip(SHOWN, theme.lines, strict=True)])
        panels[-1].set_xlabel("primitives of all copies")

    return make_figure(theme, paint, height=6.4, nrows=len(counts), sharex=True)


def draw_escapes(sizes: Mapping[int, Cells], learners: Mapping[str, Learner], least: int, theme: Theme) -> Figure:
    """Median primitives to the first escape against the number of buttons, of cells with all of their rooms."""

    def paint(axes: Axes) -> None:
        for label, colour in zip(SHOWN, theme.lines, strict=True):
            medians = {buttons: float(np.median([run.first_escape or np.inf for run in cells[label].values()]))
                       for buttons, cells in sizes.items() if len(cells.get(label, ())) >= least}
            axes.plot(list(medians), list(medians.values()), "o-", color=colour, linewidth=1.6)
        write_key(axes, [(learners[label].title, colour) for label, colour in zip(SHOWN, theme.lines, strict=True)])
        axes.set(xlabel="buttons", ylabel="primitives to the first escape", yscale="log", xticks=list(sizes),
                 ylim=(1_000, 100_000))
        mark_counts(axes.yaxis)

    return make_figure(theme, paint, height=4.4)
