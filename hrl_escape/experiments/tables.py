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

from hrl_escape.experiments.statistics import compute_score
from hrl_escape.experiments.summary import AgentSummary, Summary
from hrl_escape.experiments.verdict import Sentence, find_first_reach
from hrl_escape.files import write_text

__all__ = ["write_markdown", "write_tables"]


def write_tables(summary: Summary, folder: Path) -> None:
    """Write `results.csv` (a row a run), `curves.csv` (a row an evaluation) and `timings.csv`.

    Raises:
        FileWriteError: a file cannot be written.
    """
    results, curves, timings = [], [], []
    for cell, result in summary.runs:
        run = (cell.agent.label, cell.room, cell.instance_id, cell.seed)
        worst, top = result.scale.worst, float(np.mean(result.scale.best))
        final, success, length = map(result.get_final, ("mean_return", "success_rate", "mean_length"))
        results.append((*run, float(compute_score(final, worst, top)), final, success, length, int(result.is_stuck),
                        worst, top, float(np.mean(result.scale.reachable)), result.primitives, result.decisions,
                        result.episodes, result.planner_calls, cell.key))
        for evaluation, seconds in zip(result.evaluations, result.seconds, strict=True):
            at = (*run, evaluation.primitives, evaluation.decisions)
            curves.append((*at, float(compute_score(evaluation.mean_return, worst, top)), evaluation.mean_return,
                           evaluation.success_rate, evaluation.mean_length))
            timings.append((*run, evaluation.primitives, seconds, evaluation.seconds))
    head = ("agent", "room", "instance", "seed")
    _write(folder / "results.csv", (*head, "score", "return", "success", "length", "stuck", "worst", "best",
                                    "reachable", "primitives", "decisions", "episodes", "planner_calls", "key"),
           results)
    _write(folder / "curves.csv", (*head, "primitives", "decisions", "score", "return", "success", "length"), curves)
    _write(folder / "timings.csv", (*head, "primitives", "training_seconds", "evaluation_seconds"), timings)


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
    rooms = f"each of {len(grid.rooms)} rooms" if len(grid.rooms) > 1 else "one room"
    lines += ["", f"After {grid.primitives:,} primitives, {grid.runs} runs in {rooms}; the score is 0 without "
              "escape and 1 at the best known return.", ""]
    lines += ["| agent | score (IQM, 95 % interval) | escapes | primitives an episode | area under the curve "
              "| primitives to 0.95 | stuck runs | missing: options + learning |", "|---|---|---|---|---|---|---|---|"]
    lines += [_make_row(agent) for agent in summary.agents]
    cautions = [f"- {sentence.text}" for sentence in verdict if sentence.kind == "caution"]
    lines += ["", *(["Read with care:", "", *cautions, ""] if cautions else []), "Rooms: " + "; ".join(
        f"{room.name}, instance `{room.instance.id}`, best known return {room.best:g}" for room in summary.rooms) + ".",
        "", "```console", command, "```", ""]
    write_text(path, "\n".join(lines))


def _make_row(agent: AgentSummary) -> str:
    reach = find_first_reach(agent)
    return (f"| {agent.label} | {agent.score.value:.3f} ({agent.score.low:.3f} to {agent.score.high:.3f}) "
            f"| {agent.success.value:.0%} | {agent.length.value:.0f} | {agent.area.value:.3f} "
            f"| {'never' if reach is None else f'{reach:,.0f}'} | {agent.stuck:.0%} "
            f"| {agent.gap.options:.3f} + {agent.gap.learning:.3f} |")
