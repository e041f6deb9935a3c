"""The league of flat learners: settings chosen by equal trials, first escapes and efficiency by number of buttons."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from hrl_escape.comparison.statistics import LEAST_RUNS
from hrl_escape.env.drawing import palette
from hrl_escape.errors import ComparisonError
from hrl_escape.names import count_nouns, join_words
from hrl_escape.settings import read_record
from studies.figures import FIGURE_STYLE, finish_axes
from studies.flat import FlatArgs, FlatLearner, FlatRun, list_learners, measure_flat_runs
from studies.page import make_table
from studies.price.contestants import sample_replicate_room
from studies.store import Store
from studies.study import Page, Study

__all__ = ["LINES", "Args", "analyse", "choose_candidate", "measure", "tell_league"]

LINES = (FlatRun,)


@dataclasses.dataclass(frozen=True)
class Args(FlatArgs):
    """Options of the league."""

    sizes: tuple[int, ...] = ()
    """Numbers of buttons; those of `study.toml` by default."""
    trials: bool = False
    """Run the trials of all candidate settings instead of the league; it takes its settings from them."""


def measure(study: Study, args: Args, store: Store) -> None:
    """Make trials, or the runs of the league that are missing.

    Raises:
        ComparisonError: a learner's trials were not made.
    """
    data, plan = study.data, study.data["trials"]
    if args.trials:
        measure_flat_runs(store, [
            (candidate, sample_replicate_room(plan["buttons"], seed), seed, plan["budget"], plan["eval_every"])
            for seed in plan["seeds"] for learner in list_learners(study, args)
            for candidate in list_candidates(study, learner.label)], args.minutes)
        return
    lines = store.load()
    chosen = [choose_candidate(study, lines, learner.label) for learner in list_learners(study, args)]
    measure_flat_runs(store, [
        (learner, sample_replicate_room(size, seed), seed, data["budget"], data["eval_every"])
        for size in args.sizes or data["sizes"]
        for seed in range(args.first_seed, args.first_seed + (args.runs or data["runs"])) for learner in chosen],
        args.minutes)


def list_candidates(study: Study, label: str) -> Iterator[FlatLearner]:
    """Candidates of a learner, labelled by their number."""
    (table,) = (dict(table) for table in study.data["learners"] if table["label"] == label)
    for number, candidate in enumerate(table.pop("candidates"), 1):
        yield read_record(FlatLearner, table | {"label": f"{label} / {number}",
                                                "settings": table["settings"] | candidate})


def choose_candidate(study: Study, lines: Sequence[FlatRun], label: str) -> FlatLearner:
    """The candidate that was most efficient in the trials, of equals the one that escaped first, under its own label.

    Raises:
        ComparisonError: a trial is missing.
    """
    def rate(candidate: FlatLearner) -> tuple[float, float]:
        own = [run for run in lines if run.agent == candidate.label]
        if len(own) < len(study.data["trials"]["seeds"]):
            made = count_nouns(len(own), "trial")
            raise ComparisonError(f"{candidate.label} has {made}: run {study.command} --trials")
        return (-float(np.mean([run.efficiency for run in own])),
                float(np.mean([run.first_escape or run.budget for run in own])))

    return dataclasses.replace(min(list_candidates(study, label), key=rate), label=label)


# --- page ------------------------------------------------------------------------------------


def tell_league(cells: Mapping[tuple[str, int], Sequence[FlatRun]], sizes: Sequence[int], least: float, budget: int
                ) -> str:
    """One sentence: who is efficient in most runs with how many buttons, by cells of `LEAST_RUNS` runs or more."""
    parts = []
    for size in sizes:
        own = {label: runs for (label, buttons), runs in cells.items() if buttons == size and len(runs) >= LEAST_RUNS}
        if not own:
            continue
        arrived = [f"`{label}`" for label, runs in own.items()
                   if 2 * sum(run.find_threshold(least) is not None for run in runs) > len(runs)]
        with_ = f"with {count_nouns(size, 'button')}"
        parts.append(f"{with_} {join_words(arrived)} {'reaches' if len(arrived) == 1 else 'reach'} it" if arrived else
                     f"{with_} none of {len(own)} does")
    if not parts:
        return f"Nothing is concluded, as no learner has {LEAST_RUNS} runs with any number of buttons."
    return f"An efficiency of {least:g} in most runs within {budget:,} primitives: {'; '.join(parts)}."


def analyse(study: Study, lines: Sequence[FlatRun]) -> Page:
    """Sentences, table and figure of the league's runs, and the record of the trials."""
    data = study.data
    labels = [table["label"] for table in data["learners"]]
    cells: dict[tuple[str, int], list[FlatRun]] = {}
    for run in sorted(lines, key=lambda run: run.place):
        if run.agent in labels:
            cells.setdefault((run.agent, run.buttons), []).append(run)
    sizes, budget = data["sizes"], data["budget"]
    there = [label for label in labels if any((label, size) in cells for size in sizes)]
    headline = tell_league(cells, sizes, data["efficient"][-1], budget)
    missing = [f"`{label}` with {join_words(map(str, lacking), 'or')}" for label in labels if (lacking := [
        size for size in sizes if len(cells.get((label, size), ())) < data["runs"]])]
    trials = [run for run in lines if run.agent not in labels]
    return Page({
        "headline": headline, "table": make_table(["learner", *(count_nouns(size, "button") for size in sizes)], [
            [f"`{label}`", *(_describe(cells.get((label, size), ()), data["efficient"]) for size in sizes)]
            for label in there]),
        "missing": missing, "budget": budget, "trials": make_table(
            ["candidate", "settings", "first escape, mean", "efficiency at the end"],
            [_describe_trial(candidate, [run for run in trials if run.agent == candidate.label])
             for label in labels for candidate in list_candidates(study, label)
             if any(run.agent == candidate.label for run in trials)]),
        "count": len(trials), "seconds": sum(run.seconds for own in cells.values() for run in own),
    }, {"league": draw(cells, labels, sizes, budget)}, [headline])


