"""Page of the price of flatness: the factor by which flat learners pay more, learner by learner, and its figure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter

from hrl_escape.agents.registry import get_recipe
from hrl_escape.comparison.baselines.lines import LEAST_RUNS
from hrl_escape.comparison.inference import compute_restricted_mean, compute_survival
from hrl_escape.comparison.price.contestants import (
    BUTTON_COUNTS,
    CONTESTANTS,
    EFFICIENT,
    PAIRS,
    VARIANTS,
    make_chain_room,
)
from hrl_escape.comparison.price.price_runs import PriceRun
from hrl_escape.comparison.price.price_words import (
    compare_with_chance,
    conclude_prices,
    conclude_variants,
    tell_factor,
    tell_longest,
    tell_number,
)
from hrl_escape.comparison.price.ratios import COSTS, RunCost, compare_costs, measure_growth
from hrl_escape.comparison.price.trials import describe_trials, tell_exploration
from hrl_escape.comparison.reporting.agent_style import GREYS, SPARE
from hrl_escape.comparison.studies.paper_figures import FIGURE_STYLE, finish_axes
from hrl_escape.env.drawing import palette
from hrl_escape.env.drawing.maps import save_figure
from hrl_escape.files import write_text
from hrl_escape.names import count_nouns, join_words

__all__ = ["draw_price", "write_price_page"]

_COMMAND = "hrl-escape experiment price"
_CHANCE, _UNTUNED = "random", "dqn, defaults"
_HEADLINE = next(iter(PAIRS.items()))


def write_price_page(runs: Sequence[PriceRun], docs: Path) -> list[str]:
    """Write the page and its figure; returns the conclusions.

    Raises:
        FileWriteError: a file cannot be written.
    """
    claims = [(*pair, cost) for pair in PAIRS.items() for cost in COSTS[: 2 if pair == _HEADLINE else 1]]
    conclusions = [*conclude_prices(runs, claims), tell_longest(runs)]
    save_figure(docs / "figures" / "price.svg", draw_price(runs))
    write_text(docs / "price.md", "\n".join(_write_lines(runs, conclusions)))
    return conclusions


def _choose(runs: Sequence[PriceRun], label: str, buttons: int | None = None) -> list[PriceRun]:
    return [run for run in runs if run.agent == label and buttons in (None, run.buttons)]


def _write_lines(runs: Sequence[PriceRun], conclusions: Sequence[str]) -> list[str]:
    return [
        "# The price of flatness", "",
        "Learners over primitives and the same learners over planned presses, in the same rooms: 20 x 20 m, buttons of "
        "4 m anywhere on the walls in a chain whose order the numbers do not tell, wrong presses ignored, an exit of "
        f"4 m. A learner is efficient once its greedy policy escapes in at most 1 / {EFFICIENT:g} of the fewest known "
        "primitives, in two evaluations in a row; then its run ends. Its cost is the number of primitives that it "
        "had trained for at the first of the two. Where chance makes the untrained policy efficient, its cost is that "
        "of one escape. The planner behind the presses knows the room's geometry and no order of buttons; its calls "
        "cost no primitives, and their time is in the seconds.", "",
        *(f"- **{conclusion}**" for conclusion in conclusions), "",
        "![Runs that got there](figures/price.svg)", "",
        "Share of runs that got there by then (Kaplan-Meier); a cross is where a run was given up, or ended because it "
        "was efficient. Single runs are left out.", "",
        "## The factor", "",
        "A flat learner's cost divided by that of the same learner over options: the median over replicates, which are "
        "a room of each size and a training seed, with its 95 % interval by signs. A run that did not get there is "
        "known to cost more than it had spent and nothing else; where this leaves the interval without an upper end, "
        "its lower end is given (>), and the median of what was spent. The sentences above conclude where the test of "
        "signs does so with Holm's correction for all that they conclude. "
        f"`-`: fewer than {LEAST_RUNS} replicates, or no lower end either; learners of whom that holds in all sizes "
        "are not in the table.", "",
        *_tabulate_factors(runs), "",
        "## All learners", "",
        *_tabulate(runs, "Primitives to efficiency", lambda own: _tell_cost(own, COSTS[0])), "",
        *_tabulate(runs, "Primitives to the first escape in training", lambda own: _tell_cost(own, COSTS[1])), "",
        "Each cell: runs that got there; restricted mean of the primitives up to the largest budget of the cell, in "
        "thousands (area under the Kaplan-Meier curve); runs that were given up earlier are censored there.", "",
        *_tabulate(runs, "The last evaluation", _tell_end), "",
        "Each cell: runs whose greedy policy escapes in it; median efficiency of these.", "",
        *_describe_budgets(runs), "",
        *_tell_variants(runs),
        *_tell_untuned(runs),
        "## Settings", "", *describe_trials(), "",
        "## Make it again", "",
        "One command; finished runs are kept, and with `--from-raw` nothing is trained.", "",
        "```console", _COMMAND, "```", "",
    ]


def _tabulate_factors(runs: Sequence[PriceRun]) -> list[str]:
    lines = [f"| flat learner | cost | {' | '.join(map(str, BUTTON_COUNTS))} | with each button |",
             f"|---|---|{'---|' * len(BUTTON_COUNTS)}---|"]
    for flat, options in PAIRS.items():
        for cost in COSTS:
            ratios = compare_costs(_choose(runs, flat), _choose(runs, options), cost)
            known = {ratio.buttons: tell_factor(ratio.median) for ratio in ratios}
            if all(ratio.median.knowledge == "unknown" for ratio in ratios):
                continue
            growth = measure_growth(ratios)
            span = "" if growth.median.knowledge == "unknown" else f", {growth.smallest} to {growth.largest}"
            lines.append(f"| {flat} | {cost.name} | {' | '.join(known.get(size, '-') for size in BUTTON_COUNTS)} "
                         f"| {tell_factor(growth.median)}{span} |")
    return lines


def _tabulate(runs: Sequence[PriceRun], title: str, tell: Callable[[Sequence[PriceRun]], str]) -> list[str]:
    labels = dict.fromkeys(contestant.label for contestant in CONTESTANTS if _choose(runs, contestant.label))
    lines = [f"| {title} | {' | '.join(map(str, BUTTON_COUNTS))} |", f"|---|{'---|' * len(BUTTON_COUNTS)}"]
    for label in labels:
        cells = [tell(own) if (own := _choose(runs, label, size)) else "-" for size in BUTTON_COUNTS]
        lines.append(f"| {label} | {' | '.join(cells)} |")
    return lines


def _tell_end(runs: Sequence[PriceRun]) -> str:
    escaped = [run.efficiency for run in runs if run.efficiency]
    return f"{len(escaped)} of {len(runs)}" + (f"; {np.median(escaped):.2f}" if escaped else "")


def _tell_cost(runs: Sequence[PriceRun], cost: RunCost) -> str:
    times, observed = zip(*(cost.read(run) for run in runs), strict=True)
    mean = compute_restricted_mean(times, observed, max(run.budget for run in runs))
    return f"{sum(observed)} of {len(runs)}; {tell_number(mean / 1000)}"


def _describe_budgets(runs: Sequence[PriceRun]) -> list[str]:
    """Budgets of each learner, how many runs had them, and how often they were evaluated."""
    lines = ["| learner | copies of the room at once | runs by budget in primitives | evaluated every |",
             "|---|---|---|---|"]
    for label in dict.fromkeys(contestant.label for contestant in CONTESTANTS):
        own = [contestant for contestant in CONTESTANTS if contestant.label == label]
        if budgets := Counter(run.budget for run in _choose(runs, label)):
            parts = [f"{number} of {budget:,}" for budget, number in sorted(budgets.items())]
            spans = join_words([f"{span:,}" for span in sorted({contestant.eval_every for contestant in own})], "or")
            lines.append(f"| {label} | {max(own[0].streams, 1)} | {', '.join(parts)} | {spans} |")
    return [*lines, "", f"Processor time of all runs: {sum(run.seconds for run in runs) / 60:.0f} min. Longer budgets, "
            "and more runs of the longest, were not afforded."]


def _tell_variants(runs: Sequence[PriceRun]) -> list[str]:
    """Section on variants of the headline's flat learner beside it, on the same replicates; empty without any."""
    told = []
    for label, words in VARIANTS.items():
        if _choose(runs, label):
            sentences = conclude_variants(runs, label, _HEADLINE[0], COSTS[:2])
            told.append(f"- `{label}` {words}. {' '.join(sentences)}")
    return [f"## Other ways of `{_HEADLINE[0]}`", "", *told, ""] if told else []


