"""The paper's figures made anew, its claims one by one, and where these runs part from the published program."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hrl_escape.agents.registry import DEFAULT_RECIPE, KERAS_RL
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.inference import Estimate, compute_interval
from hrl_escape.benchmark.reporting.figures import GREYS
from hrl_escape.benchmark.statistics import Floats, compute_iqm
from hrl_escape.env.pictures import palette
from hrl_escape.errors import ComparisonError
from hrl_escape.names import join_words
from hrl_escape.settings import read_record
from studies.figures import FIGURE_STYLE, finish_axes
from studies.page import make_table
from studies.paper.claims import Claim, advise, judge_claims
from studies.paper.measures import (
    Measurement,
    Results,
    get_runs,
    has_settled,
    measure_final,
    measure_slope,
    share_of_training,
)
from studies.raw import BINS, OPTIMAL_SCORE, RawRun, collect_runs
from studies.study import Page, Study

__all__ = ["LINES", "Rerun", "analyse", "collect", "draw_figure", "list_claims", "tell_chance",
           "tell_departures"]

LINES = (RawRun,)
collect = collect_runs
APART = 0.25
"""Difference of shares of episodes from which on the two are said to part."""
POINTS = 41
_COLOURS = {"dqn": palette.LINES[0], "sarsa": palette.LINES[1], "ddpg": palette.LINES[2], "random": GREYS[0]}


@dataclass(frozen=True)
class Rerun:
    """Escapes of the published program in the last fifth of training, its simulation stepped in lockstep.

    Attributes:
        figure: grid of the same experiment.
        agent: label of the same agent there.
        words: experiment, in words.
        shares: share of escaping episodes in the last fifth, one a run.
        note: what else its runs showed; may be empty.
    """

    figure: str
    agent: str
    words: str
    shares: tuple[float, ...]
    note: str = ""


def list_claims(study: Study) -> list[Claim]:
    """Claims, in the order of the page."""
    return [read_record(Claim, table) for table in study.data["claims"]]


def analyse(study: Study, lines: Sequence[RawRun]) -> Page:
    """Claims, departures, numbers and figures of runs.

    Raises:
        ComparisonError: an agent has no runs.
    """
    results = {grid.name: [run for run in lines if run.grid == grid.name] for grid in study.grids}
    for grid in study.grids:
        planned = {agent.label for agent in grid.agents if not agent.is_reference}
        if missing := planned - {run.agent for run in results[grid.name]}:
            raise ComparisonError(f"{grid.name} has no run of {', '.join(sorted(missing))}: run it again without "
                                  "--from-raw")
    findings = judge_claims(list_claims(study), results)
    answers = Counter(finding.kind for finding in findings)
    rows = [[number, finding.claim.says, f"{finding.claim.measured}: {finding.claim.holds.words}",
             _list_estimates(finding.paper, finding.claim.unit),
             _list_estimates(finding.corrected, finding.claim.unit) or "not run", finding.agrees, finding.claim.rerun]
            for number, finding in enumerate(findings, 1)]
    parted, alike = tell_departures([read_record(Rerun, table) for table in study.data["reruns"]], results)
    return Page({
        "advice": advise(results), "findings": findings, "answers": answers, "OPTIMAL_SCORE": OPTIMAL_SCORE,
        "APART": APART,
        "best": [results[name][0].best for name in ("paper-figure-1", "paper-figure-2")],
        "runs": {name: _count_runs(results, name) for name in results}, "parted": parted, "alike": alike,
        "by_chance": tell_chance([finding.by_chance for finding in findings]),
        "claims": make_table(["", "the paper says", "measured", "`keras-rl-2019`", "`default`",
                              "agree?", "published program, rerun"], rows),
        "numbers": make_table(["figure", "agent", "final score", "slope", "settled", "escapes in training"], [
            _make_row(results, name, agent) for name in results
            for agent in dict.fromkeys(run.agent for run in results[name])]),
    }, {name: draw_figure(runs) for name, runs in results.items()},
        [f"{number:2} {finding.claim.says} {finding.agrees}" for number, finding in enumerate(findings, 1)])


def tell_chance(settled: Sequence[bool | None]) -> str:
    """Sentence on claims that random choices settle by the same tests; empty where there is none.

    Args:
        settled: for each claim whether they confirm it, refute it (False) or neither (None).
    """
    parts = [f"{word} {'claim' if len(numbers) == 1 else 'claims'} {join_words(map(str, numbers))}"
             for word, kind in (("confirm", True), ("refute", False))
             if (numbers := [number for number, found in enumerate(settled, 1) if found is kind])]
    return f"Random choices {' and '.join(parts)} by the same tests, without learning." if parts else ""


def _count_runs(results: Results, figure: str) -> str:
    counts = sorted(len(get_runs(results, figure, agent)) for agent in {run.agent for run in results[figure]})
    return f"{counts[0]}" if counts[0] == counts[-1] else f"{counts[0]} to {counts[-1]}"


def _make_row(results: Results, figure: str, agent: str) -> list[str]:
    runs = get_runs(results, figure, agent)
    escapes = Measurement(tuple(share_of_training(run, run.training_successes) for run in runs)).estimate()
    return [figure.removeprefix("paper-"), agent, _format(measure_final(runs).estimate(), "%"),
            _format(measure_slope(runs, False, 0.5).estimate(), "points"),
            f"{sum(map(has_settled, runs))} of {len(runs)}", _format(escapes, "%")]


def _list_estimates(estimates: dict[str, Estimate], unit: str) -> str:
    return "<br>".join(f"{name} {_format(found, unit)}" for name, found in estimates.items())


def _format(found: Estimate, unit: str) -> str:
    sign = "+" if unit == "points" else ""
    value, low, high = (f"{100 * np.round(number, 3) + 0.0:{sign}.{_get_digits(found)}f}"
                        for number in (found.value, found.low, found.high))
    return f"{value} ({low} to {high})"


def _get_digits(found: Estimate) -> int:
    """A decimal where whole numbers would hide the difference to 0 or 100."""
    return 1 if any(0 < number < 0.01 or 0.985 < number < 1 for number in (found.value, found.low, found.high)) else 0


def tell_departures(reruns: Sequence[Rerun], results: Results) -> tuple[list[str], list[str]]:
    """A sentence for each experiment, with both numbers: of those that part from the rerun, and of the others."""
    parted, alike = [], []
    for rerun in reruns:
        ours = [_compute_late_share(run) for run in get_runs(results, rerun.figure, rerun.agent)]
        there, here = float(np.mean(rerun.shares)), float(np.mean(ours))
        shares = join_words(f"{share:.2f}" for share in rerun.shares)
        sentence = (f"{rerun.words}: {shares} there, {here:.2f} on average here "
                    f"({min(ours):.2f} to {max(ours):.2f}, {len(ours)} runs){rerun.note and '; '}{rerun.note}.")
        (parted if abs(there - here) > APART else alike).append(sentence)
    return parted, alike


def _compute_late_share(run: RawRun) -> float:
    late = slice(BINS * 4 // 5, BINS)
    return sum(run.training_successes[late]) / max(sum(run.episodes[late]), 1)


# --- figures ---------------------------------------------------------------------------------


def draw_figure(runs: Sequence[RawRun]) -> Figure:
    """One panel a recipe: frozen weights in full lines with intervals, training episodes dotted, chance dashed."""
    labels = list(dict.fromkeys(run.agent for run in runs if _get_algorithm(run.agent) in _COLOURS))
    recipes = [recipe for recipe in (KERAS_RL, DEFAULT_RECIPE) if any(_get_recipe(label) == recipe for label in labels)]
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(4.4 * len(recipes) + 0.6, 3.3), facecolor=palette.BACKGROUND, layout="constrained")
        panels = figure.subplots(1, len(recipes), sharey=True, squeeze=False)[0]
        for axes, recipe in zip(panels, recipes, strict=True):
            for label in labels:
                if _get_recipe(label) in (recipe, "none"):
                    _draw_agent(axes, [run for run in runs if run.agent == label], _get_algorithm(label))
            axes.set_title(f"settings {recipe}", fontsize=9, color=palette.INK, loc="left")
            axes.set_xlabel(f"{runs[0].axis} of training", color=palette.INK)
            axes.set_ylim(-4, 104)
            finish_axes(axes)
        panels[0].set_ylabel("return, % from -1,000 to best known", color=palette.INK)
        panels[-1].plot([], [], ":", color=palette.MUTED, linewidth=1.2, label="training\nepisodes")
        shown = {label: handle for axes in panels
                 for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
        panels[-1].legend(list(shown.values()), list(shown), loc="center left", bbox_to_anchor=(1.01, 0.5),
                          frameon=False)
    return figure


def _get_algorithm(label: str) -> str:
    return AgentSpec.parse(label).algorithm


def _get_recipe(label: str) -> str:
    if _get_algorithm(label) == "random":
        return "none"
    return AgentSpec.parse(label).recipe


def _draw_agent(axes: Axes, runs: Sequence[RawRun], algorithm: str) -> None:
    budget, colour = runs[0].budget, _COLOURS[algorithm]
    grid = np.linspace(0, budget, POINTS)
    training = np.stack([run.training_scores for run in runs])
    seen = np.isfinite(training).any(axis=0)
    middle: Floats = np.full(training.shape[1], np.nan)
    middle[seen] = np.nanmean(training[:, seen], axis=0)
    if algorithm == "random":
        axes.axhline(100 * float(np.nanmean(training)), color=colour, linestyle="--", linewidth=1.4, label="random")
        return
    axes.plot(runs[0].training_at, 100 * middle, ":", color=colour, linewidth=1.2)
    curves = [np.stack([np.interp(grid, run.at, run.scores) for run in runs], axis=-1)]
    bounds = (min(0.0, float(curves[0].min())), max(1.0, float(curves[0].max())))
    low, high = compute_interval(compute_iqm, curves, bounds, np.random.default_rng(2019), 1_000)
    axes.fill_between(grid, 100 * low, 100 * high, color=colour, alpha=0.14, linewidth=0)
    axes.plot(grid, 100 * compute_iqm(curves), color=colour, linewidth=1.8, label=algorithm)
