"""Callers of tools on rungs of the ladder: games, replayed recordings, and what each level of `reveal` adds."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from rich.console import Console

from hrl_escape.agents.text_agent import Level
from hrl_escape.agents.training.evaluation import play_episode
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import ComparisonError
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.sets.grammar import find_set
from hrl_escape.text import Score, TextEnv, ToolsAgent, make_model, verify_games
from studies.running import StudyArgs
from studies.store import Store
from studies.study import Findings, Study
from studies.tables import make_table

__all__ = ["LINES", "Args", "GameRun", "Gain", "analyse", "compute_gain", "measure", "play_game"]

SEED = 0
"""Episode seed of every game."""


@dataclasses.dataclass(frozen=True)
class Args(StudyArgs):
    """Options of the study."""

    managers: tuple[str, ...] = ()
    """Managers to play; all by default."""
    rooms: int | None = None
    """Rooms of each rung; by default the number in `study.toml`."""


@dataclasses.dataclass(frozen=True)
class GameRun:
    """A game that a caller played.

    Attributes:
        caller: manager, or name of a recording.
        told: level of information, as `reveal` of the text interface.
        rung: of the room.
        room: number of the room in the rung's test set.
        recorded: the game comes from a recording, and its replay agreed.
        efficiency: 0 without an escape.
        decisions: calls that took primitives.
        primitives: taken.
        invalid_calls: calls that were wrong, or of an option that could not start.
        characters: read by the caller.
    """

    caller: str
    told: Level
    rung: str
    room: int
    recorded: bool
    efficiency: float
    decisions: int
    primitives: int
    invalid_calls: int
    characters: int

    @property
    def place(self) -> tuple[str, str, str, int]:
        """Subject of the line."""
        return self.caller, self.told, self.rung, self.room

    @classmethod
    def of_score(cls, caller: str, told: Level, rung: str, room: int, score: Score, recorded: bool = False) -> GameRun:
        """The line of a game."""
        return cls(caller, told, rung, room, recorded, round(score.efficiency, 4), score.decisions, score.primitives,
                   score.invalid_calls, score.characters)


LINES = (GameRun,)


def play_game(manager: str, told: Level, room: RoomInstance) -> Score:
    """Let a manager play one game over options alone."""
    env = TextEnv(OptionsEnv(EscapeRoomEnv(instance=room), include_primitives=False), told)
    try:
        for _ in play_episode(ToolsAgent(env, make_model(manager)), env, SEED):
            pass
        return env.score()
    finally:
        env.close()


def measure(study: Study, args: Args, store: Store) -> None:
    """Play what is missing, and replay every recording; games in other rooms than the study's do not count."""
    console, known = Console(stderr=True, highlight=False), {run.place for run in store.load()}
    rooms = {(rung, number): room for rung in study.data["rungs"] for number, room in enumerate(
        find_set(f"ladder-1/{rung}/test#0..{args.rooms or study.data['rooms']}"))}
    for caller in study.data["callers"]:
        name, told = caller["manager"], caller["told"]
        if args.managers and name not in args.managers:
            continue
        for (rung, number), room in rooms.items():
            if (name, told, rung, number) not in known:
                store.add([GameRun.of_score(name, told, rung, number, play_game(name, told, room))])
        console.print(f"{name}, told {told}: done", markup=False)
    places = {room.id: place for place, room in rooms.items()}
    for path in sorted((study.folder / "recordings").glob("*.jsonl")):
        games = [(game, places.get(game.room.id)) for game in verify_games(path)]
        store.add([GameRun.of_score(path.stem, game.reveal, *place, game.score, recorded=True)
                   for game, place in games if place is not None and game.seed == SEED])
        console.print(f"{path.name}: {len(games)} games replayed to the same bytes", markup=False)


# --- findings --------------------------------------------------------------------------------


class Gain(NamedTuple):
    """Efficiency that one caller has above another, over the rooms of all rungs.

    Attributes:
        mean: difference, rungs weighted alike.
        low: lower end of its 95 % interval over rooms.
        high: upper end.
    """

    mean: float
    low: float
    high: float


def compute_gain(one: Sequence[GameRun], other: Sequence[GameRun], resamples: int) -> Gain:
    """Paired difference of two callers over the rooms that both played; rooms are resampled within rungs.

    Raises:
        ComparisonError: they have no room in common.
    """
    before = {(run.rung, run.room): run.efficiency for run in other}
    by_rung: dict[str, list[float]] = {}
    for run in one:
        if (run.rung, run.room) in before:
            by_rung.setdefault(run.rung, []).append(run.efficiency - before[run.rung, run.room])
    if not by_rung:
        raise ComparisonError("two callers have no room in common")
    rng = np.random.default_rng(0)
    drawn = np.mean([rng.choice(values, (resamples, len(values))).mean(axis=1) for values in by_rung.values()], axis=0)
    low, high = np.quantile(drawn, [0.025, 0.975])
    return Gain(float(np.mean([np.mean(values) for values in by_rung.values()])), float(low), float(high))


STEPS = {"memory": ("search-random", "random"), "places": ("search-nearest", "search-random"),
         "model": ("oracle", "search-nearest")}
"""Added information -> the caller that has it, and the one without."""


def analyse(study: Study, lines: Sequence[GameRun]) -> Findings:
    """Scores of callers, and what each level of `reveal` adds.

    Raises:
        ComparisonError: there are no games.
    """
    if not lines:
        raise ComparisonError("there are no games")
    of: dict[tuple[str, str], list[GameRun]] = {}
    for run in lines:
        of.setdefault((run.caller, run.told), []).append(run)
    managers = {caller: own for (caller, _), own in of.items()}
    gains = {what: compute_gain(managers[one], managers[other], study.data["resamples"])
             for what, (one, other) in STEPS.items() if one in managers and other in managers}
    rungs = study.data["rungs"]
    words = {caller["manager"]: caller["words"] for caller in study.data["callers"]}
    return Findings(SimpleNamespace(gains=gains), {"tools": make_table(
        ["caller", "`reveal`", *(f"`{rung}`" for rung in rungs), "calls", "wrong calls", "characters read"],
        [_make_row(caller, told, words, own, rungs) for (caller, told), own in of.items()])})


def _make_row(caller: str, told: str, words: Mapping[str, str], own: Sequence[GameRun], rungs: Sequence[str]
              ) -> list[str]:
    name = f"*{caller}*" if own[0].recorded else f"`{caller}`: {words[caller]}"
    efficiency = {rung: [run.efficiency for run in own if run.rung == rung] for rung in rungs}
    return [name, f"`{told}`", *(f"{np.mean(values):.2f}" if values else "" for values in efficiency.values()),
            f"{np.mean([run.decisions for run in own]):.1f}", f"{np.mean([run.invalid_calls for run in own]):.1f}",
            f"{np.mean([run.characters for run in own]):,.0f}"]
