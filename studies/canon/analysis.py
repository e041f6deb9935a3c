"""The table of the canon: every algorithm on the same rooms, held against the best searcher and its flat control."""

from __future__ import annotations

import dataclasses
import math
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.comparison import Comparison, run_grid
from hrl_escape.benchmark.grid import Grid, GridRun
from hrl_escape.benchmark.launching.local import LocalLauncher
from hrl_escape.benchmark.runs import RunResult
from hrl_escape.benchmark.statistics import LEAST_RUNS
from hrl_escape.env.pictures import palette
from hrl_escape.errors import ComparisonError, UnknownNameError
from hrl_escape.names import count_nouns, join_words
from hrl_escape.sets.room_spec import RoomSpec
from studies.controls import chooses_presses
from studies.figures import FIGURE_STYLE
from studies.page import make_table
from studies.running import NO_TRAINING, StudyArgs, refuse_failures
from studies.statistics import Difference, compare_strata, find_lasting
from studies.store import Store
from studies.study import Page, Study

__all__ = ["LINES", "Args", "CanonRun", "Contrast", "Family", "Standing", "advise", "analyse", "choose_candidate",
           "compare", "list_families", "measure", "shorten", "tell_beyond", "tell_families", "tell_given",
           "tell_leads", "tell_lost", "tell_standing", "tell_controls"]

NAMED = 3
"""Agents that a sentence names at most; tables name all."""
REFERENCE_EPISODES = 20
"""Episodes of those that learn nothing, some of which are random."""


@dataclasses.dataclass(frozen=True)
class Args(StudyArgs):
    """Options of the study."""

    out: Path = Path("runs")
    """Folder of the runs."""
    workers: int | None = None
    """Runs at a time; one a core by default."""
    trials: bool = False
    """Try the settings of each learner in the validation rooms, instead of the study."""
    kinds: tuple[str, ...] = ()
    """Rungs whose rooms are run, as ladder-1/pair; all by default."""
    rooms: int | None = None
    """Rooms of each kind; those of `study.toml` by default."""
    agents: tuple[str, ...] = ()
    """Agents to run, by label; all by default."""
    minutes: float = math.inf
    """Minutes after which no further run is begun."""


@dataclasses.dataclass(frozen=True)
class CanonRun:
    """Result of one run.

    Attributes:
        agent: label.
        candidate: which of its settings, from 1; 0 for agents without settings.
        room: of a rung, in short text, such as `ladder-1/pair/test#0`.
        primitives: training budget; 0 for agents that learn nothing.
        efficiency: in the last fifth of training.
        escapes: share of the evaluation episodes there that escaped.
        progress: mean share of the facts on the way to the goal that hold.
        first_escape: primitives to the first escape in training; None if there was none.
        efficient_at: primitives at the first of two evaluations in a row that are efficient; None without such a pair.
        seconds: of training, beside another run.
        key: hash of everything that decides the run's numbers.
    """

    agent: str
    candidate: int
    room: str
    primitives: int
    efficiency: float
    escapes: float
    progress: float
    first_escape: int | None
    efficient_at: int | None
    seconds: float
    key: str

    @property
    def place(self) -> tuple[str, int, str, int]:
        """Subject of the line: another line about the same replaces it."""
        return self.agent, self.candidate, self.room, self.primitives

    @property
    def kind(self) -> str:
        """Rung of the room."""
        return self.room.rpartition("/")[0]


LINES = (CanonRun,)
Cells: TypeAlias = Mapping[tuple[str, str], Mapping[str, CanonRun]]
"""(kind, agent) -> room -> run."""


class Family(NamedTuple):
    """Learners that choose among the same things by the same kind of means.

    Attributes:
        name: short.
        what: plural noun.
        trials: validation rooms.
        learners: label -> the settings that are tried.
        given: what it is told of the room's puzzle and the searchers have to find; empty for nothing.
    """

    name: str
    what: str
    trials: tuple[str, ...]
    learners: Mapping[str, Sequence[Mapping[str, Any]]]
    given: str = ""


