"""The gallery of puzzles: fewest operators and a planned escape of each room, and how a few agents do in it."""

from __future__ import annotations

import dataclasses
import statistics
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.evaluation import Evaluation, evaluate
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.benchmark.runs import make_agent_env
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.pictures import palette
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.symbolic import SymbolicModel
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import UnsupportedError
from hrl_escape.planning.planner import get_planner
from hrl_escape.planning.symbolic.operator_order import find_relevant_operators
from hrl_escape.settings import read_record
from studies.figures import FIGURE_STYLE
from studies.page import make_table
from studies.running import StudyArgs
from studies.store import Store
from studies.study import Page, Study

__all__ = ["LINES", "Args", "Entry", "PlayedRun", "SolvedRoom", "analyse", "count_fewest", "list_entries", "measure"]


@dataclasses.dataclass(frozen=True)
class Args(StudyArgs):
    """Options of the gallery."""

    presets: tuple[str, ...] = ()
    """Puzzles to measure; all by default."""
    runs: int = 2
    """Training seeds of the agent that learns."""
    primitives: int = 20_000
    """Training budget of a run."""
    episodes: int = 5
    """Evaluation episodes of an agent in a room."""


@dataclasses.dataclass(frozen=True)
class Entry:
    """A puzzle of the gallery.

    Attributes:
        preset: name of its room.
        title: heading.
        rules: three sentences.
        level: how exactly it is the published domain, of `exactness` in `study.toml`.
        carries: published numbers that hold in the room.
        carries_not: those that do not, and why.
        optimum: the best that can be done; `{fewest}` stands for the fewest operators, which are measured, and
            `{expected}` for their mean number where a press may do nothing.
    """

    preset: str
    title: str
    rules: str
    level: str
    carries: str
    carries_not: str
    optimum: str

    @property
    def name(self) -> str:
        """The title without its source."""
        return self.title.split(" (")[0].split(", after")[0]


@dataclasses.dataclass(frozen=True)
class SolvedRoom:
    """Effort of solving a room.

    Attributes:
        preset: name; the room is that of instance seed 0, from its first start.
        fewest: fewest operators of the symbolic model; with the most likely outcomes where there is chance.
        success: probability that a press has its effect; 1 unless the puzzle says otherwise.
        planned: primitives of the planner's escape; None under physics, where nothing is planned ahead.
    """

    preset: str
    fewest: int
    success: float
    planned: int | None

    @property
    def place(self) -> str:
        """Subject of the line."""
        return self.preset


@dataclasses.dataclass(frozen=True)
class PlayedRun:
    """Evaluation of an agent in a room at the end.

    Attributes:
        preset: name.
        agent: name.
        seed: of training.
        primitives: trained for.
        escapes: for each evaluation episode, its primitives; None if it did not escape.
    """

    preset: str
    agent: str
    seed: int
    primitives: int
    escapes: tuple[int | None, ...]

    @property
    def place(self) -> tuple[str, str, int, int, int]:
        """Subject of the line."""
        return self.preset, self.agent, self.seed, self.primitives, len(self.escapes)


LINES = (SolvedRoom, PlayedRun)


def list_entries(study: Study) -> list[Entry]:
    """Puzzles, in the order of the page."""
    return [read_record(Entry, table) for table in study.data["puzzle"]]


def measure(study: Study, args: Args, store: Store) -> None:
    """Measure what is missing, room after room, and keep each finding at once."""
    for found in _measure_missing(study, args, store):
        store.add([found])


def _measure_missing(study: Study, args: Args, store: Store) -> Iterator[SolvedRoom | PlayedRun]:
    there, learner = {line.place for line in store.load()}, study.data["learner"]
    players = (*study.data["players"], study.data["informed"])
    for preset in args.presets or [entry.preset for entry in list_entries(study)]:
        room = generate(get_preset(preset), 0)
        if preset not in there:
            yield _solve_room(preset, room)
        for agent in players:
            if agent == learner and room.dynamics.kind == "physics":  # it would take minutes
                continue
            for seed in range(args.runs if agent == learner else 1):
                budget = args.primitives if agent == learner else 0
                if (preset, agent, seed, budget, args.episodes) not in there:
                    with suppress(UnsupportedError):  # a puzzle that the informed searcher does not know
                        yield _play_room(preset, room, agent, seed, budget, args.episodes)


def _solve_room(preset: str, room: RoomInstance) -> SolvedRoom:
    state = Kinematics(room).make_state(room.starts[0])
    planned = None if room.dynamics.kind == "physics" else get_planner(room).solve(state).cost
    return SolvedRoom(preset, count_fewest(room), float(getattr(room.puzzle, "success", 1.0)), planned)


