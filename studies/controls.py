"""Studies of controls: agents held against the same agents without one part, in the same rooms with the same seeds.

Such a study is data: its grid, and questions of pairs of agents in `study.toml`. A pair is one test over all rooms, and
the pairs of all questions are one family (Holm). A further question is what learning adds: each learner is compared
with the best search baseline. Its page extends `controls.md.j2`.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.inference import ALPHA, compute_interval
from hrl_escape.benchmark.references.registry import SEARCH_BASELINES
from hrl_escape.benchmark.statistics import LEAST_RUNS, compute_iqm
from hrl_escape.benchmark.verdict import count_things, tell_privileges
from hrl_escape.env.pictures import palette
from hrl_escape.names import join_words
from hrl_escape.settings import read_record
from studies.baseline import BaselineRun
from studies.figures import FIGURE_STYLE, finish_axes
from studies.page import make_table
from studies.statistics import compare_strata, find_visible_difference, tell_power
from studies.study import Page, Study

__all__ = ["Advice", "Contrast", "Question", "analyse", "choose_advice", "chooses_presses", "compare_controls",
           "compare_with_chance", "compare_with_searchers", "find_forced", "find_repeated_rooms", "group",
           "list_questions", "tell_beyond", "tell_question", "tell_visible"]


@dataclass(frozen=True)
class Advice:
    """Advice to a user that follows from a question, in the words of its answer.

    Attributes:
        question: its heading; empty for the comparison with the best search baseline.
        gains: sentence if some agent gains significantly; `{names}` are these agents, and `{first}` gains most.
        loses: sentence if none gains and some loses significantly; `{names}` are these agents.
        open: said otherwise.
    """

    question: str
    gains: str
    open: str
    loses: str = ""


@dataclass(frozen=True)
class Question:
    """Question that is asked of every pair of a kind.

    Attributes:
        heading: in the page.
        words: what is held against what.
        who: what each of the agents is: `hierarchy`, or of a single agent its name in code.
        agents: labels.
        controls: labels of their controls, in the same order; a single one is the control of all.
        many: plural of `who`.
    """

    heading: str
    words: str
    who: str
    agents: tuple[str, ...]
    controls: tuple[str, ...]
    many: str = ""

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
        gain: mean of these; above 0 the agent is better.
        low: lower end of its interval, which leaves out 0 where the test shows a difference.
        high: upper end.
        p: two-sided, corrected over the family.
        visible: smallest gain that the test would have seen in 80 % of such studies.
        equal: rooms where all runs of both are equal, first escape and efficiency, and some run escapes.
    """

    agent: str
    other: str
    rooms: Mapping[str, float]
    gain: float
    low: float
    high: float
    p: float
    visible: float
    equal: tuple[str, ...]

    @property
    def is_same(self) -> bool:
        """Both run alike in every room, so that nothing was compared."""
        return len(self.equal) == len(self.rooms)

    @property
    def is_better(self) -> bool:
        """The runs show that the agent gains."""
        return self.p < ALPHA and self.gain > 0

    @property
    def is_worse(self) -> bool:
        """The runs show that the agent loses."""
        return self.p < ALPHA and self.gain < 0


Cell = Mapping[int, BaselineRun]
"""Runs of an agent in a room by seed."""
Cells = Mapping[tuple[str, str], Cell]
"""By room and label."""


def list_questions(study: Study) -> list[Question]:
    """Questions, in the order of the page."""
    return [read_record(Question, table) for table in study.data["questions"]]


def analyse(study: Study, lines: Sequence[BaselineRun]) -> Page:
    """Contrasts, conclusions, tables and figure of lines; of several budgets the largest counts."""
    budget = max(line.primitives for line in lines)
    lines = sorted((line for line in lines if line.primitives in (0, budget)), key=lambda line: line.place)
    agents = _list_agents(study, lines)
    shown = _list_rooms(study, lines)
    repeated = find_repeated_rooms(group(lines), shown)
    rooms = [room for room in shown if room not in repeated]
    cells = {place: runs for place, runs in group(lines).items() if place[0] in rooms}
    asked = list_questions(study)
    questions = list(zip(asked, compare_controls(asked, cells, rooms), strict=True))
    beyond, chance = compare_with_searchers(cells, rooms, agents), compare_with_chance(cells, rooms, agents)
    headline = tell_beyond(beyond, len(rooms))
    told = [tell_question(question, contrasts, beyond, chance) for question, contrasts in questions]
    (grid,) = study.grids
    answers = {"": beyond, **{question.heading: contrasts for question, contrasts in questions}}
    visible = tell_visible([contrast for _, contrasts in questions for contrast in contrasts])
    return Page({
        "headline": headline, "budget": budget, "visible": visible,
        "advice": choose_advice([read_record(Advice, table) for table in study.data["advice"]], answers),
        "beyond": list(map(_tell_contrast, beyond)),
        "questions": [{"heading": question.heading, "words": question.words, "told": sentence,
                       "pairs": list(map(_tell_contrast, contrasts))}
                      for (question, contrasts), sentence in zip(questions, told, strict=True)],
        "episodes": count_things(max(line.episodes for line in lines), "episode"),
        "cases": [*(f"`{room}` and `{first}` are one task: all {count} runs agree in both. It counts once."
                    for room, (first, count) in repeated.items()), *_tell_lost(cells, rooms, agents),
                  *_tell_forced(cells, rooms, agents)],
        "rooms": {room: _tabulate([list(group(lines).get((room, agent), {}).values()) for agent in agents])
                  for room in shown},
        "left_out": [room.label for room in grid.rooms if room.label not in shown],
        "privileges": tell_privileges(map(AgentSpec.parse, agents)), "runs": 1 + max(line.seed for line in lines),
        "figure": study.name, "gist_length": study.data.get("gist", 3),
    }, {study.name: draw(cells, rooms, agents)}, [headline, *told])


