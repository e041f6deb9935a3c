"""Agents held against their twins: the same rooms and training seeds, the difference one part of the agent.

A study is data: its grid, and questions of pairs of agents. All comparisons of a study are one family (Holm).
`twins_page.py` writes the page.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hrl_escape.comparison.baselines.lines import LEAST_RUNS, BaselineRun
from hrl_escape.comparison.inference import compare_pairs, correct_by_holm
from hrl_escape.comparison.pairs import ALPHA
from hrl_escape.comparison.presets import get_grid

__all__ = ["Contrast", "Question", "TwinStudy", "choose_lines", "compare_twins", "compute_wait", "conclude_contrasts",
           "list_rooms", "list_settled_rooms"]


class Question(NamedTuple):
    """Question that is asked of every pair of a kind.

    Attributes:
        heading: in the page.
        words: what is held against what.
        who: the agents together, as the subject of a sentence about any of them: `some hierarchy`; of one, its name.
        pairs: (agent, twin), labels.
    """

    heading: str
    words: str
    who: str
    pairs: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class TwinStudy:
    """A study, as data.

    Attributes:
        name: of its grid and of its raw results.
        command: of `hrl-escape experiment`, which is the name of its page too.
        title: of the page.
        introduction: what the agents are and have in common.
        questions: in the order of the page.
        episodes: what an episode of the frozen policy says of a room, in words.
        notes: paragraphs after the tables.
    """

    name: str
    command: str
    title: str
    introduction: str
    questions: tuple[Question, ...]
    episodes: str = "these rooms have one start and no chance"
    notes: tuple[str, ...] = ()


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


def compare_twins(study: TwinStudy, lines: Sequence[BaselineRun]) -> list[Contrast]:
    """All contrasts of a study that have a run on both sides."""
    found, raw = [], []
    for number, question in enumerate(study.questions):
        for room in list_rooms(study, lines):
            for agent, twin in question.pairs:
                runs, others = ({run.seed: run for run in choose_lines(lines, room, label)} for label in (agent, twin))
                seeds = [seed for seed in runs if seed in others]
                if not seeds:
                    continue
                gains = {
                    "efficiency": [runs[seed].efficiency - others[seed].efficiency for seed in seeds],
                    "first escape": [compute_wait(others[seed]) - compute_wait(runs[seed]) for seed in seeds],
                }
                for measure, gain in gains.items():
                    test = compare_pairs([np.round(np.array(gain, np.float64), 9)])
                    found.append(Contrast(number, room, agent, twin, measure, test.difference, 1.0))
                    raw.append(test.p if len(seeds) >= LEAST_RUNS else 1.0)
    return [contrast._replace(p=p) for contrast, p in zip(found, correct_by_holm(raw), strict=True)]


def conclude_contrasts(study: TwinStudy, contrasts: Sequence[Contrast], lines: Sequence[BaselineRun]) -> list[str]:
    """A sentence a question: in how many rooms some agent is better than its twin, and in how many worse."""
    return [_conclude(study, number, contrasts, lines) for number in range(len(study.questions))]


def _conclude(study: TwinStudy, number: int, contrasts: Sequence[Contrast], lines: Sequence[BaselineRun]) -> str:
    question, rooms = study.questions[number], list_settled_rooms(study, number, lines)
    if not rooms:
        return f"{question.heading}: nothing is concluded, as no room has {LEAST_RUNS} runs of all agents."
    better, worse = ({contrast.room for contrast in contrasts if contrast.question == number and contrast.room in rooms
                      and contrast.is_shown and sign * contrast.gain > 0} for sign in (1, -1))
    of_rooms = f"of {len(rooms)} rooms" if len(rooms) > 1 else f"room, {rooms[0]}"
    words = [f"{question.who} gains in {len(better)} {of_rooms}" if better else
             f"no gain is shown in {'any' if len(rooms) > 1 else 'the one'} {of_rooms}"]
    loser = "some" if len(question.pairs) > 1 else question.who
    words += [f"{loser} loses in {len(worse)}"] if worse else []
    return f"{question.heading}: {', '.join(words)}."


def list_rooms(study: TwinStudy, lines: Sequence[BaselineRun]) -> list[str]:
    """Rooms in the grid's order, others after them."""
    known = [room.label for room in get_grid(study.name).rooms]
    return sorted({line.rooms for line in lines}, key=lambda room: ([*known, room].index(room), room))


def list_settled_rooms(study: TwinStudy, number: int, lines: Sequence[BaselineRun]) -> list[str]:
    """Rooms with enough runs of all agents of a question."""
    labels = {label for pair in study.questions[number].pairs for label in pair}
    return [room for room in list_rooms(study, lines)
            if all(len(choose_lines(lines, room, label)) >= LEAST_RUNS for label in labels)]


def choose_lines(lines: Sequence[BaselineRun], room: str, agent: str) -> list[BaselineRun]:
    """Lines about an agent in a room."""
    return [line for line in lines if (line.rooms, line.agent) == (room, agent)]


def compute_wait(run: BaselineRun) -> float:
    """Primitives to the first escape in training; the whole budget without one."""
    return float(run.primitives if run.first_escape is None else min(run.first_escape, run.primitives))
