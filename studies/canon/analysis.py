"""Every algorithm on the same rooms: comparisons with the best search baseline and with flat controls."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.comparison import Comparison, run_grid
from hrl_escape.benchmark.grid import Grid, GridRun
from hrl_escape.benchmark.launching.local import LocalLauncher
from hrl_escape.benchmark.run_results import RunResult
from hrl_escape.benchmark.statistics import LEAST_RUNS
from hrl_escape.errors import ComparisonError, UnknownNameError
from hrl_escape.names import count_nouns
from hrl_escape.sets.room_spec import RoomSpec
from studies.controls import chooses_presses
from studies.figures import Theme, make_figure, write_label
from studies.running import NO_TRAINING, StudyArgs, refuse_failures
from studies.statistics import Difference, compare_strata, find_lasting
from studies.store import Line, Store
from studies.study import Findings, Study
from studies.tables import format_gain, make_table

__all__ = ["LINES", "Args", "CanonRun", "Contrast", "Family", "analyse", "choose_candidate", "compare",
           "list_families", "measure"]

FLAT_FAMILIES = ("planned presses", "structure learned over presses", "task hierarchies, planned low level")
REFERENCE_EPISODES = 20
"""Episodes of agents that do not learn; some are random."""


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
    """Rooms of each kind; from `study.toml` by default."""
    agents: tuple[str, ...] = ()
    """Agents to run, by label; all by default."""
    minutes: float = math.inf
    """Begin no run after so many minutes."""


@dataclasses.dataclass(frozen=True)
class CanonRun(Line):
    """Result of one run.

    Attributes:
        agent: label.
        candidate: which of its settings, from 1; 0 for agents without settings.
        room: of a rung, in short text, such as `ladder-1/pair/test#0`.
        primitives: training budget; 0 for agents without training.
        efficiency: in the last fifth of training.
        escapes: share of the evaluation episodes there that escaped.
        progress: mean share of the facts on the way to the goal that hold.
        first_escape: primitives to the first escape in training; None if there was none.
        efficient_at: primitives at the first of two evaluations in a row that are efficient; None without such a pair.
        seconds: of training, with another run on the machine.
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

    PLACE = ("agent", "candidate", "room", "primitives")

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
        given: what it is given of the room's puzzle and search baselines have to find; empty for nothing.
    """

    name: str
    what: str
    trials: tuple[str, ...]
    learners: Mapping[str, Sequence[Mapping[str, Any]]]
    given: str = ""


def list_families(study: Study) -> list[Family]:
    """Families, in the order of the page."""
    return [Family(**table) for table in study.data["families"]]


def list_references(study: Study) -> list[str]:
    """Agents that learn nothing, in the order of the page."""
    return [*study.data["chance"], *study.data["search"], *study.data["privileged"]]


# --- runs ------------------------------------------------------------------------------------


def measure(study: Study, args: Args, store: Store) -> None:
    """Make trials, or the runs that are missing, kind by kind and room by room.

    Raises:
        ComparisonError: the trials of a learner are not made, or a run failed.
        UnknownNameError: no such kind or agent.
    """
    data, until = study.data, time.monotonic() + 60 * args.minutes
    references = list_references(study)
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
    """Make the missing runs of a room and keep their lines; yields these.

    Candidates of a learner run as agents of their own; a line has the label of the learner.
    """
    data, there = study.data, {line.place for line in store.load()}
    for learns, budget, step, episodes in ((False, NO_TRAINING, NO_TRAINING, REFERENCE_EPISODES),
                                           (True, data["primitives"], data["eval_every"], 1)):
        own = {f"{agent.label} / {number}": (agent, number) for agent, number in agents if agent.learns == learns}
        if not own or time.monotonic() > until:
            continue
        grid = Grid(f"canon-{'learners' if learns else 'references'}", "", tuple(
            dataclasses.replace(agent, label=label) for label, (agent, _) in own.items()), (RoomSpec(room),),
            runs=1, primitives=budget, eval_every=step, eval_episodes=episodes)
        missing = tuple(agent for agent in grid.agents
                        if (own[agent.label][0].label, own[agent.label][1], room, budget * learns) not in there)
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


def average(runs: Mapping[str, CanonRun]) -> float:
    """Mean efficiency over rooms."""
    return float(np.mean([run.efficiency for run in runs.values()]))


# --- page ------------------------------------------------------------------------------------


class Standing:
    """State of the study: its lines, read.

    Attributes:
        study: the study.
        lines: all.
        families: in the order of the page.
        words: rung -> words on its rooms.
        cells: runs in test rooms with the chosen settings.
        lost: learners that are not followed; see `find_lost`.
        references: agents that learn nothing.
        learners: all learners.
        followed: learners that are run in every kind.
        kinds: rungs where every followed agent was run.
        rooms: for each kind the most rooms that an agent was run in.
        best: the most efficient search baseline of each kind; the choice favours it, so who beats it beats all.
        search: its mean efficiency over the kinds.

    Raises:
        ComparisonError: the first kind lacks runs.
    """

    def __init__(self, study: Study, lines: Sequence[CanonRun]) -> None:
        self.study, self.lines, self.families = study, lines, list_families(study)
        self.words: Mapping[str, str] = study.data["kinds"]
        self.cells = cells = collect_cells(study, lines)
        self.lost, self.references = find_lost(study, cells), list_references(study)
        self.learners = [label for family in self.families for label in family.learners]
        self.followed = [label for label in self.learners if label not in self.lost]
        self.kinds = [kind for kind in self.words if all(
            len(cells.get((kind, agent), ())) >= LEAST_RUNS for agent in (*self.followed, *self.references)
            if fits(study, agent, kind))]
        if (first := next(iter(self.words))) not in self.kinds:
            raise ComparisonError(f"rooms of {first} lack runs: {LEAST_RUNS} of every agent are needed")
        self.rooms = {kind: max(len(runs) for (own, _), runs in cells.items() if own == kind) for kind in self.kinds}
        self.best = {kind: max(study.data["search"], key=lambda agent, kind=kind: average(cells[kind, agent]))
                     for kind in self.kinds}
        self.search = float(np.mean([average(cells[kind, agent]) for kind, agent in self.best.items()]))

    def average(self, label: str) -> float:
        """Mean efficiency of an agent over the kinds where it can be run."""
        own = [kind for kind in self.kinds if fits(self.study, label, kind)]
        return float(np.mean([average(self.cells[kind, label]) for kind in own]))


def analyse(study: Study, lines: Sequence[CanonRun]) -> Findings:
    """Comparisons with the search baseline and with flat controls, tables and figures.

    Covers the kinds of rooms where every agent that is still followed was run.

    Raises:
        ComparisonError: the first kind lacks runs.
    """
    found = Standing(study, lines)
    cells, kinds, words, data = found.cells, found.kinds, found.words, study.data
    given = {label for family in found.families if family.given for label in family.learners}
    bars = {label: {kind: best for kind, best in found.best.items() if fits(study, label, kind)}
            for label in found.followed}
    against, given_graph = (compare([(label, "search", bar) for label, bar in bars.items()
                                     if (label in given) == is_given], cells) for is_given in (False, True))
    flat: Mapping[str, str] = data["controls"]
    controls = compare([(label, control, dict.fromkeys(kinds, control)) for label, control in flat.items()
                        if label not in given], cells)
    beyond = {each.agent: each.found for each in [*against, *given_graph]}
    moves = [label for label in found.learners if not chooses_presses(AgentSpec.parse(label))]
    numbers = SimpleNamespace(
        budget=data["primitives"], kinds=[words[kind] for kind in kinds], rooms=max(found.rooms.values()),
        learners=len(found.learners), episodes=REFERENCE_EPISODES, search=found.search,
        beyond={each.agent: each.found for each in against},
        controls={each.agent: each.found for each in controls},
        means={label: {kind: average(cells[kind, label]) for kind in kinds if cells.get((kind, label))}
               for label in [*found.references, *found.learners]},
        moves=len(moves), lost_moves=sum(label in found.lost for label in moves),
        most_of_moves=max(average(cells[kind, label]) for kind in kinds for label in moves if cells.get((kind, label))))
    columns = [words[kind] for kind in kinds]
    tables = [f"**{family.name.capitalize()}**{f' (given {family.given})' * bool(family.given)}\n\n" + make_table(
        ["learner", *columns, "against the best search baseline"],
        [[name_learner(label), *(describe_cell(found, kind, label) for kind in kinds),
          format_gain(beyond[label]) if label in beyond else ""] for label in family.learners])
              for family in found.families]
    return Findings(numbers, {
        "canon": "\n\n".join(tables),
        "canon_references": make_table(["agent", *columns], [
            [name_learner(label), *(describe_cell(found, kind, label) for kind in kinds)]
            for label in found.references]),
        "canon_controls": make_table(["learner", "flat control", "difference in efficiency"], [
            [name_learner(each.agent), name_learner(each.other), format_gain(each.found)]
            for each in controls]),
        "canon_kinds": make_table(["kind", "rooms"], [[words[kind], f"`{kind}/test#0..{found.rooms[kind]}`"]
                                                      for kind in kinds]),
        "canon_unfit": make_table(["not run", "in", "because"], list_unfit(found)),
        "canon_courses": make_table(
            ["learner", "label", "settings", "progress", "success rate", "first escape",
             f"efficiency of {data['efficient']:g}", "seconds"],
            [list(describe_course(family, label, found)) for family in found.families for label in family.learners]),
    }, {"canon-flat": partial(draw_means, found, FLAT_FAMILIES)})


def name_learner(label: str) -> str:
    """Display name of a learner."""
    return AgentSpec.parse(label).title


def shorten(label: str) -> str:
    """Display name without the part that all learners of a figure share."""
    name = name_learner(label).replace(" over options", "").replace(", with a planned low level", ", task hierarchy")
    return name.replace(", table settings", "")


def list_unfit(found: Standing) -> list[list[str]]:
    """Learners that were not run in some kinds, these kinds and the reason."""
    return [[name_learner(label), ", ".join(out), unfit["why"]] for label, unfit in found.study.data["unfit"].items()
            if (out := [found.words[kind] for kind in found.kinds if not fits(found.study, label, kind)])]


def describe_cell(found: Standing, kind: str, label: str) -> str:
    """Mean efficiency in a kind of rooms, and in how many of them where others were run in more."""
    runs = found.cells.get((kind, label))
    if not runs:
        return ""
    return f"{average(runs):.2f}" + (f" ({len(runs)})" if len(runs) < found.rooms[kind] else "")


def describe_course(family: Family, label: str, found: Standing) -> Iterator[str]:
    """A row on how a learner came to its end: settings, progress, escapes, waits, seconds."""
    number = choose_candidate(family, label, found.lines)[1]
    runs = [run for kind in found.kinds for run in found.cells.get((kind, label), {}).values()]
    settings = " ".join(f"{name}={value}" for name, value in family.learners[label][number - 1].items())
    yield from (name_learner(label), f"`{label}`", f"`{settings}`" if settings else "defaults",
                f"{np.mean([run.progress for run in runs]):.2f}", f"{np.mean([run.escapes for run in runs]):.0%}")
    for name in ("first_escape", "efficient_at"):
        waits = sorted(math.inf if (at := getattr(run, name)) is None else at for run in runs)
        came, middle = sum(map(math.isfinite, waits)), waits[len(waits) // 2]
        yield f"{f'{middle:,}' if math.isfinite(middle) else 'not in half'} ({came} of {len(runs)})"
    yield f"{np.mean([run.seconds for run in runs]):.1f}"


def draw_means(found: Standing, families: Sequence[str], theme: Theme) -> Figure:
    """Mean efficiency of each learner in each kind of rooms (dots) and over all kinds (diamonds)."""
    shown = [label for family in found.families if family.name in families for label in family.learners
             if label not in found.lost and all(fits(found.study, label, kind) for kind in found.kinds)]
    shown.sort(key=found.average)

    def paint(axes: Axes) -> None:
        for row, label in enumerate(shown):
            means = [average(found.cells[kind, label]) for kind in found.kinds]
            axes.plot(means, [row] * len(means), "o", color=theme.lines[1], markersize=4, alpha=0.5, markeredgewidth=0)
            axes.plot(found.average(label), row, "D", color=theme.ink, markersize=5)
        axes.axvline(found.search, color=theme.lines[2], linestyle="--")
        write_label(axes, found.search + 0.01, -1.2, "search baseline", theme.lines[2], fontsize=9)
        axes.set_yticks(range(len(shown)), list(map(shorten, shown)))
        axes.set(xlabel="efficiency after training", xlim=(-0.03, 1.03), ylim=(-1.8, len(shown) - 0.4))

    return make_figure(theme, paint, height=1.1 + 0.23 * len(shown), grid="x")