# --- what is compared ------------------------------------------------------------------------


def group(lines: Sequence[BaselineRun]) -> dict[tuple[str, str], dict[int, BaselineRun]]:
    """Runs by room and agent, then by seed."""
    cells: dict[tuple[str, str], dict[int, BaselineRun]] = {}
    for line in lines:
        cells.setdefault((line.rooms, line.agent), {})[line.seed] = line
    return cells


def find_repeated_rooms(cells: Cells, rooms: Sequence[str]) -> dict[str, tuple[str, int]]:
    """Rooms whose runs all equal the runs in an earlier room: one task under two names.

    Returns:
        Room -> the earlier room, and how many runs of at least two agents agree.
    """
    found: dict[str, tuple[str, int]] = {}
    for first, room in itertools.combinations(rooms, 2):
        both = [(runs[seed], cells[first, agent][seed]) for (place, agent), runs in cells.items() if place == room
                for seed in runs.keys() & cells.get((first, agent), {}).keys()]
        agents = {one.agent for one, _ in both if one.primitives}
        if len(agents) > 1 and len(both) >= LEAST_RUNS and all(map(_are_equal, *zip(*both, strict=True))) and any(
                one.first_escape is not None for one, _ in both):
            found.setdefault(room, (first, len(both)))
    return found


def find_forced(cells: Cells, room: str, agent: str) -> bool:
    """True if a learner's runs are equal for every seed, in first escape and efficiency: it had no choice."""
    runs = list(cells.get((room, agent), {}).values())
    return (len(runs) >= LEAST_RUNS and runs[0].primitives > 0 and runs[0].first_escape is not None
            and all(_are_equal(run, runs[0]) for run in runs))


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


def compare_with_searchers(cells: Cells, rooms: Sequence[str], agents: Sequence[str]) -> list[Contrast]:
    """Compare each learner with the best search baseline of each room.

    The best is chosen after the fact, which favours the baseline: a learner that beats it beats all.
    """
    searchers = [agent for agent in agents if AgentSpec.parse(agent).name in SEARCH_BASELINES]
    best = {room: max((agent for agent in searchers if len(cells.get((room, agent), {})) >= LEAST_RUNS),
                      key=lambda agent, room=room: _average(cells[room, agent]), default="") for room in rooms}
    return _compare([(agent, "the best searcher", best) for agent in agents if AgentSpec.parse(agent).learns], cells,
                    rooms)


def compare_with_chance(cells: Cells, rooms: Sequence[str], agents: Sequence[str]) -> list[Contrast]:
    """Each learner against random choices among what it chooses among."""
    chance = {spec.chooses_options: agent for agent in agents if (spec := AgentSpec.parse(agent)).algorithm == "random"}
    return _compare([(agent, other, dict.fromkeys(rooms, other)) for agent in agents
                     if (spec := AgentSpec.parse(agent)).learns and (other := chance.get(chooses_presses(spec)))],
                    cells, rooms)


def chooses_presses(spec: AgentSpec) -> bool:
    """An agent chooses among planned presses, or calls a planned low level; others choose single moves."""
    return spec.chooses_options or spec.low_level == "planned"


def _compare(couples: Sequence[tuple[str, str, Mapping[str, str]]], cells: Cells, rooms: Sequence[str]
             ) -> list[Contrast]:
    """Contrasts of one family (Holm), for couples with `LEAST_RUNS` pairs in every room."""
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
    return [Contrast(agent, other, {room: float(own.mean()) for room, own in zip(rooms, gains, strict=True)}, *test,
                     find_visible_difference(gains, ALPHA / len(asked)), equal)
            for (agent, other, gains, equal), test in zip(asked, tests, strict=True)]


