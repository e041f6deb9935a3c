"""Parts of what options give a learner: exploration with them, credit over their length, planning, and all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullLocator

from hrl_escape.errors import ComparisonError
from hrl_escape.names import count_nouns
from studies.figures import Theme, make_figure, write_label
from studies.price.ratios import COSTS, CostRatio, Middle, compare_costs, correct_prices, measure_growth
from studies.price.runs import PriceRun
from studies.running import open_store
from studies.study import Findings, Study, find_study
from studies.tables import make_table
from studies.titles import find_title

__all__ = ["ESCAPE", "HALF", "LINES", "Pair", "analyse", "compare", "count_alike", "list_families",
           "list_pairs"]

LINES = (PriceRun,)
ESCAPE, HALF = COSTS[1], COSTS[3]
"""Costs of this study: until the first escape, and until a greedy policy of half the efficiency."""
EXPLORES, REPEATS = "options explore", "repeats explore"
AHEAD, RANDOM_AHEAD = "options ahead", ("random ways ahead", "primitives ahead")


class Pair(NamedTuple):
    """Two learners whose costs are compared, both by label."""

    one: str
    other: str


def list_families(study: Study) -> tuple[tuple[Pair, ...], ...]:
    """Questions: exploration by options, all beyond it, and where they lead; then planning, and along what."""
    flat, whole = study.data["flat"], study.data["whole"]
    return ((Pair(flat, EXPLORES), Pair(EXPLORES, whole), Pair(REPEATS, EXPLORES)),
            (Pair(flat, AHEAD), *(Pair(control, AHEAD) for control in RANDOM_AHEAD)))


def list_pairs(study: Study) -> tuple[Pair, ...]:
    """Pairs of the table: the questions, then the other parts and whole options with the flat learner."""
    asked = [pair for family in list_families(study) for pair in family]
    labels = [*(learner["label"] for learner in study.data["learners"]), study.data["whole"]]
    pairs = (Pair(study.data["flat"], label) for label in labels)
    return *asked, *(pair for pair in pairs if pair not in asked)


Found: TypeAlias = Mapping[tuple[Pair, str], Sequence[CostRatio]]
"""Ratios, a number of buttons each, by pair and cost."""


def compare(study: Study, runs: Sequence[PriceRun]) -> dict[tuple[Pair, str], list[CostRatio]]:
    """Ratios by pair and cost; ratios of the questions are corrected by family."""
    own = {label: [run for run in runs if run.agent == label] for pair in list_pairs(study) for label in pair}
    found = {(pair, cost.key): compare_costs(own[pair.one], own[pair.other], cost)
             for pair in list_pairs(study) for cost in (ESCAPE, HALF)}
    for family in list_families(study):
        asked = [key for key in found if key[0] in family]
        own = [found[key] for key in asked]
        corrected = correct_prices(own, [measure_growth(ratios) for ratios in own])
        found |= dict(zip(asked, corrected, strict=True))
    return found


def count_alike(found: Found, pair: Pair, cost: str) -> tuple[int, int]:
    """Numbers of rooms where two learners need equally many primitives, and where both were run."""
    logs = [ends for ratio in found[pair, cost] for ends in ratio.logs.values()]
    return sum(ends == (0.0, 0.0) for ends in logs), len(logs)


def analyse(study: Study, lines: Sequence[PriceRun]) -> Findings:
    """Ratios of all pairs, with the runs of the price study in the same rooms."""
    data, replicates = study.data, {line.replicate for line in lines}
    price = [run for run in open_store(find_study("price"), None).load()
             if isinstance(run, PriceRun) and run.buttons in data["sizes"]
             and run.agent in (data["flat"], data["whole"]) and run.replicate in replicates]
    if not lines or not price:
        raise ComparisonError("this study needs its own runs and the runs of the study `price`")
    found = compare(study, sorted([*lines, *price], key=lambda run: run.place))

    def read(one: str, other: str) -> dict[str, dict[int, Middle]]:
        """Ratios of a pair by cost and number of buttons."""
        return {cost.key: {ratio.buttons: ratio.middle for ratio in found[Pair(one, other), cost.key]}
                for cost in (ESCAPE, HALF)}

    flat, whole = data["flat"], data["whole"]
    return Findings(SimpleNamespace(
        exploring=read(flat, EXPLORES), beyond=read(EXPLORES, whole), repeats=read(REPEATS, EXPLORES),
        imagined=read(flat, AHEAD),
        credit=read(flat, "long credit"), alike=count_alike(found, Pair(EXPLORES, whole), ESCAPE.key),
        minutes=sum(line.seconds for line in lines) / 60), {
            "why": tabulate(study, found),
            "why_learners": make_table(["learner", "label", "what it has of options"], [
                *([find_title(learner["label"]), f"`{learner['label']}`", learner["part"]]
                  for learner in data["learners"]),
                [find_title(whole), f"`{whole}`", "All of them: options are chosen, valued and learned from."]])},
        {"why": partial(draw, study, found)})


def tabulate(study: Study, found: Found) -> str:
    """Factors, a row a pair and cost."""
    rows = []
    for pair in list_pairs(study):
        for cost in (ESCAPE, HALF):
            middles = {ratio.buttons: ratio.middle for ratio in found[pair, cost.key]}
            rows.append([find_title(pair.one), find_title(pair.other), cost.name,
                         *(middles.get(size, "-") for size in study.data["sizes"])])
    return make_table(["primitives of", "over those of", "cost",
                       *(count_nouns(size, "button") for size in study.data["sizes"])], rows)


def draw(study: Study, found: Found, theme: Theme) -> Figure:
    """Factors saved against the flat learner, a panel a cost; a dotted line where only a lower bound is known."""
    flat, sizes = study.data["flat"], study.data["sizes"]
    labels = [EXPLORES, REPEATS, "long credit", AHEAD, study.data["whole"]]
    colours = dict(zip(sizes, theme.lines, strict=False))

    def paint(panels: Any) -> None:
        for axes, cost, title in zip(panels, (ESCAPE, HALF), ("first escape", "an efficiency of 0.5"), strict=True):
            for row, label in enumerate(labels):
                for number, ratio in enumerate(found[Pair(flat, label), cost.key]):
                    middle, colour = ratio.middle, colours[ratio.buttons]
                    if middle.knowledge == "unknown":
                        continue
                    at = row + 0.24 * (number - (len(sizes) - 1) / 2)
                    high = middle.high if np.isfinite(middle.high) else 30 * middle.low
                    is_measured = middle.knowledge == "measured"
                    axes.plot([middle.low, high], [at, at], color=colour, linestyle="-" if is_measured else ":")
                    axes.plot(middle.factor, at, "o" if is_measured else ">", color=colour, markersize=5)
                    if not row and cost is ESCAPE:
                        write_label(axes, 1.3 * high, row + 0.5 * (number - 0.5), count_nouns(ratio.buttons, "button"),
                                    colour)
            axes.axvline(1, color=theme.ink, linewidth=0.8)
            axes.set_title(f"until {title}", loc="left", fontsize=10)
            axes.set(xscale="log", xlim=(0.25, 9_000))
            axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axes.xaxis.set_minor_locator(NullLocator())
            axes.set_yticks(range(len(labels)), list(map(find_title, labels)))
            axes.set_ylim(len(labels) - 0.5, -0.5)
        panels[-1].set_xlabel("times fewer primitives than flat DQN")

    return make_figure(theme, paint, height=5.2, grid="x", nrows=2, sharex=True)
