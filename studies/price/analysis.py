"""Cost of learning over primitives against learning over options: ratios of primitives, tables and the figure."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from types import SimpleNamespace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from hrl_escape.files import read_toml
from hrl_escape.names import join_words
from studies.figures import Theme, make_figure, mark_counts, write_label
from studies.price.ratios import COSTS, CostRatio, RunCost, compare_costs, correct_prices, measure_growth
from studies.price.runs import BUTTON_COUNTS, CONTESTANTS, PAIRS, PriceRun
from studies.statistics import compute_restricted_mean
from studies.study import Findings, Study
from studies.tables import format_short, make_table
from studies.titles import find_title

__all__ = ["LINES", "analyse", "compare_pair", "draw_price"]

LINES = (PriceRun,)
_CHANCE = "random"
_FLAT, _OPTIONS = next(iter(PAIRS.items()))


def analyse(study: Study, lines: Sequence[PriceRun]) -> Findings:
    """Ratios of the headline's pair as one family, the random walk against it, tables and the figure."""
    runs = sorted(lines, key=lambda run: run.place)
    prices = compare_pair(runs, _FLAT, _OPTIONS, COSTS[:2])
    plain = compare_pair(runs, _FLAT, _OPTIONS, COSTS[2:4], corrected=False)
    (walk,) = compare_pair(runs, _FLAT, _CHANCE, COSTS[1:2]).values()
    flat = [run for run in runs if run.agent == _FLAT]
    arrived = {size: Counter(run.efficient_at is not None for run in flat if run.buttons == size)
               for size in BUTTON_COUNTS}
    ready = {ratio.buttons: (ratio.ready, ratio.ready + len(ratio.logs)) for ratio in prices["efficient"]}
    numbers = SimpleNamespace(
        minutes=sum(run.seconds for run in runs) / 60, runs=len(runs),
        trials=len(read_toml(study.folder / "trials.toml", "record of trials")["trials"]),
        factors={key: {ratio.buttons: ratio.middle for ratio in own if not ratio.is_short}
                 for key, own in (prices | plain).items()},
        walk={ratio.buttons: ratio.middle for ratio in walk}, ready=ready,
        arrived={size: (counts[True], counts.total()) for size, counts in arrived.items() if counts})
    return Findings(numbers, {
        "factors": _tabulate_factors(runs),
        "to_efficiency": _tabulate(runs, "Primitives to an efficiency of 0.9", partial(_describe_cost, cost=COSTS[0])),
        "to_escape": _tabulate(runs, "Primitives to the first escape", partial(_describe_cost, cost=COSTS[1])),
        "last": _tabulate(runs, "Last evaluation", _describe_end), "price_budgets": _tabulate_budgets(runs),
        "price_settings": _tabulate_settings(),
    }, {"price": partial(draw_price, runs)})


def compare_pair(runs: Sequence[PriceRun], one: str, other: str, costs: Sequence[RunCost], corrected: bool = True
                 ) -> dict[str, list[CostRatio]]:
    """Ratios of one learner's costs to another's, by cost and size.

    Args:
        runs: of both, and of others.
        one: label of the learner that pays.
        other: label of the learner it is compared with.
        costs: in their order.
        corrected: all sizes and costs, and the growths with each button, are one family (Holm).
    """
    paid, others = ([run for run in runs if run.agent == label] for label in (one, other))
    ratios = [compare_costs(paid, others, cost) for cost in costs]
    if corrected:
        ratios = correct_prices(ratios, [measure_growth(own) for own in ratios])
    return {cost.key: own for cost, own in zip(costs, ratios, strict=True)}


# --- tables ----------------------------------------------------------------------------------


def _choose(runs: Sequence[PriceRun], label: str, buttons: int | None = None) -> list[PriceRun]:
    return [run for run in runs if run.agent == label and buttons in (None, run.buttons)]


def _tabulate_factors(runs: Sequence[PriceRun]) -> str:
    """Plain intervals of all pairs and costs; rows that know nothing are left out."""
    rows = []
    for flat, options in PAIRS.items():
        for key, ratios in compare_pair(runs, flat, options, COSTS, corrected=False).items():
            known = {ratio.buttons: ratio.middle for ratio in ratios}
            if any(middle.knowledge != "unknown" for middle in known.values()):
                (name,) = (cost.name for cost in COSTS if cost.key == key)
                rows.append([find_title(flat), name, *(known.get(size, "-") for size in BUTTON_COUNTS)])
    return make_table(["flat learner", "cost", *BUTTON_COUNTS], rows)


