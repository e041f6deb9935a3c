"""Callers of tools on rungs of the ladder: games, recordings that are replayed, what each level of telling adds."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from hrl_escape.agents.text_agent import Level
from hrl_escape.agents.training.evaluation import play_episode
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.pictures import palette
from hrl_escape.errors import ComparisonError
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.sets.grammar import find_set
from hrl_escape.text import Score, TextEnv, ToolsAgent, make_model, verify_games
from studies.figures import FIGURE_STYLE
from studies.page import make_table
from studies.running import StudyArgs
from studies.store import Store
from studies.study import Page, Study

__all__ = ["LINES", "Args", "GameRun", "Gain", "analyse", "compute_gain", "measure", "play_game", "tell_gain"]

SEED = 0
"""Episode seed of every game."""


@dataclasses.dataclass(frozen=True)
class Args(StudyArgs):
    """Options of the study."""

    managers: tuple[str, ...] = ()
    """Managers to play; all by default."""
    rooms: int | None = None
    """Rooms of each rung; those of `study.toml` by default."""


@dataclasses.dataclass(frozen=True)
class GameRun:
    """A game that a caller played.

    Attributes:
        caller: manager, or name of a recording.
        told: what it was told.
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


# --- levels ----------------------------------------------------------------------------------


class Gain(NamedTuple):
    """Efficiency that one caller has above another, over the rooms of all rungs.

    Attributes:
        value: mean difference, rungs weighted alike.
        low: lower end of its 95 % interval over rooms.
        high: upper end.
        by_rung: mean difference on each rung.
    """

    value: float
    low: float
    high: float
    by_rung: Mapping[str, float]


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
    means = {rung: float(np.mean(values)) for rung, values in by_rung.items()}
    return Gain(float(np.mean([*means.values()])), float(low), float(high), means)


def tell_gain(what: str, than: str, gain: Gain) -> str:
    """One sentence: what being told more adds to something, takes away, or is not shown to do, and on which rungs."""
    numbers = f"{gain.value:+.2f} ({gain.low:+.2f} to {gain.high:+.2f})"
    if len(gain.by_rung) > 1:
        least, most = (pick(gain.by_rung, key=lambda rung: gain.by_rung[rung]) for pick in (min, max))
        numbers += f", from {gain.by_rung[least]:+.2f} in `{least}` to {gain.by_rung[most]:+.2f} in `{most}`"
    if gain.low > 0:
        return f"{what} raises efficiency over {than}, by {numbers}."
    if gain.high < 0:
        return f"{what} lowers efficiency below {than}, by {numbers}."
    return f"These rooms do not show that {what[0].lower()}{what[1:]} changes efficiency from {than}: {numbers}."


STEPS = (("search-random", "random", "Remembering what was tried and seeing what is on", "choices at random"),
         ("search-nearest", "search-random", "Being told where things are", "names alone"),
         ("oracle", "search-nearest", "Being told the symbolic model", "being told where things are"))
"""Pairs of callers of which the first is told, or does, more; and in words, what, and what the second has."""


def tell_steps(gains: Mapping[tuple[str, str], Gain]) -> Iterator[str]:
    """A sentence a step, by what is added to what; the largest one that is sure comes first, for the headline."""
    sure = sorted((what for what, gain in gains.items() if gain.low > 0), key=lambda what: -gains[what].value)
    for what in [*sure, *(what for what in gains if what not in sure)]:
        yield tell_gain(*what, gains[what])


# --- page ------------------------------------------------------------------------------------


def analyse(study: Study, lines: Sequence[GameRun]) -> Page:
    """Sentences, table and figure.

    Raises:
        ComparisonError: there are no games.
    """
    if not lines:
        raise ComparisonError("there are no games to tell of")
    of: dict[tuple[str, str], list[GameRun]] = {}
    for run in lines:
        of.setdefault((run.caller, run.told), []).append(run)
    managers = {caller: own for (caller, _), own in of.items()}
    gains = {(what, than): compute_gain(managers[one], managers[other], study.data["resamples"])
             for one, other, what, than in STEPS if one in managers and other in managers}
    headline, *sentences = tell_steps(gains)
    words = {caller["manager"]: caller["words"] for caller in study.data["callers"]}
    rungs = study.data["rungs"]
    rows = [_make_row(caller, told, words, own, rungs) for (caller, told), own in of.items()]
    header = ["caller", "told", *rungs, "calls", "wrong calls", "characters"]
    return Page({"headline": headline, "sentences": sentences, "table": make_table(header, rows),
                 "rooms": study.data["rooms"]}, {"tools": draw(of, words, rungs)}, [headline, *sentences])


def _make_row(caller: str, told: str, words: Mapping[str, str], own: Sequence[GameRun], rungs: Sequence[str]
              ) -> list[str]:
    name = f"*{caller}*" if own[0].recorded else f"`{caller}`: {words.get(caller, '')}"
    efficiency = {rung: [run.efficiency for run in own if run.rung == rung] for rung in rungs}
    return [name, told, *(f"{np.mean(values):.2f}" if values else "—" for values in efficiency.values()),
            f"{np.mean([run.decisions for run in own]):.1f}", f"{np.mean([run.invalid_calls for run in own]):.1f}",
            f"{np.mean([run.characters for run in own]):,.0f}"]


def draw(of: Mapping[tuple[str, str], Sequence[GameRun]], words: Mapping[str, str], rungs: Sequence[str]) -> Figure:
    """Mean efficiency on each rung, with intervals over rooms."""
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(7.6, 3.8), facecolor=palette.BACKGROUND, layout="constrained")
        axes, rng = figure.add_subplot(), np.random.default_rng(0)
        for number, ((caller, told), own) in enumerate(of.items()):
            shift, points = 0.12 * (number - (len(of) - 1) / 2), []
            for place, rung in enumerate(rungs):
                values: list[float] = [run.efficiency for run in own if run.rung == rung]
                if values:
                    means = rng.choice(values, (2_000, len(values))).mean(axis=1)
                    points.append((place + shift, np.mean(values), *np.quantile(means, [0.025, 0.975])))
            at, middle, low, high = (np.array(each) for each in zip(*points, strict=True))
            label: Any = f"{words.get(caller, caller)} ({told})"
            axes.errorbar(at, middle, np.maximum([middle - low, high - middle], 0), fmt="o", markersize=5,
                          linewidth=1.4, color=palette.LINES[number % len(palette.LINES)], label=label)
        axes.set_xticks(range(len(rungs)), rungs)
        axes.set(ylim=(0, 1.05), ylabel="efficiency")
        axes.grid(axis="y", color="#e5dfd2", linewidth=0.8)
        axes.set_axisbelow(True)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
        axes.tick_params(colors=palette.MUTED, labelcolor=palette.INK)
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    return figure
