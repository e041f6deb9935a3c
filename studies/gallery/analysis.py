"""A room of every puzzle: its fewest operators, the planner's escape, and the scores of a few agents."""

from __future__ import annotations

import dataclasses
import statistics
from collections.abc import Iterator, Sequence
from contextlib import suppress
from types import SimpleNamespace

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.evaluation import Evaluation, evaluate
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.agent_env import make_agent_env
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.symbolic import SymbolicModel
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import UnsupportedError
from hrl_escape.planning.planner import get_planner
from hrl_escape.planning.symbolic.operator_order import find_relevant_operators
from studies.running import StudyArgs
from studies.store import Store
from studies.study import Findings, Study
from studies.tables import make_table

__all__ = ["LINES", "Args", "PlayedRun", "SolvedRoom", "analyse", "count_fewest", "measure"]


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


def measure(study: Study, args: Args, store: Store) -> None:
    """Measure what is missing, room after room, and keep each finding at once."""
    for found in _measure_missing(study, args, store):
        store.add([found])


def _measure_missing(study: Study, args: Args, store: Store) -> Iterator[SolvedRoom | PlayedRun]:
    there, learner = {line.place for line in store.load()}, study.data["learner"]
    players = (*study.data["players"], study.data["informed"])
    for preset in args.presets or study.data["puzzles"]:
        room = generate(get_preset(preset), 0)
        if preset not in there:
            yield _solve_room(preset, room)
        for agent in players:
            if agent == learner and room.dynamics.kind == "physics":  # it would take minutes
                continue
            for seed in range(args.runs if agent == learner else 1):
                budget = args.primitives if agent == learner else 0
                if (preset, agent, seed, budget, args.episodes) not in there:
                    with suppress(UnsupportedError):  # a puzzle whose graphs the Bayes planner cannot list
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


# --- findings --------------------------------------------------------------------------------


def analyse(study: Study, lines: Sequence[SolvedRoom | PlayedRun]) -> Findings:
    """Scores of agents in each puzzle."""
    rooms = {line.preset: line for line in lines if isinstance(line, SolvedRoom)}
    runs = [line for line in lines if isinstance(line, PlayedRun)]
    agents = (*study.data["players"], study.data["informed"])
    found = {preset: {agent: ends for agent in agents if (ends := _select(runs, preset, agent))}
             for preset in study.data["puzzles"] if preset in rooms}
    table = make_table(["puzzle", "fewest operators", "planner", *(AgentSpec.parse(agent).title for agent in agents)], [
        [f"`{preset}`", rooms[preset].fewest, rooms[preset].planned or "",
         *(_format(own[agent]) if agent in own else "" for agent in agents)] for preset, own in found.items()])
    always = {agent: [preset for preset, own in found.items() if agent in own and None not in own[agent]]
              for agent in agents}
    return Findings(SimpleNamespace(ends=found, always=always), {"puzzles": table})


def _select(runs: Sequence[PlayedRun], preset: str, agent: str) -> list[int | None]:
    return [length for run in runs if (run.preset, run.agent) == (preset, agent) for length in run.escapes]


def _format(lengths: Sequence[int | None]) -> str:
    """Share of the episodes that escaped, and their median primitives."""
    escaped = [length for length in lengths if length is not None]
    share = f"{len(escaped) / len(lengths):.0%}"
    return f"{share}, {statistics.median(escaped):.0f}" if escaped else share