def list_families(study: Study) -> list[Family]:
    """Families, in the order of the page."""
    return [Family(**table) for table in study.data["families"]]


# --- runs ------------------------------------------------------------------------------------


def measure(study: Study, args: Args, store: Store) -> None:
    """Make trials, or the runs that are missing, kind by kind and room by room.

    Raises:
        ComparisonError: the trials of a learner are not made, or a run failed.
        UnknownNameError: no such kind or agent.
    """
    data, until = study.data, time.monotonic() + 60 * args.minutes
    references = [*data["chance"], *data["searchers"], *data["told"]]
    known = [*references, *(label for family in list_families(study) for label in family.learners)]
    for what, chosen, every in (("agent", args.agents, known), ("kind", args.kinds, list(data["kinds"]))):
        if unknown := [name for name in chosen if name not in every]:
            raise UnknownNameError(f"{what} of this study", unknown[0], every)
    families = [family._replace(learners={label: tried for label, tried in family.learners.items()
                                          if label in (args.agents or known)}) for family in list_families(study)]
    made: list[Comparison] = []
    if args.trials:
        for room in dict.fromkeys(room for family in families for room in family.trials):
            made += run_room(study, args, store, room, [
                make_candidate(label, tried, number) for family in families if room in family.trials
                for label, tried in family.learners.items() for number in range(1, len(tried) + 1)], until)
        refuse_failures(*made)
        return
    chosen = [choose_candidate(family, label, store.load()) for family in families for label in family.learners]
    slow = data["slow"]
    for kind in args.kinds or data["kinds"]:
        for index in range(args.rooms or data["rooms"]):
            done = find_lost(study, collect_cells(study, store.load()))
            if index >= slow["rooms"]:
                done |= set(slow["learners"])
            made += run_room(study, args, store, f"{kind}/test#{index}", [
                *((AgentSpec.parse(label), 0) for label in references if label in (args.agents or known)),
                *((agent, number) for agent, number in chosen
                  if agent.label not in done and fits(study, agent.label, kind))], until)
    refuse_failures(*made)


def make_candidate(label: str, tried: Sequence[Mapping[str, Any]], number: int) -> tuple[AgentSpec, int]:
    """A learner with one of its settings, and the number of these."""
    agent = AgentSpec.parse(label)
    return dataclasses.replace(agent, label=label, settings=agent.settings | dict(tried[number - 1])), number


def run_room(study: Study, args: Args, store: Store, room: str, agents: Sequence[tuple[AgentSpec, int]], until: float
             ) -> Iterator[Comparison]:
    """Make the runs of a room of which the store has no line, and keep their lines; yields what was made.

    Candidates of a learner run as agents of their own; the label of a line is that of the learner.
    """
    data, there = study.data, {(line.agent, line.candidate, line.key) for line in store.load()}
    for learns, budget, step, episodes in ((False, NO_TRAINING, NO_TRAINING, REFERENCE_EPISODES),
                                           (True, data["primitives"], data["eval_every"], 1)):
        own = {f"{agent.label} / {number}": (agent, number) for agent, number in agents if agent.learns == learns}
        if not own or time.monotonic() > until:
            continue
        grid = Grid(f"canon-{'learners' if learns else 'references'}", "", tuple(
            dataclasses.replace(agent, label=label) for label, (agent, _) in own.items()), (RoomSpec(room),),
            runs=1, primitives=budget, eval_every=step, eval_episodes=episodes)
        keys = {run.agent.label: run.key for run in grid.make_runs(grid.make_places())}
        missing = tuple(agent for agent in grid.agents
                        if (own[agent.label][0].label, own[agent.label][1], keys[agent.label]) not in there)
        if missing:
            made = run_grid(dataclasses.replace(grid, agents=missing), args.out / "canon",
                            LocalLauncher(args.workers, begin_until=until))
            store.add(make_line(*own[run.agent.label], room, run, result, data["efficient"])
                      for run, result in made.runs)
            yield made


