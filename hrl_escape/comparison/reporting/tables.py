"""The numbers of a comparison as files for other programs, and its Markdown summary.

`results.csv` and `curves.csv` hold only what learning decides, so two comparisons of the same grid write
the same bytes; wall-clock times stand apart in `timings.csv`.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from hrl_escape.comparison.places import RunPlace
from hrl_escape.comparison.runs import RunResult
from hrl_escape.comparison.statistics import compute_score
from hrl_escape.comparison.summary import AgentSummary, Summary
from hrl_escape.comparison.verdict import Sentence
from hrl_escape.files import write_text

MEASURES = ("efficiency", "mean_progress", "success_rate", "mean_length")
_HEADINGS = ("efficiency", "progress", "success", "length")


def write_tables(summary: Summary, folder: Path) -> None:
    """Write `results.csv` (a row a run), `curves.csv` (a row an evaluation), `timings.csv`, and `trials.csv` if any.

    Raises:
        FileWriteError: a file cannot be written.
    """
    results, curves, timings, trials = [], [], [], []
    for run, result in summary.runs:
        head = (run.agent.label, run.room, run.place_id, run.seed)
        worst, top = result.score_range.worst, float(np.mean(result.score_range.best))
        final = result.get_final("mean_return")
        results.append((*head, *map(result.get_final, MEASURES), float(compute_score(final, worst, top)), final,
                        "" if result.first_escape is None else result.first_escape, int(result.is_stuck), worst, top,
                        *_describe_reach(result), "" if (seen := result.seen_efficiency) is None else seen,
                        result.primitives, result.decisions, result.episodes,
                        result.planner_calls, run.key))
        trials += [(*head, number, efficiency, trial.success_rate, trial.mean_length) for number, (efficiency, trial)
                   in enumerate(zip(result.trial_efficiencies, result.trials, strict=True), start=1)]
        lines = [result.get_curve(measure) for measure in MEASURES]
        for evaluation, seconds, *values in zip(result.evaluations, result.seconds, *lines, strict=True):
            at = (*head, evaluation.primitives, evaluation.decisions)
            curves.append((*at, *values, float(compute_score(evaluation.mean_return, worst, top)),
                           evaluation.mean_return))
            timings.append((*head, evaluation.primitives, seconds, evaluation.seconds))
    names = ("agent", "room", "instance", "seed")
    _write(folder / "results.csv", (*names, *_HEADINGS, "return_score", "return", "first_escape", "stuck", "worst",
                                    "best", "reachable", "fewest", "fewest_reachable", "seen_efficiency",
                                    "primitives", "decisions", "episodes", "planner_calls", "key"), results)
    _write(folder / "curves.csv", (*names, "primitives", "decisions", *_HEADINGS, "return_score", "return"), curves)
    if trials:
        _write(folder / "trials.csv", (*names, "trial", "efficiency", "success", "length"), trials)
    _write(folder / "timings.csv", (*names, "primitives", "training_seconds", "evaluation_seconds"), timings)


def _describe_reach(result: RunResult) -> tuple[float, float, float | str]:
    """Best return within reach, fewest primitives known, and fewest within reach; empty where nothing is."""
    ends = result.score_range
    reach = [fewest for fewest in ends.fewest_reachable if fewest is not None]
    complete = len(reach) == len(ends.fewest_reachable)
    return float(np.mean(ends.reachable)), float(np.mean(ends.fewest)), float(np.mean(reach)) if complete else ""


def _write(path: Path, head: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(rows)
    write_text(path, text.getvalue())


def write_markdown(summary: Summary, verdict: Sequence[Sentence], command: str, path: Path) -> None:
    """Write the verdict and the table of results, ready for a README or an issue.

    Raises:
        FileWriteError: the file cannot be written.
    """
    grid = summary.grid
    lines = [f"# {grid.name}", "", f"**{verdict[0].text}**", ""]
    lines += [f"- {sentence.text}" for sentence in verdict[1:] if sentence.kind == "finding"]
    count, are_sets = len(summary.rooms), bool(grid.train_rooms)
    one, many = ("set of rooms", "sets of rooms") if are_sets else ("room", "rooms")
    rooms = f"each of {count} {many}" if count > 1 else f"one {one}"
    lines += ["", f"After {grid.primitives:,} primitives, {grid.runs} runs in {rooms}. Efficiency is "
              "0 without escape, else the fewest primitives known over those taken.", ""]
    seen = "| in rooms trained in " * are_sets
    lines += [f"| agent | efficiency (IQM, 95 % interval) {seen}| progress | escapes (Wilson) | primitives an episode "
              "| first escape | return score | stuck runs | missing: options + learning |",
              "|---|---|---|---|---|---|---|---|---|" + "---|" * are_sets]
    lines += [_make_row(agent, are_sets) for agent in summary.agents]
    cautions = [f"- {sentence.text}" for sentence in verdict if sentence.kind == "caution"]
    lines += ["", *(["Read with care:", "", *cautions, ""] if cautions else []), "Rooms: " + "; ".join(
        f"{room.name}, {describe_place(room.place)}, best known escape {room.fewest:g} primitives, return "
        f"{room.best:g}" for room in summary.rooms) + ".",
        "", "```console", command, "```", ""]
    write_text(path, "\n".join(lines))


def _make_row(agent: AgentSummary, are_sets: bool) -> str:
    return (f"| {agent.label} | {agent.efficiency.value:.3f} ({agent.efficiency.low:.3f} to "
            f"{agent.efficiency.high:.3f}) | {_format_seen(agent) * are_sets}{agent.progress.value:.2f} "
            f"| {agent.success.value:.0%} ({agent.success.low:.0%} to {agent.success.high:.0%}) "
            f"| {agent.length.value:.0f} | {format_first_escape(agent)} | {agent.score.value:.3f} | {agent.stuck:.0%} "
            f"| {agent.gap.options:.3f} + {agent.gap.learning:.3f} |")


def _format_seen(agent: AgentSummary) -> str:
    if agent.seen is None:
        return "- | "
    return f"{agent.seen.value:.3f} ({agent.seen.low:.3f} to {agent.seen.high:.3f}) | "


def describe_place(place: RunPlace) -> str:
    """Identity of a room; of a split the numbers of rooms, and how many of the rooms and tasks tested in are known."""
    if place.split is None:
        return f"instance `{place.id}`"
    split = place.split
    return (f"{len(split.train)} rooms to train in, {len(split.test)} to be tested in, where {split.room_overlap:.0%} "
            f"of the rooms and {split.task_overlap:.0%} of the tasks are trained in too")


def format_first_escape(agent: AgentSummary) -> str:
    """`1,234 (8 of 8 runs)`: restricted mean of the primitives to the first escape; none for references."""
    if agent.spec.is_reference:
        return "no training"
    return f"{agent.first_escape.value:,.0f} ({agent.escaped_runs} of {agent.runs})"