def _tabulate(runs: Sequence[PriceRun], title: str, describe: Callable[[Sequence[PriceRun]], str]) -> str:
    labels = dict.fromkeys(learner["label"] for learner in CONTESTANTS if _choose(runs, learner["label"]))
    return make_table([title, *BUTTON_COUNTS], [
        [find_title(label), *(describe(own) if (own := _choose(runs, label, size)) else "-" for size in BUTTON_COUNTS)]
        for label in labels])


def _describe_end(runs: Sequence[PriceRun]) -> str:
    escaped = [run.efficiency for run in runs if run.efficiency]
    return f"{len(escaped)} of {len(runs)}" + (f"; {np.median(escaped):.2f}" if escaped else "")


def _describe_cost(runs: Sequence[PriceRun], cost: RunCost) -> str:
    times, observed = zip(*filter(None, map(cost.read, runs)), strict=True)
    mean = compute_restricted_mean(times, observed, max(run.budget for run in runs))
    return f"{sum(observed)} of {len(runs)}; {format_short(mean / 1000)}"


def _tabulate_budgets(runs: Sequence[PriceRun]) -> str:
    """Label of each learner, its budgets, how many runs had them, and how often they were evaluated."""
    rows = []
    for label in dict.fromkeys(learner["label"] for learner in CONTESTANTS):
        own = [learner for learner in CONTESTANTS if learner["label"] == label]
        if budgets := Counter(run.budget for run in _choose(runs, label)):
            parts = [f"{number} of {budget:,}" for budget, number in sorted(budgets.items())]
            spans = join_words([f"{span:,}" for span in sorted({learner["eval_every"] for learner in own})], "or")
            rows.append([find_title(label), f"`{label}`", own[0].get("streams", 1), ", ".join(parts), spans])
    return make_table(["learner", "label", "copies of the room", "runs by budget in primitives", "evaluated every"],
                      rows)


def _tabulate_settings() -> str:
    """Settings of the learners that differ from the defaults."""
    used = {learner["label"]: learner.get("settings", {}) for learner in CONTESTANTS}
    return make_table(["learner", "settings"], [
        [find_title(label), ", ".join(f"`{name} = {json.dumps(value)}`" for name, value in settings.items())]
        for label, settings in used.items() if settings])


# --- figure ----------------------------------------------------------------------------------


def draw_price(runs: Sequence[PriceRun], theme: Theme) -> Figure:
    """Primitives until efficient against buttons: a dot a run, lines of medians, triangles for runs that gave up."""
    lines = ((_FLAT, theme.lines[2], 2.35, 1.3e5), ("ppo, long", theme.lines[3], 1.12, 2.6e6),
             (_OPTIONS, theme.lines[0], 3.0, 900), ("options, ppo", theme.lines[1], 1.35, 250))

    def draw(axes: Axes) -> None:
        for number, (label, colour, x, y) in enumerate(lines):
            medians = {}
            for size in BUTTON_COUNTS:
                waits = [max(run.efficient_at, run.fewest) if run.efficient_at is not None else math.inf
                         for run in _choose(runs, label, size)]
                at = BUTTON_COUNTS.index(size) + 0.11 * (number - 1.5)
                arrived = [wait for wait in waits if math.isfinite(wait)]
                axes.plot([at] * len(arrived), arrived, "o", color=colour, markersize=3, alpha=0.45, markeredgewidth=0)
                if lost := [run.primitives for run in _choose(runs, label, size) if run.efficient_at is None]:
                    axes.plot([at] * len(lost), lost, "^", color=colour, markersize=5, markerfacecolor="none")
                if len(waits) > 1 and math.isfinite(middle := float(np.median(waits))):
                    medians[at] = middle
            axes.plot(list(medians), list(medians.values()), color=colour, linewidth=2)
            write_label(axes, x - 1, y, find_title(label), colour, ha="left")
        axes.set(yscale="log", ylim=(15, 2e7), xlim=(-0.4, len(BUTTON_COUNTS) - 0.6), xlabel="buttons in the room",
                 ylabel="primitives until efficient")
        axes.set_xticks(range(len(BUTTON_COUNTS)), [str(size) for size in BUTTON_COUNTS])
        mark_counts(axes.yaxis)
        axes.yaxis.set_minor_locator(NullLocator())

    return make_figure(theme, draw, height=3.9)