def make_line(agent: AgentSpec, candidate: int, room: str, run: GridRun, result: RunResult, efficient: float
              ) -> CanonRun:
    """Line of a finished run."""
    primitives = (evaluation.primitives for evaluation in result.evaluations)
    lasting = find_lasting(zip(primitives, result.get_curve("efficiency"), strict=True), efficient)
    return CanonRun(
        agent=agent.label, candidate=candidate, room=room, primitives=run.grid.primitives if agent.learns else 0,
        efficiency=round(result.get_final("efficiency"), 4), escapes=round(result.get_final("success_rate"), 4),
        progress=round(result.get_final("mean_progress"), 4),
        first_escape=result.first_escape if agent.learns else None,
        efficient_at=lasting if agent.learns else None,
        seconds=round(result.seconds[-1], 2), key=run.key)


def choose_candidate(family: Family, label: str, lines: Iterable[CanonRun]) -> tuple[AgentSpec, int]:
    """The settings of a learner that were most efficient in the trials, and their number.

    Of equals those that escaped first, on average over the rooms; then the first.

    Raises:
        ComparisonError: a trial is missing.
    """
    tried = family.learners[label]
    trials = {(line.candidate, line.room): line for line in lines if line.agent == label}

    def rate(number: int) -> tuple[float, float]:
        own = [trials[number, room] for room in family.trials if (number, room) in trials]
        if len(own) < len(family.trials):
            raise ComparisonError(f"{label} has {count_nouns(len(own), 'trial')} of {len(family.trials)} with settings "
                                  f"{number}: run python -m studies canon --trials")
        waits = [run.primitives if run.first_escape is None else run.first_escape for run in own]
        return -float(np.mean([run.efficiency for run in own])), float(np.mean(waits))

    return make_candidate(label, tried, min(range(1, len(tried) + 1), key=rate))


def fits(study: Study, label: str, kind: str) -> bool:
    """An agent can be run in rooms of a kind."""
    return kind not in study.data["unfit"].get(label, {"kinds": ()})["kinds"]


def collect_cells(study: Study, lines: Sequence[CanonRun]) -> Cells:
    """Runs in test rooms, with the chosen settings, by kind and agent."""
    chosen: dict[str, int] = {}
    for family in list_families(study):
        for label in family.learners:
            try:
                chosen[label] = choose_candidate(family, label, lines)[1]
            except ComparisonError:
                continue
    cells: dict[tuple[str, str], dict[str, CanonRun]] = {}
    for line in lines:
        if "/test#" in line.room and line.candidate == chosen.get(line.agent, 0):
            cells.setdefault((line.kind, line.agent), {})[line.room] = line
    return cells


def find_lost(study: Study, cells: Cells) -> set[str]:
    """Learners that ended without an escape in every room of the first kind, of `LEAST_RUNS` or more.

    They are run no further.
    """
    easiest = next(iter(study.data["kinds"]))
    return {agent for (kind, agent), runs in cells.items() if kind == easiest and len(runs) >= LEAST_RUNS
            and not any(run.escapes for run in runs.values())}


# --- comparisons -----------------------------------------------------------------------------


class Contrast(NamedTuple):
    """An agent against another, room by room, with kinds as strata of equal weight."""

    agent: str  # label
    other: str  # label of the other, or what it is
    found: Difference  # in efficiency; above 0 the agent is better


