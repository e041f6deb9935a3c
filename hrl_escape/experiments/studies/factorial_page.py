"""The page docs/results/why-it-worsens.md: analyses of variance of the factorials, and the cause they show."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from hrl_escape.env.drawing import palette
from hrl_escape.env.drawing.maps import save_figure
from hrl_escape.experiments.studies.contrasts import Analysis, Term
from hrl_escape.experiments.studies.factorial import (
    CONTROLS,
    FACTORS,
    RESPONSES,
    analyse_runs,
    compute_response,
    get_factors,
    name_control,
    read_levels,
)
from hrl_escape.experiments.studies.factorial_cause import HEALED, SIGNIFICANT, conclude
from hrl_escape.experiments.studies.paper_figures import FIGURE_STYLE, finish_axes
from hrl_escape.experiments.studies.raw import BINS, RawRun
from hrl_escape.files import write_text
from hrl_escape.names import join_words

__all__ = ["compute_corners", "write_factorial_page"]

_COMMAND = "hrl-escape experiment factorial"
_COLOURS = (palette.LINES[0], palette.LINES[4])
WORDS = {
    "final score": "score of frozen weights in the last fifth of training",
    "slope": "slope of the score of training episodes over a run, exploration included",
}
MOST_INTERACTIONS = 5


def write_factorial_page(results: dict[str, list[RawRun]], docs: Path) -> dict[tuple[str, str], Analysis]:
    """Write the page and its figures; returns the analyses by (algorithm, response).

    Args:
        results: algorithm -> runs of its factorial.
        docs: folder of the page.

    Raises:
        ComparisonError: runs are missing.
        FileWriteError: a file cannot be written.
    """
    found = {(name, response): analyse_runs(name, runs, response) for name, runs in results.items()
             for response in RESPONSES}
    for name in results:
        analyses = [found[name, response] for response in RESPONSES]
        save_figure(docs / "figures" / f"why-{name}.svg", draw_effects(get_factors(name), analyses))
    write_text(docs / "why-it-worsens.md", "\n".join(_write_lines(results, found)))
    return found


def draw_effects(names: Sequence[str], analyses: Sequence[Analysis]) -> Figure:
    """Main effects with their intervals, one panel a response."""
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(8.2, 2.6), facecolor=palette.BACKGROUND, layout="constrained")
        panels = figure.subplots(1, len(analyses), sharey=True)
        at = np.arange(len(names))[::-1]
        for axes, analysis, response, colour in zip(panels, analyses, RESPONSES, _COLOURS, strict=True):
            terms = [analysis.get_term(name) for name in names]
            value = np.array([100 * term.effect for term in terms])
            reach = np.array([[100 * (term.effect - term.low), 100 * (term.high - term.effect)] for term in terms]).T
            axes.barh(at, value, xerr=reach, color=colour, height=0.6, ecolor=palette.INK, capsize=2)
            axes.axvline(0, color=palette.MUTED, linewidth=0.8)
            axes.set_yticks(at, names)
            axes.set_xlabel(f"effect on the {response}, points", color=palette.INK)
            finish_axes(axes)
            axes.grid(visible=False, axis="y")
    return figure


def compute_corners(algorithm: str, runs: Sequence[RawRun], response: str) -> list[tuple[str, float, float]]:
    """For each factor the mean with it alone corrected, and with all but it corrected; NaN where not run.

    The first row, without a name, is nothing and everything corrected.
    """
    names = get_factors(algorithm)
    values = {run.agent: [] for run in runs}
    for run in runs:
        values[run.agent].append(compute_response(run, response))

    def get_mean(levels: Sequence[int]) -> float:
        return float(np.mean([np.mean(found) for agent, found in values.items() if read_levels(agent) == list(levels)]
                             or [np.nan]))

    rows = [("", get_mean([-1] * len(names)), get_mean([1] * len(names)))]
    for number, name in enumerate(names):
        alone = [1 if number == other else -1 for other in range(len(names))]
        rows.append((name, get_mean(alone), get_mean([-level for level in alone])))
    return rows


# --- the page --------------------------------------------------------------------------------


def _write_lines(results: dict[str, list[RawRun]], found: dict[tuple[str, str], Analysis]) -> list[str]:
    rooms = {name: list(dict.fromkeys(run.room for run in runs)) for name, runs in results.items()}
    everything = [run for runs in results.values() for run in runs]
    budget, seeds = everything[0].budget, len({run.seed for run in everything})
    lines = ["# Why SARSA and DDPG get worse with meta-actions", "", *_tell_cause(results, found), "",
             "## What was run", "",
             f"Two-level factorials, {budget:,} primitives a run, an evaluation each twentieth of that. Low is what "
             "keras-rl 0.4.2 and the published program did, high what the recipe `corrected` does. The clock of "
             "schedules is in primitives throughout, and keras-rl's late flag at the end of an episode "
             "(`late_terminal`) is left out: the decay is there without it.", ""]
    for name, runs in results.items():
        lines += [f"**{name}**, in {join_words(rooms[name])}: a half fraction of the {2 ** len(FACTORS[name])} "
                  f"combinations (resolution VI), {found[name, 'slope'].runs} runs, which is analysed"
                  + ("" if np.isnan(compute_corners(name, runs, "slope")[1][1]) else
                     ", and all combinations that differ from either recipe in one factor")
                  + f"; {len(runs)} runs in all, {seeds} training seed{'s' if seeds > 1 else ''}.", "",
                  "| factor | low: the published program | high: corrected |", "|---|---|---|"]
        lines += [f"| {factor.name} | {factor.paper} | {factor.corrected} |" for factor in FACTORS[name]] + [""]
    for name, runs in results.items():
        lines += [f"## {name}", "", f"![Main effects on {name}](figures/why-{name}.svg)", ""]
        for response in RESPONSES:
            lines += _write_analysis(response, found[name, response])
        lines += _write_corners(name, runs) + _write_rooms(name, runs)
    return [*lines, "## Make it again", "",
            "One command; finished runs are kept, and with `--from-raw` nothing is trained.", "",
            "```console", f"{_COMMAND} --runs {seeds} --primitives {budget}", "```", ""]


def _tell_cause(results: dict[str, list[RawRun]], found: dict[tuple[str, str], Analysis]) -> list[str]:
    """Conclusions by rule, then what became of single corrections, as far as it was run."""
    lines = [f"Main effects in points of 100, where p < {SIGNIFICANT:g} after correction for all main effects of this "
             "page (Holm). The sentences are chosen by rule from the tables below; rooms are fixed, and with few "
             "training seeds a cell nothing is claimed of other rooms.", ""]
    for name, runs in results.items():
        lines.append(f"- **{name}**. {' '.join(conclude(name, found, runs))}")
    lines += ["", "What became of single corrections:", ""]
    for name, runs in results.items():
        ends, trends = (compute_corners(name, runs, response) for response in RESPONSES)
        first, last = _compute_span(runs)
        lines.append(f"- Training episodes of `{name}` as published go from {_points(first)} points in the first tenth "
                     f"to {_points(last)} in the last fifth; frozen weights end at {_points(ends[0][1])} (slope "
                     f"{_points(trends[0][1], '+')}), with all factors corrected at {_points(ends[0][2])} "
                     f"({_points(trends[0][2], '+')}).")
        if not np.isnan(ends[1][1]):
            healing = [factor for factor, alone, _ in ends[1:] if alone >= HEALED]
            others = [f"{factor} ({_points(alone)}, slope {_points(trend, '+')})"
                      for (factor, alone, _), (_, trend, _) in zip(ends[1:], trends[1:], strict=True) if alone < HEALED]
            lines.append(f"- Means over rooms, corrected alone: {join_words(healing) or 'no factor'} "
                         f"{'ends' if len(healing) < 2 else 'end'} at {_points(HEALED)} points or more; "
                         f"{join_words(others) or 'none'} {'does' if len(others) == 1 else 'do'} not.")
        lines += [f"- Control: published but for {control}, `{name}` ends at {_points(float(np.mean(values)))} points "
                  f"({len(values)} run{'s' if len(values) > 1 else ''})."
                  for control, values in compute_controls(name, runs).items()]
    return lines


def _compute_span(runs: Sequence[RawRun]) -> tuple[float, float]:
    """Mean score of the training episodes of the published program, in the first tenth and in the last fifth."""
    scores = np.array([run.training_scores for run in runs if set(read_levels(run.agent)) == {-1}])
    return float(np.nanmean(scores[:, : BINS // 10])), float(np.nanmean(scores[:, -(BINS // 5) :]))


def compute_controls(algorithm: str, runs: Sequence[RawRun]) -> dict[str, list[float]]:
    """Final scores of each control that was run."""
    values = {control: [compute_response(run, "final score") for run in runs
                        if run.agent == name_control(algorithm, control)] for control in CONTROLS[algorithm]}
    return {control: found for control, found in values.items() if found}


def _points(value: float, sign: str = "") -> str:
    return f"{100 * value:{sign}.0f}"


def _write_analysis(response: str, analysis: Analysis) -> list[str]:
    mains = [term for term in analysis.terms if len(term.factors) == 1]
    pairs = sorted((term for term in analysis.terms if len(term.factors) == 2), key=lambda term: -term.share)
    lines = [f"Analysis of variance, {WORDS[response]} ({analysis.runs} runs, points of 100). Rooms take "
             f"{analysis.block_share:.0%} of the sum of squares, the residual {analysis.residual_share:.0%} with "
             f"{analysis.residual_freedom} degrees of freedom. Below the main effects stand the "
             f"{MOST_INTERACTIONS} strongest interactions of two.", "",
             "| term | effect, low to high (95 % interval) | share of variance | F | p |", "|---|---|---|---|---|"]
    return [*lines, *map(_write_term, [*mains, *pairs[:MOST_INTERACTIONS]]), ""]


def _write_term(term: Term) -> str:
    p = "< 0.001" if term.p < 0.001 else f"{term.p:.3f}"
    interval = f"{100 * term.low:+.1f} to {100 * term.high:+.1f}"
    return (f"| {' x '.join(term.factors)} | {100 * term.effect:+.1f} ({interval}) | {term.share:.1%} | {term.f:.1f} "
            f"| {p} |")


def _write_corners(name: str, runs: Sequence[RawRun]) -> list[str]:
    tables = [compute_corners(name, runs, response) for response in RESPONSES]
    if any(np.isnan(value) for row in tables[0] for value in row[1:]):
        return []
    lines = ["One at a time, means over rooms, in points: the published program with one factor corrected, and the "
             "corrected recipe with one factor as it was.", "",
             "| factor | final score, only it corrected | all but it corrected | slope, only it corrected "
             "| all but it corrected |", "|---|---|---|---|---|"]
    for final, slope in zip(*tables, strict=True):
        lines.append(f"| {final[0] or '(none; all)'} | {100 * final[1]:.0f} | {100 * final[2]:.0f} "
                     f"| {100 * slope[1]:+.0f} | {100 * slope[2]:+.0f} |")
    return [*lines, ""]


def _write_rooms(name: str, runs: Sequence[RawRun]) -> list[str]:
    rooms = list(dict.fromkeys(run.room for run in runs))
    lines = ["Main effects on the final score room by room, in points:", "",
             "| room | " + " | ".join(get_factors(name)) + " |", "|---" * (len(FACTORS[name]) + 1) + "|"]
    for room in rooms:
        here = [run for run in runs if run.room == room]
        analysis = analyse_runs(name, here, "final score")
        effects = [f"{100 * analysis.get_term(factor).effect:+.0f}" for factor in get_factors(name)]
        lines.append(f"| {room} | " + " | ".join(effects) + " |")
    return [*lines, ""]