def _pair(runs: Cell, others: Cell) -> list[tuple[BaselineRun, BaselineRun]]:
    return [(runs[seed], others[seed]) for seed in sorted(runs.keys() & others.keys())]


def _average(runs: Cell) -> float:
    return float(np.mean([run.efficiency for run in runs.values()]))


# --- words -----------------------------------------------------------------------------------


def tell_beyond(beyond: Sequence[Contrast], rooms: int) -> str:
    """The finding: learners that reach more than the best search baseline, over all rooms."""
    if not beyond:
        return f"Nothing is concluded, as no learner has {LEAST_RUNS} runs beside a searcher's in every room."
    better = [contrast for contrast in beyond if contrast.is_better]
    of = f"in {count_things(rooms, 'room')}"
    if not better:
        level = sum(not contrast.is_worse for contrast in beyond)
        rest = f"{level} of {len(beyond)} are not shown to reach less" if level else f"all {len(beyond)} reach less"
        return f"No learner is shown to beat the best searcher that learns nothing {of}; {rest}."
    names = join_words(f"`{contrast.agent}`" for contrast in better)
    return f"{len(better)} of {len(beyond)} learners beat the best searcher that learns nothing {of}: {names}."


def tell_question(question: Question, contrasts: Sequence[Contrast], beyond: Sequence[Contrast],
                  chance: Sequence[Contrast]) -> str:
    """Return a sentence about gains over controls, compared with search baselines and the random policy."""
    if not contrasts:
        return f"{question.heading}: nothing is concluded, as no pair has {LEAST_RUNS} runs in every room."
    same = [contrast for contrast in contrasts if contrast.is_same]
    asked = [contrast for contrast in contrasts if contrast not in same]
    better, worse = ([contrast for contrast in asked if getattr(contrast, name)] for name in ("is_better", "is_worse"))
    are_many = len(question.pairs) > 1
    many = question.many or f"{question.who}s"
    parts = []
    if better:
        gains = sorted(contrast.gain for contrast in better)
        span = f"{gains[0]:+.2f}" + (f" to {gains[-1]:+.2f}" if len(gains) > 1 else "")
        parts.append(f"{len(better)} of {len(contrasts)} {many} gain ({span})" if are_many
                     else f"{question.who} gains ({span})")
        above = {contrast.agent for contrast in beyond if contrast.is_better}
        beating = sum(contrast.agent in above for contrast in better)
        parts.append("none of them beats the best searcher" if not beating else
                     f"{'it beats' if len(better) == 1 else f'{beating} of them beat'} the best searcher too")
        lucky = [contrast.agent for contrast in chance if contrast.p >= ALPHA]
        if level := [f"`{contrast.agent}`" for contrast in better if contrast.agent in lucky]:
            parts.append(f"{join_words(level)} {'is' if len(level) == 1 else 'are'} not shown to beat chance")
    elif asked:
        parts.append(f"none of {len(contrasts)} {many} is shown to gain" if are_many
                     else f"{question.who} is not shown to gain")
    if worse:
        losses = join_words(f"`{contrast.agent}` ({contrast.gain:+.2f})" for contrast in worse)
        parts.append(f"{losses} lose{'s' if len(worse) == 1 else ''}")
    if same:
        names = join_words(f"`{contrast.agent}`" for contrast in same)
        controls = "its control" if len(same) == 1 else "their controls"
        parts.append(f"{names} and {controls} run alike in every room, so nothing was compared")
    return f"{question.heading}: {', '.join(parts)}."


def choose_advice(advice: Sequence[Advice], answers: Mapping[str, Sequence[Contrast]]) -> str:
    """A sentence for each question, by its answer."""
    said = []
    for part in advice:
        contrasts = sorted(answers[part.question], key=lambda contrast: -contrast.gain)
        better, worse = ([f"`{contrast.agent}`" for contrast in contrasts if getattr(contrast, name)]
                         for name in ("is_better", "is_worse"))
        words, names = ((part.gains, better) if better else (part.loses, worse) if worse and part.loses else
                        (part.open, []))
        said.append(words.format(names=join_words(names), first="".join(names[:1])))
    return " ".join(said)


def tell_visible(contrasts: Sequence[Contrast]) -> str:
    """Differences that the tests could have seen, by the spread of the runs; empty where nothing was compared."""
    return tell_power([contrast.visible for contrast in contrasts if not contrast.is_same], "a gain of",
                      "{:.2f}".format)