def compare(couples: Sequence[tuple[str, str, Mapping[str, str]]], cells: Cells) -> list[Contrast]:
    """Contrasts of one family, of couples that have `LEAST_RUNS` rooms in common in every kind.

    Args:
        couples: label of an agent, name of the other, and the other's label in each kind, which are the strata.
        cells: runs.
    """
    asked = []
    for agent, name, others in couples:
        gains: list[NDArray[np.float64]] = []
        for kind, other in others.items():
            own, theirs = cells.get((kind, agent), {}), cells.get((kind, other), {})
            gains.append(np.array([round(own[room].efficiency - theirs[room].efficiency, 9)
                                   for room in sorted(own.keys() & theirs.keys())], dtype=np.float64))
        if min(map(len, gains), default=0) >= LEAST_RUNS:
            asked.append((agent, name, gains))
    tests = compare_strata([gains for _, _, gains in asked])
    return [Contrast(agent, name, test) for (agent, name, _), test in zip(asked, tests, strict=True)]


def find_best(agents: Sequence[str], cells: Cells, kinds: Sequence[str]) -> dict[str, str]:
    """The agent that is most efficient in each kind; the choice among several favours it, so who beats it beats all."""
    return {kind: max(agents, key=lambda agent, kind=kind: average(cells[kind, agent])) for kind in kinds}


def average(runs: Mapping[str, CanonRun]) -> float:
    """Mean efficiency over rooms."""
    return float(np.mean([run.efficiency for run in runs.values()]))


def average_alike(runs: Mapping[str, Mapping[str, CanonRun]]) -> dict[str, float]:
    """Mean efficiency of each agent over the rooms that all of them have, from its runs by room."""
    rooms = set.intersection(*(set(own) for own in runs.values()))
    return {agent: average({room: own[room] for room in rooms}) for agent, own in runs.items()}


# --- sentences -------------------------------------------------------------------------------


def tell_beyond(beyond: Sequence[Contrast], kinds: int) -> str:
    """The finding: which learners that are given nothing reach more than the best searcher."""
    over = f"over {count_nouns(kinds, 'kind')} of rooms"
    if not beyond:
        return f"Nothing is concluded, as no learner has {LEAST_RUNS} rooms beside a searcher's in every kind."
    better = [each for each in beyond if each.found.sign > 0]
    below = sum(each.found.sign < 0 for each in beyond)
    rest = "none is shown to reach less"
    if below:
        rest = f"{below} of {len(beyond)} {'reaches' if below == 1 else 'reach'} less"
    if not better:
        return f"No learner is shown to beat the best searcher, which learns nothing, {over}; {rest}."
    return (f"{len(better)} of {len(beyond)} learners {'beats' if len(better) == 1 else 'beat'} the best searcher, "
            f"which learns nothing, {over}{_name_most(better)}; {rest}.")


def tell_families(best: Mapping[str, tuple[str, float]], searcher: float) -> str:
    """A sentence: the best learner of each family, in order, and where the best searcher stands among them.

    Args:
        best: family in words -> its best learner, and its mean difference from the best searcher in the same rooms.
        searcher: mean efficiency of the best searcher.
    """
    ordered = sorted(best.items(), key=lambda item: -item[1][1])

    def tell(kept: Sequence[tuple[str, tuple[str, float]]]) -> str:
        return join_words(f"{what} (`{agent}` {gain:+.2f})" for what, (agent, gain) in kept)

    above = [item for item in ordered if item[1][1] > 0]
    under = [item for item in ordered if item[1][1] <= 0]
    parts = [f"above the best searcher ({searcher:.2f}) come {tell(above)}"] if above else []
    if under:
        parts.append(f"{'below it' if above else f'below the best searcher ({searcher:.2f})'} stay {tell(under)}")
    return f"By the best of each family, {'; '.join(parts)}."


def tell_controls(contrasts: Sequence[Contrast]) -> str:
    """A sentence: which hierarchies gain or lose against the flat learner that chooses among the same things."""
    if not contrasts:
        return "No hierarchy has a control with enough rooms in every kind."
    better, worse = ([each for each in contrasts if each.found.sign == sign] for sign in (1, -1))
    level = len(contrasts) - len(better) - len(worse)
    parts = [f"{_agree(len(better), 'gain')}{_name_most(better)}"] if better else ["none gains"]
    if worse:
        parts.append(f"{_agree(len(worse), 'lose')}{_name_most(worse)}")
    if level:
        parts.append(f"{level} cannot be told apart")
    return (f"Of {len(contrasts)} hierarchies held against the flat learner that chooses among the same presses, "
            f"{'; '.join(parts)}.")


