"""Measures the gallery: fewest operators and a planned escape of each room, and how a few agents do in it."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from hrl_escape.agents.training.evaluation import Evaluation, evaluate
from hrl_escape.agents.training.train import train
from hrl_escape.comparison.grid import AgentSpec
from hrl_escape.comparison.references import make_reference
from hrl_escape.comparison.runs import make_env
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.symbolic import SymbolicModel
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import FileReadError
from hrl_escape.files import read_text, write_text
from hrl_escape.planning.planner import get_planner
from hrl_escape.planning.symbolic.operator_order import find_relevant_operators

__all__ = ["PLAYERS", "LEARNER", "GallerySettings", "PlayedRun", "SolvedRoom", "count_fewest", "load_gallery",
           "measure_gallery", "save_gallery"]

LEARNER = "smdp-r-max"
PLAYERS = ("smdp-random", "smdp-index-order", LEARNER)
"""Agents of the gallery, over options alone."""


@dataclasses.dataclass(frozen=True)
class GallerySettings:
    """Size of the measurement."""

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


def measure_gallery(presets: Sequence[str], settings: GallerySettings, done: Iterable[SolvedRoom | PlayedRun] = ()
                    ) -> Iterator[SolvedRoom | PlayedRun]:
    """Measure room after room, and yield each finding as soon as it is made; those in `done` are not made again."""
    found = {_name(each) for each in done}
    for preset in presets:
        room = generate(get_preset(preset), 0)
        if (preset, "", 0, 0, 0) not in found:
            yield _solve_room(preset, room)
        for agent in PLAYERS[:-1] if room.dynamics.kind == "physics" else PLAYERS:  # learning would take minutes
            for seed in range(settings.runs if agent == LEARNER else 1):
                budget = settings.primitives if agent == LEARNER else 0
                if (preset, agent, seed, budget, settings.episodes) not in found:
                    yield _play_room(preset, room, agent, seed, budget, settings.episodes)


def _name(each: SolvedRoom | PlayedRun) -> tuple[str, str, int, int, int]:
    if isinstance(each, SolvedRoom):
        return each.preset, "", 0, 0, 0
    return each.preset, each.agent, each.seed, each.primitives, len(each.escapes)


def _solve_room(preset: str, room: RoomInstance) -> SolvedRoom:
    state = Kinematics(room).make_state(room.starts[0])
    planned = None if room.dynamics.kind == "physics" else get_planner(room).solve(state).cost
    return SolvedRoom(preset, count_fewest(room), float(getattr(room.puzzle, "success", 1.0)), planned)


def count_fewest(room: RoomInstance) -> int:
    """Count the fewest operators that solve the room's puzzle from its start, breadth first or by its own solver."""
    state = Kinematics(room).make_state(room.starts[0]).puzzle
    model = room.symbolic_model
    relevant = SymbolicModel(model.propositions, find_relevant_operators(model), model.goal)
    return len(room.puzzle.plan(state) or relevant.find_fewest(room.puzzle.get_facts(state)) or ())


def _play_room(preset: str, room: RoomInstance, agent: str, seed: int, primitives: int, episodes: int) -> PlayedRun:
    spec = AgentSpec.parse(f"{agent}+no-primitives")
    env, recorder = make_env(spec, room, "features")
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


def save_gallery(path: Path, found: Iterable[SolvedRoom | PlayedRun]) -> None:
    """Write a line of JSON for each finding.

    Raises:
        FileWriteError: the file cannot be written.
    """
    write_text(path, "".join(json.dumps(dataclasses.asdict(each)) + "\n" for each in found))


def load_gallery(path: Path) -> list[SolvedRoom | PlayedRun]:
    """Read what `save_gallery` wrote.

    Raises:
        FileReadError: the file is missing or damaged.
    """
    found: list[SolvedRoom | PlayedRun] = []
    for number, line in enumerate(read_text(path, "gallery's findings").splitlines(), 1):
        try:
            fields = json.loads(line)
            found.append(SolvedRoom(**fields) if "fewest" in fields
                         else PlayedRun(**fields | {"escapes": tuple(fields["escapes"])}))
        except (ValueError, TypeError, KeyError) as error:
            raise FileReadError(f"{path}, line {number}: {error}") from None
    return found