def _tell_contrast(contrast: Contrast) -> str:
    verdict = "gains" if contrast.is_better else "loses" if contrast.is_worse else "no difference is shown"
    rooms = ", ".join(f"{room} {gain:+.2f}" for room, gain in contrast.rooms.items())
    equal = f"; equal run for run in {join_words(contrast.equal)}" if contrast.equal else ""
    other = contrast.other if " " in contrast.other else f"`{contrast.other}`"
    return (f"`{contrast.agent}` against {other}: {verdict}, "
            f"{contrast.gain:+.2f} ({contrast.low:+.2f} to {contrast.high:+.2f}); {rooms}{equal}.")


def _tell_lost(cells: Cells, rooms: Sequence[str], agents: Sequence[str]) -> list[str]:
    """Rooms whose efficiency does not distinguish learners, because none escapes."""
    learners = [agent for agent in agents if AgentSpec.parse(agent).learns]
    lost = [room for room in rooms
            if not any(run.escapes for agent in learners for run in cells.get((room, agent), {}).values())]
    said = f"In {join_words(lost)} no learner escapes after training: this budget does not tell them apart."
    return [said] * bool(lost)


def _tell_forced(cells: Cells, rooms: Sequence[str], agents: Sequence[str]) -> list[str]:
    told = []
    for agent in agents:
        if forced := [room for room in rooms if find_forced(cells, room, agent)]:
            told.append(f"`{agent}` runs alike with every seed in {join_words(forced)}: what it is told leaves it no "
                        "choice there.")
    return told


def _list_rooms(study: Study, lines: Sequence[BaselineRun]) -> list[str]:
    """Rooms in the grid's order, others after them."""
    known = [room.label for grid in study.grids for room in grid.rooms]
    return sorted({line.rooms for line in lines}, key=lambda room: ([*known, room].index(room), room))


def _list_agents(study: Study, lines: Sequence[BaselineRun]) -> list[str]:
    """Agents in the grid's order, others after them."""
    known = [agent.label for grid in study.grids for agent in grid.agents]
    return sorted({line.agent for line in lines}, key=lambda agent: ([*known, agent].index(agent), agent))


# --- table and figure ------------------------------------------------------------------------


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
        rows.append([f"`{runs[0].agent}`", len(runs),
                     f"{float(compute_iqm([scores])):.3f} ({float(low):.3f} to {float(high):.3f})",
                     f"{np.mean([run.progress for run in runs]):.2f}", f"{np.mean([run.escapes for run in runs]):.0%}",
                     f"{np.mean(list(map(_compute_wait, runs))):,.0f} ({escaped} of {len(runs)})"
                     if runs[0].primitives else "no training"])
    return make_table(["agent", "runs", "efficiency", "progress", "escapes", "first escape"], rows)


def draw(cells: Cells, rooms: Sequence[str], agents: Sequence[str]) -> Figure:
    """Mean efficiency over rooms, a dot a room: learners from the best down, lines for references."""
    def average(agent: str) -> list[float]:
        return [_average(cells[room, agent]) for room in rooms if (room, agent) in cells]

    specs = {agent: AgentSpec.parse(agent) for agent in agents}
    learners = sorted((agent for agent in agents if specs[agent].learns), key=lambda agent: np.mean(average(agent)))
    searchers = [agent for agent in agents if specs[agent].name in SEARCH_BASELINES]
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(7.6, 1.2 + 0.24 * len(learners)), facecolor=palette.BACKGROUND, layout="constrained")
        axes = figure.subplots()
        for at, agent in enumerate(learners):
            values = average(agent)
            axes.plot(values, [at] * len(values), "o", markersize=3.5, alpha=0.45, color=palette.LINES[0],
                      markeredgewidth=0, label=None if at else "a room")
            axes.plot(np.mean(values), at, "D", markersize=6, color=palette.LINES[0],
                      label=None if at else "mean over rooms")
        best = [max((_average(cells[room, agent]) for agent in searchers if (room, agent) in cells), default=0.0)
                for room in rooms]
        if any(best):
            axes.axvline(float(np.mean(best)), color=palette.INK, linewidth=1.4, label="best searcher without learning")
        for agent in agents:
            if specs[agent].algorithm == "random" and specs[agent].chooses_options:
                axes.axvline(float(np.mean(average(agent))), color=palette.MUTED, linestyle="--", linewidth=1.2,
                             label="random options")
        axes.set_yticks(range(len(learners)), learners)
        axes.set_xlabel("efficiency after training", color=palette.INK)
        finish_axes(axes)
        axes.set_xlim(-0.03, 1.03)
        axes.xaxis.set_major_formatter("{x:.1f}")
        axes.set_xticks(np.linspace(0, 1, 6))
        axes.grid(visible=False, axis="y")
        axes.grid(axis="x", color="#e5dfd2", linewidth=0.8)
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    return figure