def _agree(count: int, verb: str) -> str:
    return f"{count} {verb}{'s' if count == 1 else ''}"


def _name_most(contrasts: Sequence[Contrast]) -> str:
    """The agents of contrasts, the largest differences first and no more than `NAMED`, to follow their number."""
    ordered = sorted(contrasts, key=lambda each: -abs(each.found.mean))
    names = join_words(f"`{each.agent}` ({each.found.mean:+.2f})" for each in ordered[:NAMED])
    return f": {names}" if len(ordered) <= NAMED else f", most of all {names}"


def tell_leads(means: Mapping[str, Mapping[str, float]]) -> str:
    """A sentence: who leads in which kind of rooms; means that are equal to two digits share a lead.

    Args:
        means: kind in words -> learner -> mean efficiency.
    """
    leads = {kind: {agent for agent, mean in found.items() if round(mean, 2) == round(max(found.values()), 2)}
             for kind, found in means.items()}
    everywhere = set.intersection(*leads.values())
    if everywhere:
        first = min(everywhere)
        return (f"One learner leads in every kind of rooms: `{first}`." if len(everywhere) == 1 else
                f"{len(everywhere)} learners share the lead in every kind of rooms, `{first}` among them.")
    told = [f"{_name_leaders(agents)} with {kind}" for kind, agents in leads.items()]
    return f"No one learner leads everywhere (by means to two digits, not tested): {'; '.join(told)}."


def _name_leaders(agents: Set[str]) -> str:
    """Learners that share a lead, or their number where they are more than `NAMED`."""
    names = [f"`{agent}`" for agent in sorted(agents)]
    if len(names) == 1:
        return f"{names[0]} leads"
    return f"{join_words(names) if len(names) <= NAMED else count_nouns(len(names), 'learner')} tie"


def tell_lost(moves: int, lost: Sequence[str], others: Sequence[str], kind: str, budget: int) -> str:
    """A sentence: how many learners end without any escape in the easiest kind of rooms, and are not followed.

    Args:
        moves: number of learners that choose single moves.
        lost: those of them that never escape at the end.
        others: of learners over presses those that do not.
        kind: in words.
        budget: primitives.
    """
    names = join_words(f"`{each}`" for each in others)
    if not lost:
        over = f"; over presses {names} never does" if others else ""
        return f"Every one of {moves} learners of single moves ends with some escape in rooms with {kind}{over}."
    over = f"; over presses {names} as well" if others else ""
    return (f"Of {moves} learners of single moves {_agree(len(lost), 'end')} without an escape in every room with "
            f"{kind} after {budget:,} primitives, hierarchies or not{over}. None of these was run in other rooms.")


def tell_given(contrasts: Sequence[Contrast], given: str) -> str:
    """A sentence: what being told of the puzzle brings, beside the searchers that have to find it.

    Args:
        contrasts: with the best searcher, of those that are told; one at least.
        given: what they are told.
    """
    better = [each for each in contrasts if each.found.sign > 0]
    if not better:
        return f"Even told {given}, no hierarchy is shown to beat the best searcher."
    return (f"Told {given}, which searchers have to find, {len(better)} of {len(contrasts)} hierarchies "
            f"{'beats' if len(better) == 1 else 'beat'} the best of them (by up to "
            f"{max(each.found.mean for each in better):.2f}).")


def advise(beyond: Sequence[Contrast], searcher: str) -> str:
    """Advice that follows from the finding."""
    better = sorted((each for each in beyond if each.found.sign > 0), key=lambda each: -each.found.mean)
    if better:
        rest = len(beyond) - len(better)
        return (f"Begin with `{better[0].agent}` where a planner can press for you and the room stays the same, and "
                f"report a searcher beside your learner: {rest} of {len(beyond)} here are not shown to beat it.")
    return f"Report `{searcher}` beside your learner: nothing here is shown to beat it."


