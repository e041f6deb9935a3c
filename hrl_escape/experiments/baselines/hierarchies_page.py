"""Gains of synthesised hierarchies: by their structure alone, by planned leaves, and where a planner walks anyway.

The page of docs/results/hierarchies.md, written from a line a run. Each agent is held against its twin with the same
room and training seed; all comparisons of the page are one family (Holm).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hrl_escape.experiments.baselines.lines import LEAST_RUNS, BaselineRun
from hrl_escape.experiments.grid import AgentSpec
from hrl_escape.experiments.inference import compare_pairs, compute_interval, correct_by_holm
from hrl_escape.experiments.pairs import ALPHA
from hrl_escape.experiments.presets import HIERARCHICAL, get_grid
from hrl_escape.experiments.statistics import compute_iqm
from hrl_escape.experiments.verdict import count_things, tell_privileges
from hrl_escape.files import write_text

__all__ = ["GRID_NAME", "QUESTIONS", "Contrast", "Question", "compare_twins", "conclude_contrasts",
           "write_hierarchies_page"]

GRID_NAME = "hierarchies"
_COMMAND = f"hrl-escape experiment {GRID_NAME}"
FLAT, OPTIONS = "q-learning", "smdp-q-learning+no-primitives"


class Question(NamedTuple):
    """Question that is asked of every kind of hierarchy.

    Attributes:
        heading: in the page.
        words: what is held against what.
        pairs: (agent, twin), labels.
    """

    heading: str
    words: str
    pairs: tuple[tuple[str, str], ...]


_LEARNED, _PLANNED = (tuple(f"{name}+{leaves}" for name in HIERARCHICAL) for leaves in ("learned", "planned"))
QUESTIONS = (
    Question("Structure alone", f"Learned leaves against `{FLAT}`, which also learns over primitives, without a "
             "hierarchy", tuple((agent, FLAT) for agent in _LEARNED)),
    Question("Planned leaves", "Planned leaves against learned ones of the same hierarchy",
             tuple(zip(_PLANNED, _LEARNED, strict=True))),
    Question("Structure where a planner walks anyway", f"Planned leaves against `{OPTIONS}`, which chooses among "
             "planned presses, without a hierarchy", tuple((agent, OPTIONS) for agent in _PLANNED)),
)


class Contrast(NamedTuple):
    """An agent against its twin in one room, seed by seed.

    Attributes:
        question: number in `QUESTIONS`.
        room: name.
        agent: label.
        twin: label.
        measure: `efficiency`, or `first escape`: primitives by which it comes sooner, runs without one
            counting with the whole budget.
        gain: mean difference; above 0 the agent is better.
        p: two-sided, corrected over the page; 1 where too few runs were made to conclude anything.
    """

    question: int
    room: str
    agent: str
    twin: str
    measure: str
    gain: float
    p: float

    @property
    def is_shown(self) -> bool:
        """The runs show a difference."""
        return self.p < ALPHA


def compare_twins(lines: Sequence[BaselineRun]) -> list[Contrast]:
    """All contrasts of the page that have a run on both sides."""
    found, raw = [], []
    for number, question in enumerate(QUESTIONS):
        for room in _list_rooms(lines):
            for agent, twin in question.pairs:
                runs, others = ({run.seed: run for run in _choose(lines, room, label)} for label in (agent, twin))
                seeds = [seed for seed in runs if seed in others]
                if not seeds:
                    continue
                gains = {
                    "efficiency": [runs[seed].efficiency - others[seed].efficiency for seed in seeds],
                    "first escape": [_get_wait(others[seed]) - _get_wait(runs[seed]) for seed in seeds],
                }
                for measure, gain in gains.items():
                    test = compare_pairs([np.round(np.array(gain, np.float64), 9)])
                    found.append(Contrast(number, room, agent, twin, measure, test.difference, 1.0))
                    raw.append(test.p if len(seeds) >= LEAST_RUNS else 1.0)
    return [contrast._replace(p=p) for contrast, p in zip(found, correct_by_holm(raw), strict=True)]


def write_hierarchies_page(lines: Sequence[BaselineRun], path: Path) -> list[str]:
    """Write the page; returns its conclusions.

    Args:
        lines: at least one.
        path: the page's file.

    Raises:
        FileWriteError: the file cannot be written.
    """
    contrasts = compare_twins(lines)
    conclusions = conclude_contrasts(contrasts, lines)
    budget, rooms = max(line.primitives for line in lines), _list_rooms(lines)
    episodes = count_things(max(line.episodes for line in lines), "episode")
    text = [
        "# Synthesised hierarchies: structure alone, and with planned leaves", "",
        f"**{' '.join(conclusions)}**", "",
        "[Hierarchies that are given](../hierarchies.md) explains the agents. All learn in tables, at their default "
        "settings, so that twins differ in the hierarchy and in what it tells them; agents with networks were not run. "
        f"{budget:,} primitives of training, then {episodes} of the frozen policy: these rooms have one start "
        "and no chance.", "",
    ]
    for number, question in enumerate(QUESTIONS):
        text += [f"## {question.heading}", "", f"{question.words}.", "",
                 *_list_findings(number, contrasts), ""]
        few = [room for room in rooms if room not in _list_settled_rooms(number, lines)]
        text += [f"Too few runs to conclude anything: {', '.join(few)}.", ""] if few else []
    text += ["A difference is named where a paired t test over training seeds shows it, after Holm's correction for "
             f"all {len(contrasts)} comparisons of this page. Fewer than {LEAST_RUNS} runs: nothing is concluded.", ""]
    for room in rooms:
        text += [f"## {room}", "", *_make_table([line for line in lines if line.rooms == room], budget), ""]
    text += ["Efficiency is 0 without escape, else the fewest primitives known over those taken: interquartile mean "
             "over runs with its 95 % interval. Progress is the share of the goal's ancestors that were lit. First "
             "escape is in training, on average, with runs that never escape counted at the budget.", "",
             *tell_privileges(map(AgentSpec.parse, _list_agents(lines))), "",
             "```console", _make_command(lines), "```", ""]
    write_text(path, "\n".join(text))
    return conclusions


def _make_command(lines: Sequence[BaselineRun]) -> str:
    runs, budget = 1 + max(line.seed for line in lines), max(line.primitives for line in lines)
    return f"{_COMMAND} --runs {runs} --primitives {budget}"


def _list_rooms(lines: Sequence[BaselineRun]) -> list[str]:
    """Rooms in the grid's order, others after them."""
    known = [room.preset for room in get_grid(GRID_NAME).rooms]
    return sorted({line.rooms for line in lines}, key=lambda room: ([*known, room].index(room), room))


