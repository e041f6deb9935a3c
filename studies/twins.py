"""Studies of twins: agents held against the same agents without one part, in the same rooms with the same seeds.

Such a study is data: its grid, and questions of pairs of agents in `study.toml`. All comparisons of a study are one
family (Holm). Its page extends `twins.md.j2`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hrl_escape.comparison.grid import AgentSpec
from hrl_escape.comparison.inference import compare_pairs, compute_interval, correct_by_holm
from hrl_escape.comparison.pairs import ALPHA
from hrl_escape.comparison.statistics import LEAST_RUNS, compute_iqm
from hrl_escape.comparison.verdict import count_things, tell_privileges
from hrl_escape.settings import read_record
from studies.baseline import BaselineRun
from studies.page import make_table
from studies.study import Page, Study

__all__ = ["Contrast", "Question", "analyse", "compare_twins", "conclude_contrasts", "list_questions"]


@dataclass(frozen=True)
class Question:
    """Question that is asked of every pair of a kind.

    Attributes:
        heading: in the page.
        words: what is held against what.
        who: what each of the agents is, after "at least one": `hierarchy`; of a single agent, its name.
        agents: labels.
        twins: labels of their twins, in the same order; a single one is the twin of all.
    """

    heading: str
    words: str
    who: str
    agents: tuple[str, ...]
    twins: tuple[str, ...]

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Labels of each agent and its twin."""
        return tuple(zip(self.agents, self.twins * (len(self.agents) if len(self.twins) == 1 else 1), strict=True))

    @property
    def labels(self) -> set[str]:
        """Labels of all agents and twins in it."""
        return {*self.agents, *self.twins}


class Contrast(NamedTuple):
    """An agent against its twin in one room, seed by seed.

    Attributes:
        question: number in the study.
        room: name.
        agent: label.
        twin: label.
        measure: `efficiency`, or `first escape`: primitives by which it comes sooner, runs without one
            counting with the whole budget.
        gain: mean difference; above 0 the agent is better.
        p: two-sided, corrected over the study; 1 where too few runs were made to conclude anything.
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


def list_questions(study: Study) -> list[Question]:
    """Questions, in the order of the page."""
    return [read_record(Question, table) for table in study.data["questions"]]


def analyse(study: Study, lines: Sequence[BaselineRun]) -> Page:
    """Contrasts, conclusions and tables of lines; of several budgets the largest counts."""
    budget = max(line.primitives for line in lines)
    lines = sorted((line for line in lines if line.primitives in (0, budget)), key=lambda line: line.place)
    contrasts, rooms, agents = compare_twins(study, lines), _list_rooms(study, lines), _list_agents(study, lines)
    conclusions = conclude_contrasts(study, contrasts, lines)
    (grid,) = study.grids
    questions = [{
        "heading": question.heading, "words": question.words, "findings": _list_findings(number, question, contrasts),
        "few": [room for room in rooms if room not in _list_settled_rooms(study, question, lines)],
        "lost": [room for room in rooms if not any(line.escapes > 0.0 for label in question.labels
                                                   for line in _choose(lines, room, label))],
    } for number, question in enumerate(list_questions(study))]
    return Page({
        "conclusions": conclusions, "budget": budget, "questions": questions, "contrasts": contrasts,
        "episodes": count_things(max(line.episodes for line in lines), "episode"),
        "rooms": {room: _tabulate([_choose(lines, room, agent) for agent in agents]) for room in rooms},
        "left_out": [room.label for room in grid.rooms if room.label not in rooms],
        "privileges": tell_privileges(map(AgentSpec.parse, agents)), "runs": 1 + max(line.seed for line in lines),
    }, conclusions=conclusions)


def compare_twins(study: Study, lines: Sequence[BaselineRun]) -> list[Contrast]:
    """All contrasts of a study that have a run on both sides."""
    found, raw = [], []
    for number, question in enumerate(list_questions(study)):
        for room in _list_rooms(study, lines):
            for agent, twin in question.pairs:
                runs, others = ({run.seed: run for run in _choose(lines, room, label)} for label in (agent, twin))
                seeds = [seed for seed in runs if seed in others]
                if not seeds:
                    continue
                gains = {
                    "efficiency": [runs[seed].efficiency - others[seed].efficiency for seed in seeds],
                    "first escape": [_compute_wait(others[seed]) - _compute_wait(runs[seed]) for seed in seeds],
                }
                for measure, gain in gains.items():
                    test = compare_pairs([np.round(np.array(gain, np.float64), 9)])
                    found.append(Contrast(number, room, agent, twin, measure, test.difference, 1.0))
                    raw.append(test.p if len(seeds) >= LEAST_RUNS else 1.0)
    return [contrast._replace(p=p) for contrast, p in zip(found, correct_by_holm(raw), strict=True)]


def conclude_contrasts(study: Study, contrasts: Sequence[Contrast], lines: Sequence[BaselineRun]) -> list[str]:
    """A sentence a question: in how many rooms at least one agent is better than its twin, and in how many worse."""
    return [f"{question.heading}: {_conclude(number, question, contrasts, _list_settled_rooms(study, question, lines))}"
            for number, question in enumerate(list_questions(study))]


def _conclude(number: int, question: Question, contrasts: Sequence[Contrast], rooms: Sequence[str]) -> str:
    if not rooms:
        return f"nothing is concluded, as no room has {LEAST_RUNS} runs of all agents."
    better, worse = ({contrast.room for contrast in contrasts if contrast.question == number and contrast.room in rooms
                      and contrast.is_shown and sign * contrast.gain > 0} for sign in (1, -1))
    of_rooms = f"of {len(rooms)} rooms" if len(rooms) > 1 else f"room, {rooms[0]}"
    who, are_many = question.who, len(question.pairs) > 1
    words = [f"{f'at least one {who}' if are_many else who} does better in {len(better)} {of_rooms}" if better else
             f"{f'no {who} is' if are_many else f'{who} is not'} shown to do better in "
             f"{'any' if len(rooms) > 1 else 'the one'} {of_rooms}"]
    words += [f"{'at least one ' if are_many else ''}does worse in {len(worse)}"] if worse else []
    return f"{', and '.join(words)}."


def _list_rooms(study: Study, lines: Sequence[BaselineRun]) -> list[str]:
    """Rooms in the grid's order, others after them."""
    known = [room.label for grid in study.grids for room in grid.rooms]
    return sorted({line.rooms for line in lines}, key=lambda room: ([*known, room].index(room), room))