# --- page ------------------------------------------------------------------------------------


def analyse(study: Study, lines: Sequence[CanonRun]) -> Page:
    """Sentences, tables and the figure, of the kinds in which every agent was run that is still followed."""
    found = Standing.read(study, lines)
    values = tell_standing(found)
    figures = {"canon": draw(found)} if found.kinds else {}
    return Page(values, figures, [values["headline"], *values.get("sentences", ())])


@dataclasses.dataclass(frozen=True)
class Standing:
    """State of the study: its lines, read.

    Attributes:
        study: the study.
        lines: all.
        families: in the order of the page.
        cells: runs in test rooms with the chosen settings.
        kinds: rungs in which every agent was run that is followed; none while the first is not.
        lost: learners that are not followed; see `find_lost`.
    """

    study: Study
    lines: Sequence[CanonRun]
    families: Sequence[Family]
    cells: Cells
    kinds: Sequence[str]
    lost: Set[str]

    @classmethod
    def read(cls, study: Study, lines: Sequence[CanonRun]) -> Standing:
        """Make it of lines."""
        cells, families = collect_cells(study, lines), list_families(study)
        found = cls(study, lines, families, cells, (), find_lost(study, cells))
        needed = [*found.followed, *found.references]
        kinds = [kind for kind in study.data["kinds"] if all(
            len(cells.get((kind, agent), ())) >= LEAST_RUNS for agent in needed if fits(study, agent, kind))]
        return dataclasses.replace(found, kinds=kinds if next(iter(study.data["kinds"])) in kinds else ())

    @property
    def words(self) -> Mapping[str, str]:
        """Rung -> words on its rooms."""
        return self.study.data["kinds"]

    @cached_property
    def references(self) -> list[str]:
        """Agents that learn nothing."""
        return [*self.study.data["chance"], *self.study.data["searchers"], *self.study.data["told"]]

    @cached_property
    def learners(self) -> list[str]:
        """All learners."""
        return [label for family in self.families for label in family.learners]

    @cached_property
    def followed(self) -> list[str]:
        """Learners that are run in every kind."""
        return [label for label in self.learners if label not in self.lost]

    @cached_property
    def rooms(self) -> dict[str, int]:
        """For each kind the most rooms that an agent was run in."""
        return {kind: max(len(runs) for (own, _), runs in self.cells.items() if own == kind) for kind in self.kinds}

    @cached_property
    def best(self) -> dict[str, str]:
        """The searcher that is most efficient in each kind."""
        return find_best(self.study.data["searchers"], self.cells, self.kinds)

    @cached_property
    def searcher(self) -> float:
        """Its mean efficiency over the kinds."""
        return float(np.mean([average(self.cells[kind, agent]) for kind, agent in self.best.items()]))

    def average(self, label: str) -> float:
        """Mean efficiency of an agent over the kinds in which it can be run."""
        own = [kind for kind in self.kinds if fits(self.study, label, kind)]
        return float(np.mean([average(self.cells[kind, label]) for kind in own]))