def _tell_untuned(runs: Sequence[PriceRun]) -> list[str]:
    """Section on the default `dqn` in rooms of one button, beside chance; empty where it was not run there."""
    untuned, chance = _choose(runs, _UNTUNED, 1), _choose(runs, _CHANCE, 1)
    if not untuned or not chance:
        return []
    horizon, steps = min(run.budget for run in untuned), get_recipe("dqn").epsilon_steps
    tuned = _choose(runs, _HEADLINE[0], 1)
    words = [compare_with_chance(learner, chance, label, horizon)
             for label, learner in ((_UNTUNED, untuned), (_HEADLINE[0], tuned)) if learner]
    return ["## The default dqn beside chance", "",
            f"In rooms of one button, in their first {horizon:,} primitives: {'; '.join(words)}. By default "
            f"exploration has all but ended after {steps:,} primitives, which are "
            f"{count_nouns(steps // make_chain_room(1).horizon, 'episode')} without an escape. {tell_exploration()}",
            ""]


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
    times, observed = (np.array(column) for column in zip(*(cost.read(run) for run in runs), strict=True))
    ends, waiting = compute_survival(times, observed)
    share = 100 * (1 - waiting)
    axes.step([10, *ends], [0, *share], dash, where="post", linewidth=1.6, color=colour)
    is_lost = np.isin(ends, times[~observed])
    axes.plot(ends[is_lost], share[is_lost], "x", markersize=4, color=colour)