def _list_agents(study: Study, lines: Sequence[BaselineRun]) -> list[str]:
    """Agents in the grid's order, others after them."""
    known = [agent.label for grid in study.grids for agent in grid.agents]
    return sorted({line.agent for line in lines}, key=lambda agent: ([*known, agent].index(agent), agent))


def _list_settled_rooms(study: Study, question: Question, lines: Sequence[BaselineRun]) -> list[str]:
    """Rooms with enough runs of all agents of a question."""
    return [room for room in _list_rooms(study, lines)
            if all(len(_choose(lines, room, label)) >= LEAST_RUNS for label in question.labels)]


def _choose(lines: Sequence[BaselineRun], room: str, agent: str) -> list[BaselineRun]:
    """Lines about an agent in a room."""
    return [line for line in lines if (line.rooms, line.agent) == (room, agent)]


def _compute_wait(run: BaselineRun) -> float:
    """Primitives to the first escape in training; the whole budget without one."""
    return float(run.primitives if run.first_escape is None else min(run.first_escape, run.primitives))


def _list_findings(number: int, question: Question, contrasts: Sequence[Contrast]) -> dict[str, str]:
    """Agent -> where it is better, where worse, in which measure; agents without a run are left out."""
    found = {}
    for agent, twin in question.pairs:
        own = [contrast for contrast in contrasts
               if (contrast.question, contrast.agent, contrast.twin) == (number, agent, twin)]
        words = [text for measure in ("efficiency", "first escape") for sign in (1, -1)
                 if (text := _name_rooms(measure, sign, own))]
        if own:
            found[agent] = "; ".join(words) or "no difference is shown"
    return found


def _name_rooms(measure: str, sign: int, contrasts: Sequence[Contrast]) -> str:
    found = [contrast for contrast in contrasts
             if contrast.is_shown and contrast.measure == measure and sign * contrast.gain > 0]
    if not found:
        return ""
    if measure == "efficiency":
        rooms = [f"{contrast.room} ({contrast.gain:+.2f})" for contrast in found]
        return f"{'more' if sign > 0 else 'less'} efficient in {', '.join(rooms)}"
    rooms = [f"{contrast.room} (by {abs(contrast.gain):,.0f} primitives)" for contrast in found]
    return f"escapes {'sooner' if sign > 0 else 'later'} in {', '.join(rooms)}"


def _tabulate(cells: Sequence[Sequence[BaselineRun]]) -> str:
    """Table of one room; agents without a run have no row."""
    rows: list[Sequence[Any]] = []
    for runs in filter(None, cells):
        scores = np.array([run.efficiency for run in runs])
        low, high = compute_interval(compute_iqm, [scores], (0.0, 1.0), np.random.default_rng(2019))
        escaped = sum(run.first_escape is not None for run in runs)
        rows.append([f"`{runs[0].agent}`", len(runs),
                     f"{float(compute_iqm([scores])):.3f} ({float(low):.3f} to {float(high):.3f})",
                     f"{np.mean([run.progress for run in runs]):.2f}", f"{np.mean([run.escapes for run in runs]):.0%}",
                     f"{np.mean(list(map(_compute_wait, runs))):,.0f} ({escaped} of {len(runs)})"
                     if runs[0].primitives else "no training"])
    return make_table(["agent", "runs", "efficiency", "progress", "escapes", "first escape"], rows)