def tell_standing(found: Standing) -> dict[str, Any]:
    """Values of the page's template."""
    study, cells, kinds, words = found.study, found.cells, found.kinds, found.words
    data = study.data
    easiest = words[next(iter(words))]
    if not kinds:
        return {"headline": f"Nothing is concluded yet, as the rooms with {easiest} lack runs: of every agent there "
                            f"must be {LEAST_RUNS}.", "kinds": []}
    flat: Mapping[str, str] = data["controls"]
    given = {label: family.given for family in found.families if family.given for label in family.learners}
    against, told = (compare([
        (label, "the best searcher", {kind: each for kind, each in found.best.items() if fits(study, label, kind)})
        for label in found.followed if (label in given) == is_given], cells) for is_given in (False, True))
    controls = compare([(label, control, dict.fromkeys(kinds, control)) for label, control in flat.items()
                        if label not in given], cells)
    differences = {each.agent: each for each in [*against, *told]}
    tops = {family.what: max(((label, differences[label].found.mean) for label in own), key=lambda item: item[1])
            for family in found.families if (own := [
                label for label in family.learners
                if label in differences and all(fits(study, label, kind) for kind in kinds)])}
    moves = [label for label in found.learners if not chooses_presses(AgentSpec.parse(label))]
    sentences = [
        tell_families(tops, found.searcher), tell_controls(controls),
        tell_leads({words[kind]: average_alike({label: cells[kind, label] for label in found.followed
                                                if label not in given and fits(study, label, kind)})
                    for kind in kinds}),
        tell_lost(len(moves), [label for label in moves if label in found.lost],
                  [label for label in found.learners if label in found.lost and label not in moves], easiest,
                  data["primitives"]),
        *(tell_given(own, what) for what in dict.fromkeys(given.values())
          if (own := [each for each in told if given[each.agent] == what]))]
    tables = [(family.name, family.given, make_table(
        ["learner", *(words[kind] for kind in kinds), "over the best searcher"],
        [[f"`{label}`", *(tell_cell(found, kind, label) for kind in kinds), tell_difference(differences.get(label))]
         for label in family.learners])) for family in found.families]
    bars = make_table(["without learning", *(words[kind] for kind in kinds)], [
        [f"`{label}`", *(tell_cell(found, kind, label) for kind in kinds)] for label in found.references])
    courses = make_table(
        ["learner", "settings", "progress", "escapes", "first escape", f"efficiency of {data['efficient']:g}",
         "seconds"],
        [list(tell_course(family, label, found)) for family in found.families for label in family.learners])
    return {
        "headline": tell_beyond(against, len(kinds)), "sentences": sentences,
        "advice": advise(against, found.best[kinds[-1]]), "tables": tables, "bars": bars, "courses": courses,
        "controls": [f"`{each.agent}` against `{each.other}`: {tell_difference(each)}" for each in controls],
        "kinds": [f"{words[kind]} (`{kind}`)" for kind in kinds],
        "left_out": [f"{words[kind]} (`{kind}`)" for kind in words if kind not in kinds],
        "unfit": tell_unfit(found),
        "rooms": sorted(set(found.rooms.values())),
        "searchers": data["searchers"], "budget": data["primitives"], "efficient": data["efficient"],
        "learners": len(found.learners), "episodes": REFERENCE_EPISODES,
        "trials": [words[room.rpartition("/")[0]]
                   for room in max((family.trials for family in found.families), key=len)],
    }


def tell_unfit(found: Standing) -> list[str]:
    """Learners that were not run in some kinds and why; those that share both stand together."""
    alike: dict[tuple[str, str], list[str]] = {}
    for label, unfit in found.study.data["unfit"].items():
        if out := [found.words[kind] for kind in found.kinds if not fits(found.study, label, kind)]:
            alike.setdefault((join_words(out), unfit["why"]), []).append(f"`{label}`")
    return [f"{join_words(labels)} with {out}, as {why}" for (out, why), labels in alike.items()]


def tell_cell(found: Standing, kind: str, label: str) -> str:
    """Mean efficiency in a kind of rooms, and in how many of them where others were run in more."""
    runs = found.cells.get((kind, label))
    if not runs:
        return ""
    return f"{average(runs):.2f}" + (f" ({len(runs)})" if len(runs) < found.rooms[kind] else "")


def tell_difference(contrast: Contrast | None) -> str:
    """A difference with its interval; bold where it is shown."""
    if contrast is None:
        return ""
    found = contrast.found
    text = f"{found.mean:+.2f} ({found.low:+.2f} to {found.high:+.2f})"
    return f"**{text}**" if found.sign else text


