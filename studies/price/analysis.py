"""The price of flatness: the factor by which flat learners pay more, learner by learner, and its figure."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter

from hrl_escape.agents.registry import get_recipe
from hrl_escape.benchmark.reporting.figures import GREYS, SPARE
from hrl_escape.env.pictures import palette
from hrl_escape.errors import UnknownNameError
from hrl_escape.names import count_nouns, join_words
from studies.figures import FIGURE_STYLE, finish_axes
from studies.page import make_table
from studies.price.contestants import BUTTON_COUNTS, CONTESTANTS, EFFICIENT, PAIRS, VARIANTS, make_chain_room
from studies.price.ratios import COSTS, RunCost, compare_costs, measure_growth
from studies.price.runs import PriceRun, measure_price_runs
from studies.price.trials import describe_trials, tell_exploration
from studies.price.words import (
    advise,
    compare_with_chance,
    conclude_prices,
    conclude_variants,
    tell_factor,
    tell_longest,
    tell_number,
    tell_ready,
    tell_visible,
)
from studies.running import StudyArgs
from studies.statistics import compute_restricted_mean, compute_survival
from studies.store import Store
from studies.study import Page, Study

__all__ = ["LINES", "Args", "analyse", "draw_price", "measure"]

LINES = (PriceRun,)
_CHANCE, _UNTUNED = "random", "dqn, defaults"
_HEADLINE = next(iter(PAIRS.items()))


@dataclasses.dataclass(frozen=True)
class Args(StudyArgs):
    """Options of the price of flatness."""

    replicates: int = 20
    """Rooms of each size, each with a training seed of its own."""
    first_replicate: int = 0
    """Lowest replicate; those from 200 on are fresh. Give another `--docs` too, or the page tells of both."""
    minutes: float | None = None
    """Minutes after which no further run is begun."""
    agents: tuple[str, ...] = ()
    """Labels of the learners to run; all by default."""
    sizes: tuple[int, ...] = BUTTON_COUNTS
    """Numbers of buttons to run."""


def measure(study: Study, args: Args, store: Store) -> None:
    """Make the runs that are missing."""
    known = {contestant.label for contestant in CONTESTANTS}
    for label in args.agents:
        if label not in known:
            raise UnknownNameError("learner of this study", label, known)
    chosen = [dataclasses.replace(contestant, sizes=tuple(size for size in contestant.sizes if size in args.sizes))
              for contestant in CONTESTANTS if contestant.label in (args.agents or known)]
    for made in measure_price_runs(store, args.first_replicate, args.replicates, args.minutes, chosen):
        print(f"{made.agent}, {made.buttons} buttons, replicate {made.replicate}: efficient at {made.efficient_at}")


def analyse(study: Study, lines: Sequence[PriceRun]) -> Page:
    """Factors, conclusions, tables and the figure of lines."""
    runs = sorted(lines, key=lambda run: run.place)
    flat, options = _HEADLINE
    claims = [(flat, options, cost) for cost in COSTS[:2]]
    conclusions = conclude_prices(runs, claims)
    others = [conclude_prices(runs, [(*pair, cost) for cost in COSTS[:2]]) for pair in PAIRS.items()
              if pair != _HEADLINE]
    walk = conclude_variants(runs, flat, _CHANCE, COSTS[1:2])
    ready = tell_ready(runs, flat, options, COSTS[0])
    return Page({
        "conclusions": conclusions, "others": [told for own in others for told in own], "walk": walk[0], "ready": ready,
        "visible": tell_visible(runs, flat, options, COSTS[:2]),
        "advice": advise(runs, flat, options, _CHANCE, COSTS[:2]),
        "longest": tell_longest(runs), "EFFICIENT": EFFICIENT, "factors": _tabulate_factors(runs),
        "curves": sum(bool(run.curve) for run in runs), "count": len(runs),
        "to_efficiency": _tabulate(runs, "Primitives to efficiency", lambda own: _tell_cost(own, COSTS[0])),
        "to_escape": _tabulate(runs, "Primitives to the first escape in training",
                               lambda own: _tell_cost(own, COSTS[1])),
        "last": _tabulate(runs, "The last evaluation", _tell_end), "budgets": _tabulate_budgets(runs),
        "minutes": sum(run.seconds for run in runs) / 60, "headline": _HEADLINE[0],
        "variants": {label: " ".join(conclude_variants(runs, label, _HEADLINE[0], COSTS[:2])) for label in VARIANTS
                     if _choose(runs, label)},
        "untuned": _compare_untuned(runs), "trials": describe_trials(),
    }, {"price": draw_price(runs)}, [*conclusions, walk[0], *filter(None, [ready])])


def _choose(runs: Sequence[PriceRun], label: str, buttons: int | None = None) -> list[PriceRun]:
    return [run for run in runs if run.agent == label and buttons in (None, run.buttons)]


def _tabulate_factors(runs: Sequence[PriceRun]) -> str:
    rows = []
    for flat, options in PAIRS.items():
        for cost in COSTS:
            ratios = compare_costs(_choose(runs, flat), _choose(runs, options), cost)
            known = {ratio.buttons: tell_factor(ratio.middle) for ratio in ratios}
            if all(ratio.middle.knowledge == "unknown" for ratio in ratios):
                continue
            growth = measure_growth(ratios)
            span = "" if growth.middle.knowledge == "unknown" else f", {growth.smallest} to {growth.largest}"
            rows.append([flat, cost.name, *(known.get(size, "-") for size in BUTTON_COUNTS),
                         tell_factor(growth.middle) + span])
    return make_table(["flat learner", "cost", *BUTTON_COUNTS, "with each button"], rows)


def _tabulate(runs: Sequence[PriceRun], title: str, tell: Callable[[Sequence[PriceRun]], str]) -> str:
    labels = dict.fromkeys(contestant.label for contestant in CONTESTANTS if _choose(runs, contestant.label))
    return make_table([title, *BUTTON_COUNTS], [
        [label, *(tell(own) if (own := _choose(runs, label, size)) else "-" for size in BUTTON_COUNTS)]
        for label in labels])


def _tell_end(runs: Sequence[PriceRun]) -> str:
    escaped = [run.efficiency for run in runs if run.efficiency]
    return f"{len(escaped)} of {len(runs)}" + (f"; {np.median(escaped):.2f}" if escaped else "")


def _tell_cost(runs: Sequence[PriceRun], cost: RunCost) -> str:
    times, observed = zip(*filter(None, map(cost.read, runs)), strict=True)
    mean = compute_restricted_mean(times, observed, max(run.budget for run in runs))
    return f"{sum(observed)} of {len(runs)}; {tell_number(mean / 1000)}"


def _tabulate_budgets(runs: Sequence[PriceRun]) -> str:
    """Budgets of each learner, how many runs had them, and how often they were evaluated."""
    rows = []
    for label in dict.fromkeys(contestant.label for contestant in CONTESTANTS):
        own = [contestant for contestant in CONTESTANTS if contestant.label == label]
        if budgets := Counter(run.budget for run in _choose(runs, label)):
            parts = [f"{number} of {budget:,}" for budget, number in sorted(budgets.items())]
            spans = join_words([f"{span:,}" for span in sorted({contestant.eval_every for contestant in own})], "or")
            rows.append([label, max(own[0].streams, 1), ", ".join(parts), spans])
    return make_table(["learner", "copies of the room at once", "runs by budget in primitives", "evaluated every"],
                      rows)


def _compare_untuned(runs: Sequence[PriceRun]) -> dict[str, Any] | None:
    """Values of the section on the default `dqn` in rooms of one button; None where it or chance was not run there."""
    untuned, chance = _choose(runs, _UNTUNED, 1), _choose(runs, _CHANCE, 1)
    if not untuned or not chance:
        return None
    horizon, steps = min(run.budget for run in untuned), get_recipe("dqn").epsilon_steps
    tuned = _choose(runs, _HEADLINE[0], 1)
    return {"horizon": horizon, "steps": steps, "episodes": steps // make_chain_room(1).horizon,
            "told": [compare_with_chance(learner, chance, label, horizon)
                     for label, learner in ((_UNTUNED, untuned), (_HEADLINE[0], tuned)) if learner],
            "exploration": tell_exploration()}


def draw_price(runs: Sequence[PriceRun]) -> Figure:
    """Share of runs that got there against primitives: a column a size, dashes without options, grey for chance."""
    labels = [label for label in dict.fromkeys(contestant.label for contestant in CONTESTANTS)
              if label != _UNTUNED and any(len(_choose(runs, label, size)) > 1 for size in BUTTON_COUNTS)]
    twins = dict.fromkeys(PAIRS.get(label, label) for label in labels if label != _CHANCE)
    colours = dict(zip(twins, (*palette.LINES, *SPARE), strict=False)) | {_CHANCE: GREYS[0]}
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(10.4, 4.6), facecolor=palette.BACKGROUND, layout="constrained")
        panels = figure.subplots(2, len(BUTTON_COUNTS), sharey=True, sharex=True)
        for row, cost, title in zip(panels, COSTS, ("efficient", "escaped once"), strict=False):
            for axes, size in zip(row, BUTTON_COUNTS, strict=True):
                for label in labels:
                    _draw_share(axes, _choose(runs, label, size), cost, colours[PAIRS.get(label, label)],
                                "-" if label.startswith("options") else "--")
                finish_axes(axes)
                axes.set_ylim(-4, 104)
                axes.set_xscale("log")
                axes.set_xlim(left=10)
                axes.xaxis.set_major_locator(LogLocator(numticks=5))
                axes.xaxis.set_major_formatter(EngFormatter(sep=""))
                axes.xaxis.set_minor_formatter(NullFormatter())
            row[0].set_ylabel(f"{title}, % of runs", color=palette.INK)
        for axes, size in zip(panels[0], BUTTON_COUNTS, strict=True):
            axes.set_title(count_nouns(size, "button"), fontsize=9, color=palette.INK, loc="left")
        for label in labels:
            panels[0, -1].plot([], [], "-" if label.startswith("options") else "--", label=label,
                               color=colours[PAIRS.get(label, label)])
        panels[0, -1].legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)
        figure.supxlabel("primitives of training", fontsize=9, color=palette.INK)
    return figure


def _draw_share(axes: Axes, runs: Sequence[PriceRun], cost: RunCost, colour: str, dash: str) -> None:
    """Kaplan-Meier's curve of the runs that got there, a cross where one was given up; none of a single run."""
    if len(runs) < 2:
        return
    times, observed = (np.array(column) for column in zip(*filter(None, map(cost.read, runs)), strict=True))
    ends, waiting = compute_survival(times, observed)
    share = 100 * (1 - waiting)
    axes.step([10, *ends], [0, *share], dash, where="post", linewidth=1.6, color=colour)
    is_lost = np.isin(ends, times[~observed])
    axes.plot(ends[is_lost], share[is_lost], "x", markersize=4, color=colour)
