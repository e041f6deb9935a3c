"""The page of a study of twins, written from a line a run: conclusions, findings by question, a table a room."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hrl_escape.comparison.baselines.lines import LEAST_RUNS, BaselineRun
from hrl_escape.comparison.baselines.twins import (
    Contrast,
    TwinStudy,
    choose_lines,
    compare_twins,
    compute_wait,
    conclude_contrasts,
    list_rooms,
    list_settled_rooms,
)
from hrl_escape.comparison.grid import AgentSpec
from hrl_escape.comparison.inference import compute_interval
from hrl_escape.comparison.presets import get_grid
from hrl_escape.comparison.statistics import compute_iqm
from hrl_escape.comparison.verdict import count_things, tell_privileges
from hrl_escape.files import write_text
from hrl_escape.names import join_words

__all__ = ["write_twins_page"]


def write_twins_page(study: TwinStudy, lines: Sequence[BaselineRun], path: Path, more: Sequence[str] = ()) -> list[str]:
    """Write the page; returns its conclusions.

    Args:
        study: what was asked.
        lines: at least one.
        path: the page's file.
        more: lines of Markdown between the findings and the tables.

    Raises:
        FileWriteError: the file cannot be written.
    """
    contrasts = compare_twins(study, lines)
    conclusions = conclude_contrasts(study, contrasts, lines)
    budget, rooms = max(line.primitives for line in lines), list_rooms(study, lines)
    episodes = count_things(max(line.episodes for line in lines), "episode")
    text = [
        f"# {study.title}", "", f"**{' '.join(conclusions)}**", "",
        f"{study.introduction} {budget:,} primitives of training, then {episodes} of the frozen policy: "
        f"{study.episodes}.", "",
    ]
    for number, question in enumerate(study.questions):
        text += [f"## {question.heading}", "", f"{question.words}.", "",
                 *_list_findings(study, number, contrasts), ""]
        few = [room for room in rooms if room not in list_settled_rooms(study, number, lines)]
        text += [f"The conclusion leaves {join_words(few)} out, where not all of these agents have {LEAST_RUNS} runs.",
                 ""] if few else []
        lost = [room for room in rooms if not _has_escapes(study, number, lines, room)]
        text += [f"In {join_words(lost)} none of these agents escapes after training: efficiency cannot tell them "
                 "apart there, and a larger budget might.", ""] if lost else []
    text += ["A difference is named where a paired t test over training seeds shows it, after Holm's correction for "
             f"all {len(contrasts)} comparisons of this page. Fewer than {LEAST_RUNS} runs: nothing is concluded.", "",
             *more]
    left_out = [room.label for room in get_grid(study.name).rooms if room.label not in rooms]
    text += [f"Not run: {join_words(left_out)}.", ""] if left_out else []
    agents = _list_agents(study, lines)
    for room in rooms:
        text += [f"## {room}", "", *_make_table([choose_lines(lines, room, agent) for agent in agents]), ""]
    text += ["Efficiency is 0 without escape, else the fewest primitives known over those taken: interquartile mean "
             "over runs with its 95 % interval. Progress is the share of the goal's ancestors that were lit. First "
             "escape is in training, on average, with runs that never escape counted at the budget.", "",
             *(line for note in (*study.notes, *tell_privileges(map(AgentSpec.parse, agents))) for line in (note, "")),
             "```console", _make_command(study, lines), "```", ""]
    write_text(path, "\n".join(text))
    return conclusions


def _make_command(study: TwinStudy, lines: Sequence[BaselineRun]) -> str:
    runs, budget = 1 + max(line.seed for line in lines), max(line.primitives for line in lines)
    return f"hrl-escape experiment {study.command} --runs {runs} --primitives {budget}"


def _list_agents(study: TwinStudy, lines: Sequence[BaselineRun]) -> list[str]:
    """Agents in the grid's order, others after them."""
    known = [agent.label for agent in get_grid(study.name).agents]
    return sorted({line.agent for line in lines}, key=lambda agent: ([*known, agent].index(agent), agent))


def _has_escapes(study: TwinStudy, number: int, lines: Sequence[BaselineRun], room: str) -> bool:
    """Any frozen policy of a question's agents escapes from a room."""
    labels = {label for pair in study.questions[number].pairs for label in pair}
    return any(line.escapes > 0.0 for label in labels for line in choose_lines(lines, room, label))


def _list_findings(study: TwinStudy, number: int, contrasts: Sequence[Contrast]) -> list[str]:
    """One line an agent: where it is better, where worse, in which measure."""
    lines = []
    for agent, twin in study.questions[number].pairs:
        own = [contrast for contrast in contrasts
               if (contrast.question, contrast.agent, contrast.twin) == (number, agent, twin)]
        shown = [contrast for contrast in own if contrast.is_shown]
        if not own:
            continue
        words = [text for measure in ("efficiency", "first escape") for sign in (1, -1)
                 if (text := _name_rooms(measure, sign, shown))]
        lines.append(f"- `{agent}`: {'; '.join(words) or 'no difference is shown'}.")
    return lines


def _name_rooms(measure: str, sign: int, shown: Sequence[Contrast]) -> str:
    found = [contrast for contrast in shown if contrast.measure == measure and sign * contrast.gain > 0]
    if not found:
        return ""
    if measure == "efficiency":
        start, rooms = ("more efficient" if sign > 0 else "less efficient"), [
            f"{contrast.room} ({contrast.gain:+.2f})" for contrast in found]
    else:
        start, rooms = ("escapes sooner" if sign > 0 else "escapes later"), [
            f"{contrast.room} (by {abs(contrast.gain):,.0f} primitives)" for contrast in found]
    return f"{start} in {', '.join(rooms)}"


def _make_table(cells: Sequence[Sequence[BaselineRun]]) -> list[str]:
    """Table of one room; agents without a run have no row."""
    rows = ["| agent | runs | efficiency | progress | escapes | first escape |", "|---|---|---|---|---|---|"]
    for runs in filter(None, cells):
        scores = np.array([run.efficiency for run in runs])
        low, high = compute_interval(compute_iqm, [scores], (0.0, 1.0), np.random.default_rng(2019))
        waited = [compute_wait(run) for run in runs]
        escaped = sum(run.first_escape is not None for run in runs)
        first = f"{np.mean(waited):,.0f} ({escaped} of {len(runs)})" if runs[0].primitives else "no training"
        rows.append(f"| `{runs[0].agent}` | {len(runs)} | {float(compute_iqm([scores])):.3f} ({float(low):.3f} to "
                    f"{float(high):.3f}) | {np.mean([run.progress for run in runs]):.2f} "
                    f"| {np.mean([run.escapes for run in runs]):.0%} | {first} |")
    return rows
