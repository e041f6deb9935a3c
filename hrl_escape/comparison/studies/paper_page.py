"""The page docs/results/paper.md: the paper's figures made anew, and its claims one by one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hrl_escape.comparison.inference import Estimate
from hrl_escape.comparison.presets import get_grid
from hrl_escape.comparison.studies.claims import CLAIMS, FIGURES, Finding, judge_claims
from hrl_escape.comparison.studies.measures import (
    Measurement,
    Results,
    get_runs,
    has_settled,
    measure_final,
    measure_slope,
    share_of_training,
)
from hrl_escape.comparison.studies.paper_figures import draw_figure
from hrl_escape.comparison.studies.raw import OPTIMAL_SCORE
from hrl_escape.comparison.studies.rerun import tell_departures
from hrl_escape.env.drawing.maps import save_figure
from hrl_escape.errors import ComparisonError
from hrl_escape.files import write_text

__all__ = ["write_paper_page"]

_COMMAND = "hrl-escape experiment paper"
CAPTIONS = {
    "paper-figure-1": "Figure 1. One button, primitives only.",
    "paper-figure-2": "Figure 2. Two buttons, primitives only.",
    "paper-figure-3": "Figure 3. Two buttons with meta-actions, 20,000 primitives.",
    "paper-figure-3-decisions": "Figure 3 again, 20,000 decisions, as the published program counted its steps.",
}


def write_paper_page(results: Results, docs: Path) -> list[Finding]:
    """Write the page and its figures; returns what came of each claim.

    Raises:
        FileWriteError: a file cannot be written.
        ComparisonError: an agent has no runs.
    """
    for name in FIGURES:
        planned = {agent.label for agent in get_grid(name).agents if not agent.is_reference}
        missing = planned - {run.agent for run in results[name]}
        if missing:
            raise ComparisonError(f"{name} has no run of {', '.join(sorted(missing))}: run it again without --from-raw")
    findings = judge_claims(CLAIMS, results)
    for name in FIGURES:
        save_figure(docs / "figures" / f"{name}.svg", draw_figure(results[name]))
    write_text(docs / "paper.md", "\n".join(_write_lines(results, findings)))
    return findings


def _write_lines(results: Results, findings: Sequence[Finding]) -> list[str]:
    runs = {name: _count_runs(results, name) for name in FIGURES}
    counts = {word: sum(finding.agrees == word for finding in findings) for word in ("yes", "no", "open")}
    mixed = len(findings) - sum(counts.values())
    best = {name: results[name][0].best for name in FIGURES[:2]}
    lines = [
        "# The paper's experiments, run again", "",
        "Section 6 of Menashe and Stone (2019) compares DQN, Deep SARSA and DDPG in three figures. Here they are made "
        "anew with two recipes: `paper` is what keras-rl 0.4.2 and the published program did, `corrected` is what "
        "this package recommends. Of "
        f"{len(findings)} claims, tested on the recipe `paper`, {counts['yes']} come out as the paper has them, "
        f"{counts['no']} the other way, "
        f"{mixed} hold for some of the algorithms, and {counts['open']} stay open.", "",
        "Full lines are frozen weights (interquartile mean and 95 % interval over runs), dots are training episodes, "
        "exploration included. Returns are in per cent of the way from -1,000 (never escaping) to the best known "
        f"return, {best['paper-figure-1']:g} with one button and {best['paper-figure-2']:g} with two.", "",
    ]
    for name in FIGURES:
        lines += [f"![{CAPTIONS[name]}](figures/{name}.svg)", "", f"*{CAPTIONS[name]} {runs[name]} runs a line.* "
                  f"`hrl-escape compare {name}`", ""]
    lines += ["## Claim by claim", "",
              "Numbers are means over runs with 95 % intervals; scores and shares are in per cent. Each "
              "measurement names the range that confirms its claim; the other side refutes it. A verdict is given "
              "where the test of its side has p < 0.05 (two-sided where one level parts both), corrected over all "
              "claims and algorithms (Benjamini and Hochberg: of the verdicts given, 5 % are wrong at most on "
              "average); otherwise the claim stays open. Every criterion can come out either way. An episode is "
              f"optimal if it scores {OPTIMAL_SCORE:.0%} or more. The last column is what the published 2019 program "
              "gave when it was rerun, its simulation stepped in lockstep, 1 to 3 runs a cell, trained continuously "
              "unless it says *as released*.", "",
              "| | the paper says | measured | recipe `paper` | recipe `corrected` | agree? | published program, rerun "
              "|", "|---|---|---|---|---|---|---|"]
    for number, finding in enumerate(findings, 1):
        claim = finding.claim
        lines.append(f"| {number} | {claim.says} | {claim.measured}: {claim.holds.words} "
                     f"| {_list(finding.paper, claim.unit)} | {_list(finding.corrected, claim.unit) or 'not run'} "
                     f"| {finding.agrees} | {claim.rerun} |")
    lines += ["", "## Where these runs part from the published program", "", *tell_departures(results), "",
              "## All numbers", "",
              "Final score: frozen weights in the last fifth of training, interquartile mean. Slope: of that score "
              "over the second half, in points a budget. Settled: runs in which every evaluation of the last fifth is "
              "optimal. Escapes: training episodes in the last fifth.", "",
              "| figure | agent | final score | slope | settled | escapes in training |", "|---|---|---|---|---|---|"]
    for name in FIGURES:
        for agent in dict.fromkeys(run.agent for run in results[name]):
            lines.append(_make_row(results, name, agent))
    return [*lines, "", "## Make it again", "",
            "One command writes this page, its figures and the raw results in `raw/`; finished runs are kept, and with "
            "`--from-raw` nothing is trained. Each figure alone is one command too, given under it.", "",
            "```console", _COMMAND, "```", "",
            "Why two of the algorithms get worse is asked in [why it worsens](why-it-worsens.md); how much "
            "more learning costs without options, in [the price of flatness](price.md).", ""]


def _count_runs(results: Results, figure: str) -> str:
    counts = sorted(len(get_runs(results, figure, agent)) for agent in {run.agent for run in results[figure]})
    return f"{counts[0]}" if counts[0] == counts[-1] else f"{counts[0]} to {counts[-1]}"


def _make_row(results: Results, figure: str, agent: str) -> str:
    runs = get_runs(results, figure, agent)
    settled = sum(map(has_settled, runs))
    escapes = Measurement(tuple(share_of_training(run, run.training_successes) for run in runs)).estimate()
    return (f"| {figure.removeprefix('paper-')} | {agent} | {_format(measure_final(runs).estimate(), '%')} "
            f"| {_format(measure_slope(runs, False, 0.5).estimate(), 'points')} | {settled} of {len(runs)} "
            f"| {_format(escapes, '%')} |")


def _list(estimates: dict[str, Estimate], unit: str) -> str:
    return "<br>".join(f"{name} {_format(found, unit)}" for name, found in estimates.items())


def _format(found: Estimate, unit: str) -> str:
    sign = "+" if unit == "points" else ""
    value, low, high = (f"{100 * np.round(number, 3) + 0.0:{sign}.{_get_digits(found)}f}"
                        for number in (found.value, found.low, found.high))
    return f"{value} ({low} to {high})"


def _get_digits(found: Estimate) -> int:
    """A decimal where whole numbers would hide the difference to 0 or 100."""
    return 1 if any(0 < number < 0.01 or 0.985 < number < 1 for number in (found.value, found.low, found.high)) else 0