def count_fewest(room: RoomInstance) -> int:
    """Count the fewest operators that solve the room's puzzle from its start, breadth first or by its own solver."""
    state = Kinematics(room).make_state(room.starts[0]).puzzle
    model = room.symbolic_model
    relevant = SymbolicModel(model.propositions, find_relevant_operators(model), model.goal)
    return len(room.puzzle.symbolic.plan(state) or relevant.find_fewest(room.puzzle.symbolic.get_facts(state)) or ())


def _play_room(preset: str, room: RoomInstance, agent: str, seed: int, primitives: int, episodes: int) -> PlayedRun:
    spec = AgentSpec.parse(agent)
    env, recorder = make_agent_env(spec, room, "features")
    try:
        if spec.is_reference:
            last = evaluate(make_reference(agent, env, recorder), env, episodes)
        else:
            last = train(agent, env, primitives=max(primitives, 1), seed=seed, eval_every=max(primitives, 1),
                         eval_episodes=episodes, progress=False).evaluations[-1]
    finally:
        env.close()
    return PlayedRun(preset, agent, seed, primitives, _list_escapes(last))


def _list_escapes(last: Evaluation) -> tuple[int | None, ...]:
    return tuple(length if success else None for length, success in zip(last.lengths, last.successes, strict=True))


# --- the page --------------------------------------------------------------------------------


def analyse(study: Study, lines: Sequence[SolvedRoom | PlayedRun]) -> Page:
    """Table of all puzzles, and who escapes always or never."""
    rooms = {line.preset: line for line in lines if isinstance(line, SolvedRoom)}
    runs = [line for line in lines if isinstance(line, PlayedRun)]
    shown = [entry for entry in list_entries(study) if entry.preset in rooms]
    players, learner = study.data["players"], study.data["learner"]
    learned = [run for run in runs if run.agent == learner]
    played = {agent: {entry.name: lengths for entry in shown if (lengths := _select(runs, entry.preset, agent))}
              for agent in players}
    rows = [[f"`{entry.preset}`", entry.level, rooms[entry.preset].fewest, rooms[entry.preset].planned or "",
             *(_tell_escapes(_select(runs, entry.preset, agent)) for agent in (*players, study.data["informed"]))]
            for entry in shown]
    return Page({
        "always": {agent: [name for name, lengths in own.items() if None not in lengths]
                   for agent, own in played.items()},
        "played": {agent: len(own) for agent, own in played.items()},
        "beyond": [name for name, lengths in played[learner].items()
                   if None not in lengths and None in played[players[2]].get(name, [None])],
        "never": [name for name, lengths in played[learner].items() if set(lengths) == {None}],
        "table_of_puzzles": make_table(
            ["puzzle", "exact", "fewest operators", "planner", "random", "in order", "searching", "learning",
             "told the room configuration"], rows),
        "entries": [(entry, _tell_optimum(entry, rooms[entry.preset])) for entry in shown],
        "seeds": len({run.seed for run in learned}), "runs": 1 + max((run.seed for run in learned), default=0),
        "budget": max((run.primitives for run in learned), default=0),
        "episodes": max((len(run.escapes) for run in runs), default=0),
    }, {"gallery": draw(played, [entry.name for entry in shown])})


def draw(played: Mapping[str, Mapping[str, Sequence[int | None]]], names: Sequence[str]) -> Figure:
    """Share of episodes that escape: a row an agent, a column a puzzle; white where nothing was played."""
    shares = np.array([[np.mean([length is not None for length in own[name]]) if name in own else np.nan
                        for name in names] for own in played.values()])
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(9.2, 3.2), facecolor=palette.BACKGROUND, layout="constrained")
        axes = figure.subplots()
        image = axes.imshow(shares, cmap="YlGn", vmin=0, vmax=1, aspect="auto")
        axes.set_yticks(range(len(played)), [agent.removeprefix("smdp-") for agent in played])
        axes.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=7.5)
        figure.colorbar(image, label="episodes that escape", format="{x:.0%}")
    return figure


def _select(runs: Sequence[PlayedRun], preset: str, agent: str) -> list[int | None]:
    return [length for run in runs if (run.preset, run.agent) == (preset, agent) for length in run.escapes]


def _tell_escapes(lengths: Sequence[int | None]) -> str:
    """Share of the episodes that escaped, and their median primitives; empty without episodes."""
    escaped = [length for length in lengths if length is not None]
    if not lengths:
        return ""
    share = f"{len(escaped) / len(lengths):.0%}"
    return f"{share}, {statistics.median(escaped):.0f}" if escaped else share


def _tell_optimum(entry: Entry, room: SolvedRoom) -> str:
    return entry.optimum.format(fewest=room.fewest, expected=f"{room.fewest / room.success:.1f}")