def tell_course(family: Family, label: str, found: Standing) -> Iterator[str]:
    """A row on how a learner came to its end: settings, progress, escapes, waits, seconds."""
    number = choose_candidate(family, label, found.lines)[1]
    runs = [run for kind in found.kinds for run in found.cells.get((kind, label), {}).values()]
    settings = " ".join(f"{name}={value}" for name, value in family.learners[label][number - 1].items())
    yield from (f"`{label}`", f"`{settings}`" if settings else "defaults",
                f"{np.mean([run.progress for run in runs]):.2f}", f"{np.mean([run.escapes for run in runs]):.0%}")
    for name in ("first_escape", "efficient_at"):
        waits = sorted(math.inf if (at := getattr(run, name)) is None else at for run in runs)
        came, middle = sum(map(math.isfinite, waits)), waits[len(waits) // 2]
        yield f"{f'{middle:,}' if math.isfinite(middle) else 'not in half'} ({came} of {len(runs)})"
    yield f"{np.mean([run.seconds for run in runs]):.1f}"


def shorten(labels: Sequence[str]) -> dict[str, str]:
    """Specs without the parts that all of a family share, but where two would be the same."""
    bare = {label: label.removesuffix("+learned").removesuffix("+planned") for label in labels}
    counts = Counter(bare.values())
    return {label: name if counts[name] == 1 else label for label, name in bare.items()}


def draw(found: Standing) -> Figure:
    """A row a learner, by family: a dot a room in the colour of its kind, a diamond the mean over kinds.

    The diamond of a learner that is not run in some kinds is open.
    """
    cells, kinds, families = found.cells, found.kinds, found.families
    colours = dict(zip(kinds, [*palette.LINES, palette.MUTED], strict=False))
    names, rows = shorten(found.learners), found.learners
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(8.4, 0.185 * len(rows) + 0.3 * len(families) + 1.0), facecolor=palette.BACKGROUND,
                        layout="constrained")
        panels = figure.subplots(len(families), 1, sharex=True, squeeze=False, height_ratios=[
            len(family.learners) + 1.2 for family in families]).ravel()
        for panel, family in zip(panels, families, strict=True):
            for row, label in enumerate(family.learners):
                for number, kind in enumerate(kinds):
                    values = [run.efficiency for run in cells.get((kind, label), {}).values()]
                    offset = 0.5 * ((number + 0.5) / len(kinds) - 0.5)
                    panel.plot(values, np.full(len(values), row + offset), ".", markersize=4, alpha=0.45,
                               markeredgewidth=0, color=colours[kind])
                if label not in found.lost:
                    whole = all(fits(found.study, label, kind) for kind in kinds)
                    panel.plot(found.average(label), row, "D", markersize=5, color=palette.INK,
                               fillstyle="full" if whole else "none")
            panel.axvline(found.searcher, color=palette.INK, linestyle="--", linewidth=1)
            panel.set(ylim=(len(family.learners) - 0.4, -0.6), xlim=(-0.03, 1.05))
            panel.set_yticks(range(len(family.learners)), [names[label] for label in family.learners])
            panel.set_title(family.name + (f" (told {family.given})" if family.given else ""), loc="left", fontsize=9,
                            color=palette.INK)
            panel.grid(axis="x", color="#e5dfd2", linewidth=0.8)
            panel.set_axisbelow(True)
            panel.spines[["top", "right"]].set_visible(False)
            panel.tick_params(colors=palette.MUTED, labelcolor=palette.INK, labelsize=7)
        panels[-1].set_xlabel("efficiency; the dashed line is the best searcher, which learns nothing",
                              color=palette.INK, fontsize=8)
        handles = [Line2D([], [], marker="o", linestyle="", markersize=4, color=colours[kind],
                                           label=found.words[kind]) for kind in kinds]
        figure.legend(handles=handles, loc="outside upper center", ncols=min(4, len(kinds)), frameon=False, fontsize=8)
    return figure