def _describe(runs: Sequence[FlatRun], levels: Sequence[float]) -> str:
    if not runs:
        return "not run"
    first = float(np.median([math.inf if run.first_escape is None else run.first_escape for run in runs]))
    parts = [f"{sum(run.first_escape is not None for run in runs)} of {len(runs)} escape, "
             + ("never in half of them" if math.isinf(first) else f"median {first:,.0f}")]
    for level in levels:
        at = [place for run in runs if (place := run.find_threshold(level)) is not None]
        parts.append(f"{level:g}: {len(at)}" + (f", after {np.median(at):,.0f}" if at else ""))
    return "; ".join(parts)


def _describe_trial(candidate: FlatLearner, runs: Sequence[FlatRun]) -> list[Any]:
    settings = ", ".join(f"{name} = {value}" for name, value in candidate.settings.items())
    return [candidate.label, settings, f"{np.mean([run.first_escape or run.budget for run in runs]):,.0f}",
            f"{np.mean([run.efficiency for run in runs]):.2f}"]


def draw(cells: Mapping[tuple[str, int], Sequence[FlatRun]], labels: Sequence[str], sizes: Sequence[int], budget: int
         ) -> Figure:
    """First escapes (dots) and the first efficient evaluation (diamonds) of every run; a panel a number of buttons."""
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(9.2, 1.2 + 0.42 * max(1, len(labels))), facecolor=palette.BACKGROUND,
                        layout="constrained")
        for axes, size in zip(figure.subplots(1, len(sizes), sharey=True, squeeze=False)[0], sizes, strict=True):
            for at, label in enumerate(labels[::-1]):
                own = cells.get((label, size), ())
                for mark, shift, times in (("o", 0.14, [run.first_escape for run in own]),
                                           ("D", -0.14, [run.find_threshold(0.9) for run in own])):
                    known = [time for time in times if time]
                    axes.plot(known, [at + shift] * len(known), mark, markersize=4.5, alpha=0.6, markeredgewidth=0,
                              color=palette.LINES[at % len(palette.LINES)])
                if not own:
                    axes.text(0.5, at, "not run", transform=axes.get_yaxis_transform(), color=palette.MUTED,
                              ha="center", va="center", fontsize=8)
            finish_axes(axes)
            axes.set_xscale("log")
            axes.set_xlim(100, 1.5 * budget)
            axes.axvline(budget, color=palette.MUTED, linestyle=":", linewidth=1)
            axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
            axes.set_yticks(range(len(labels)), labels[::-1])
            axes.set_title(count_nouns(size, "button"), fontsize=9, loc="left", color=palette.INK)
            axes.set_xlabel("primitives", color=palette.INK)
    return figure
