"""Studies of controls: agents compared with the same agents without one part, in the same rooms with the same seeds.

Such a study is data: its grid, and questions of pairs of agents in `study.toml`. A pair is one test over all rooms, and
the pairs of all questions are one family (Holm). Each learner is also compared with the best search baseline.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.inference import compute_interval
from hrl_escape.benchmark.references.registry import SEARCH_BASELINES
from hrl_escape.benchmark.statistics import LEAST_RUNS, compute_iqm
from hrl_escape.settings import read_record
from studies.baseline import BaselineRun
from studies.statistics import Difference, compare_strata
from studies.study import Findings, Study
from studies.tables import format_gain, make_table

__all__ = ["Contrast", "Question", "analyse", "chooses_presses", "compare_controls", "compare_with_search",
           "find_repeated_rooms", "group", "list_questions"]


@dataclass(frozen=True)
class Question:
    """Comparison of agents with their controls.

    Attributes:
        heading: short name.
        agents: labels.
        controls: labels of their controls, in the same order; a single one is the control of all.
    """

    heading: str
    agents: tuple[str, ...]
    controls: tuple[str, ...]

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Labels of each agent and its control."""
        times = len(self.agents) if len(self.controls) == 1 else 1
        return tuple(zip(self.agents, self.controls * times, strict=True))


class Contrast(NamedTuple):
    """An agent against another over all rooms, seed by seed.

    Attributes:
        agent: label.
        other: label of the control, or what it is.
        rooms: mean difference of efficiency in each room.
        found: difference over the rooms; above 0 the agent is better.
        equal: rooms where all runs of both are equal, first escape and efficiency, and some run escapes.
    """

    agent: str
    other: str
    rooms: Mapping[str, float]
    found: Difference
    equal: tuple[str, ...]

    @property
    def is_same(self) -> bool:
        """Both run alike in every room, so nothing was compared."""
        return len(self.equal) == len(self.rooms)

    @property
    def is_better(self) -> bool:
        """The runs show that the agent gains."""
        return self.found.sign > 0

    @property
    def is_worse(self) -> bool:
        """The runs show that the agent loses."""
        return self.found.sign < 0


Cell = Mapping[int, BaselineRun]
"""Runs of an agent in a room by seed."""
Cells = Mapping[tuple[str, str], Cell]
"""By room and label."""


def list_questions(study: Study) -> list[Question]:
    """Questions, in the order of the page."""
    return [read_record(Question, table) for table in study.data["questions"]]


# --- what is compared ------------------------------------------------------------------------


def group(lines: Sequence[BaselineRun]) -> dict[tuple[str, str], dict[int, BaselineRun]]:
    """Runs by room and agent, then by seed."""
    cells: dict[tuple[str, str], dict[int, BaselineRun]] = {}
    for line in lines:
        cells.setdefault((line.rooms, line.agent), {})[line.seed] = line
    return cells


def find_repeated_rooms(cells: Cells, rooms: Sequence[str]) -> set[str]:
    """Rooms where every run of two agents or more equals the run in an earlier room: one task under two names."""
    found: set[str] = set()
    for first, room in itertools.combinations(rooms, 2):
        both = [(runs[seed], cells[first, agent][seed]) for (place, agent), runs in cells.items() if place == room
                for seed in runs.keys() & cells.get((first, agent), {}).keys()]
        agents = {one.agent for one, _ in both if one.primitives}
        if len(agents) > 1 and len(both) >= LEAST_RUNS and all(map(_are_equal, *zip(*both, strict=True))) and any(
                one.first_escape is not None for one, _ in both):
            found.add(room)
    return found


def _are_equal(one: BaselineRun, other: BaselineRun) -> bool:
    return (one.efficiency, one.escapes, one.first_escape) == (other.efficiency, other.escapes, other.first_escape)


def compare_controls(questions: Sequence[Question], cells: Cells, rooms: Sequence[str]) -> list[list[Contrast]]:
    """Each agent against its control, question by question; pairs that lack runs somewhere are left out.

    All questions are one family, as a page is wrong if one of its sentences is.
    """
    found = {(contrast.agent, contrast.other): contrast for contrast in _compare(
        [(agent, control, dict.fromkeys(rooms, control)) for question in questions
         for agent, control in question.pairs], cells, rooms)}
    return [[found[pair] for pair in question.pairs if pair in found] for question in questions]


def compare_with_search(cells: Cells, rooms: Sequence[str], agents: Sequence[str]) -> list[Contrast]:
    """Each learner against the most efficient search baseline of each room.

    The choice of the best one favours the baseline: a learner that beats it beats all.
    """
    baselines = [agent for agent in agents if AgentSpec.parse(agent).name in SEARCH_BASELINES]
    best = {room: max((agent for agent in baselines if len(cells.get((room, agent), {})) >= LEAST_RUNS),
                      key=lambda agent, room=room: _average(cells[room, agent]), default="") for room in rooms}
    learners = [agent for agent in agents if AgentSpec.parse(agent).learns]
    return _compare([(agent, "the best search baseline", best) for agent in learners], cells, rooms)


def chooses_presses(spec: AgentSpec) -> bool:
    """An agent chooses among planned presses, or calls a planned low level; others choose single moves."""
    return spec.chooses_options or spec.low_level == "planned"