def _list_agents(lines: Sequence[BaselineRun]) -> list[str]:
    """Agents in the grid's order, others after them."""
    known = [agent.label for agent in get_grid(GRID_NAME).agents]
    return sorted({line.agent for line in lines}, key=lambda agent: ([*known, agent].index(agent), agent))


def _choose(lines: Sequence[BaselineRun], room: str, agent: str) -> list[BaselineRun]:
    return [line for line in lines if (line.rooms, line.agent) == (room, agent)]


def _get_wait(run: BaselineRun) -> float:
    return float(run.primitives if run.first_escape is None else min(run.first_escape, run.primitives))


# --- words ---------------------------------------------------------------------------------


def conclude_contrasts(contrasts: Sequence[Contrast], lines: Sequence[BaselineRun]) -> list[str]:
    """A sentence a question: in how many rooms some hierarchy is better than its twin, and in how many worse."""
    return [_conclude(number, contrasts, lines) for number in range(len(QUESTIONS))]


def _conclude(number: int, contrasts: Sequence[Contrast], lines: Sequence[BaselineRun]) -> str:
    heading, rooms = QUESTIONS[number].heading, _list_settled_rooms(number, lines)
    if not rooms:
        return f"{heading}: nothing is concluded, as no room has {LEAST_RUNS} runs of all agents."
    better, worse = ({contrast.room for contrast in contrasts if contrast.question == number and contrast.room in rooms
                      and contrast.is_shown and sign * contrast.gain > 0} for sign in (1, -1))
    of_rooms = f"of {len(rooms)} room{'s' if len(rooms) > 1 else ''}"
    words = [f"some hierarchy gains in {len(better)} {of_rooms}" if better else f"no gain is shown in any {of_rooms}"]
    words += [f"some loses in {len(worse)}"] if worse else []
    return f"{heading}: {', '.join(words)}."


def _list_settled_rooms(number: int, lines: Sequence[BaselineRun]) -> list[str]:
    """Rooms with enough runs of all agents of a question."""
    labels = {label for pair in QUESTIONS[number].pairs for label in pair}
    return [room for room in _list_rooms(lines)
            if all(len(_choose(lines, room, label)) >= LEAST_RUNS for label in labels)]


def _list_findings(number: int, contrasts: Sequence[Contrast]) -> list[str]:
    """One line an agent: where it is better, where worse, in which measure."""
    lines = []
    for agent, twin in QUESTIONS[number].pairs:
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


def _make_table(lines: Sequence[BaselineRun], budget: int) -> list[str]:
    rows = ["| agent | runs | efficiency | progress | escapes | first escape |", "|---|---|---|---|---|---|"]
    for agent in _list_agents(lines):
        runs = [line for line in lines if line.agent == agent]
        scores = np.array([run.efficiency for run in runs])
        low, high = compute_interval(compute_iqm, [scores], (0.0, 1.0), np.random.default_rng(2019))
        waited = [_get_wait(run) for run in runs]
        escaped = sum(run.first_escape is not None for run in runs)
        first = f"{np.mean(waited):,.0f} ({escaped} of {len(runs)})" if runs[0].primitives else "no training"
        rows.append(f"| `{agent}` | {len(runs)} | {float(compute_iqm([scores])):.3f} ({float(low):.3f} to "
                    f"{float(high):.3f}) | {np.mean([run.progress for run in runs]):.2f} "
                    f"| {np.mean([run.escapes for run in runs]):.0%} | {first} |")
    return rows