def _compare(couples: Sequence[tuple[str, str, Mapping[str, str]]], cells: Cells, rooms: Sequence[str]
             ) -> list[Contrast]:
    """Contrasts of one family (Holm), of couples that have `LEAST_RUNS` pairs in every room."""
    asked: list[tuple[str, str, list[NDArray[np.float64]], tuple[str, ...]]] = []
    for agent, other, others in couples:
        pairs = {room: _pair(cells.get((room, agent), {}), cells.get((room, others[room]), {})) for room in rooms}
        if not pairs or min(map(len, pairs.values())) < LEAST_RUNS:
            continue
        gains = [np.array([round(one.efficiency - two.efficiency, 9) for one, two in pairs[room]], dtype=np.float64)
                 for room in rooms]
        asked.append((agent, other, gains, tuple(
            room for room in rooms if all(_are_equal(one, two) for one, two in pairs[room])
            and any(one.first_escape is not None for one, _ in pairs[room]))))
    tests = compare_strata([gains for _, _, gains, _ in asked])
    means = [{room: float(own.mean()) for room, own in zip(rooms, gains, strict=True)} for _, _, gains, _ in asked]
    return [Contrast(agent, other, mean, test, equal)
            for (agent, other, _, equal), mean, test in zip(asked, means, tests, strict=True)]


def _pair(runs: Cell, others: Cell) -> list[tuple[BaselineRun, BaselineRun]]:
    return [(runs[seed], others[seed]) for seed in sorted(runs.keys() & others.keys())]


def _average(runs: Cell) -> float:
    return float(np.mean([run.efficiency for run in runs.values()]))


# --- findings ------------------------------------------------------------------------------


def analyse(study: Study, lines: Sequence[BaselineRun]) -> Findings:
    """Contrasts of all questions and with the best search baseline, and tables, of runs with the largest budget."""
    budget = max(line.primitives for line in lines)
    lines = sorted((line for line in lines if line.primitives in (0, budget)), key=lambda line: line.place)
    agents, shown = _list_agents(study, lines), _list_rooms(study, lines)
    every = group(lines)
    repeated = find_repeated_rooms(every, shown)
    rooms = [room for room in shown if room not in repeated]
    cells = {place: runs for place, runs in every.items() if place[0] in rooms}
    questions = list_questions(study)
    contrasts = compare_controls(questions, cells, rooms)
    beyond = compare_with_search(cells, rooms, agents)
    learners = [agent for agent in agents if AgentSpec.parse(agent).learns]
    numbers = SimpleNamespace(
        budget=budget, rooms=len(rooms), runs=1 + max(line.seed for line in lines),
        questions={question.heading: {each.agent: each for each in own}
                   for question, own in zip(questions, contrasts, strict=True)},
        beyond={each.agent: each for each in beyond},
        success={agent: float(np.mean([run.escapes for room in rooms for run in cells[room, agent].values()]))
                 for agent in learners if all((room, agent) in cells for room in rooms)})
    name = study.name.replace("-", "_")
    return Findings(numbers, {
        f"{name}_controls": make_table(["question", "learner", "control", "difference in efficiency", "rooms"], [
            [question.heading, *_describe_contrast(each)]
            for question, own in zip(questions, contrasts, strict=True) for each in own]),
        f"{name}_beyond": make_table(["learner", "against", "difference in efficiency", "rooms"],
                                     [_describe_contrast(each) for each in beyond]),
        f"{name}_rooms": "\n\n".join(f"**{room}**\n\n" + _tabulate(
            [list(every.get((room, agent), {}).values()) for agent in agents]) for room in shown)})


def _describe_contrast(contrast: Contrast) -> list[str]:
    """Cells of a table: both agents, the difference (bold where it is significant) and the difference in each room."""
    other = AgentSpec.parse(contrast.other).title if " " not in contrast.other else contrast.other
    return [AgentSpec.parse(contrast.agent).title, other,
            "equal runs" if contrast.is_same else format_gain(contrast.found),
            ", ".join(f"{room} {gain:+.2f}" for room, gain in contrast.rooms.items())]


def _list_rooms(study: Study, lines: Sequence[BaselineRun]) -> list[str]:
    """Rooms in the grid's order, others after them."""
    known = [room.label for grid in study.grids for room in grid.rooms]
    return sorted({line.rooms for line in lines}, key=lambda room: ([*known, room].index(room), room))


def _list_agents(study: Study, lines: Sequence[BaselineRun]) -> list[str]:
    """Agents in the grid's order, others after them."""
    known = [agent.label for grid in study.grids for agent in grid.agents]
    return sorted({line.agent for line in lines}, key=lambda agent: ([*known, agent].index(agent), agent))


def _compute_wait(run: BaselineRun) -> float:
    """Primitives to the first escape in training; the whole budget without one."""
    return float(run.primitives if run.first_escape is None else min(run.first_escape, run.primitives))


def _tabulate(cells: Sequence[Sequence[BaselineRun]]) -> str:
    """Table of one room; agents without a run have no row."""
    rows: list[Sequence[Any]] = []
    for runs in filter(None, cells):
        scores = np.array([run.efficiency for run in runs])
        low, high = compute_interval(compute_iqm, [scores], (0.0, 1.0), np.random.default_rng(2019))
        escaped = sum(run.first_escape is not None for run in runs)
        rows.append([AgentSpec.parse(runs[0].agent).title, f"`{runs[0].agent}`", len(runs),
                     f"{float(compute_iqm([scores])):.3f} ({float(low):.3f} to {float(high):.3f})",
                     f"{np.mean([run.progress for run in runs]):.2f}", f"{np.mean([run.escapes for run in runs]):.0%}",
                     f"{np.mean(list(map(_compute_wait, runs))):,.0f} ({escaped} of {len(runs)})"
                     if runs[0].primitives else "no training"])
    return make_table(["agent", "label", "runs", "efficiency", "progress", "success rate", "first escape"], rows)
