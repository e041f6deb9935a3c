"""Recorded games: JSON Lines that can be replayed to the same bytes, which verifies scores from elsewhere.

A game begins with a line that contains the room, the episode's seed and the level of revealed text. One line per turn
follows, and the score ends it. A file can contain several games.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Annotated, Any

from hrl_escape.agents.text_agent import Level
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import EscapeError, FileReadError, OldFormatError, UnsupportedError, VerificationError
from hrl_escape.files import parse_json, read_text, write_text
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.settings import Range, read_record
from hrl_escape.text.text_env import RoomSession, Score, TextEnv, ToolCall, Turn

_SCHEMA = 2


@dataclasses.dataclass(frozen=True)
class Game:
    """A finished game.

    Attributes:
        room: the room.
        seed: seed of the episode.
        reveal: level of revealed text.
        options: arguments of the `OptionsEnv` that differ from the defaults.
        turns: calls and answers, after the text that began the game.
        score: score at the end.
    """

    room: RoomInstance
    seed: int
    reveal: Level
    options: Mapping[str, Any]
    turns: tuple[Turn, ...]
    score: Score

    def to_lines(self) -> list[str]:
        """Return the lines of its file."""
        first, *turns = self.turns
        begun = {"kind": "game", "schema": _SCHEMA, "seed": self.seed, "reveal": self.reveal,
                 "options": dict(self.options), "text": first.text, "room": self.room.to_dict()}
        return [json.dumps(line) for line in (begun, *list_answers(turns), {"score": dataclasses.asdict(self.score)})]

    @classmethod
    def from_lines(cls, lines: Sequence[Any]) -> Game:
        """Parse the lines of one game, each a JSON value.

        Raises:
            ValueError: there are fewer than two lines, or the first does not begin a game of this schema.
            EscapeError: a value in them is not valid; the message names its place.
        """
        first, *said, last = lines if len(lines) > 1 else ({}, {})
        if not isinstance(first, dict) or first.get("kind") != "game" or first.get("schema") != _SCHEMA:
            raise ValueError(f"this is not a game of schema {_SCHEMA}")
        begun = read_record(_Beginning, first, "game")
        read_record(GameOptions, begun.options, "game.options")
        answers = [read_record(_Answer, line, f"turn {number}") for number, line in enumerate(said, 1)]
        turns = (Turn(None, begun.text), *(Turn(ToolCall(*answer.call), answer.text, answer.is_error)
                                           for answer in answers))
        return cls(RoomInstance.from_dict(begun.room), begun.seed, begun.reveal, begun.options, turns,
                   read_record(_End, last, "end").score)


@dataclasses.dataclass(frozen=True)
class GameOptions:
    """Arguments of `OptionsEnv` that a recorded game may change."""

    include_primitives: bool = True
    discount: Annotated[float, Range(0, 1)] = 0.99
    discounted_reward: bool = False
    option_set: str = "press"
    interruptible: bool = False
    max_duration: Annotated[int, Range(1)] | None = None
    trace: bool = False
    planner: str = "auto"


@dataclasses.dataclass(frozen=True)
class _Beginning:
    """First line of a game."""

    kind: str
    schema: int
    seed: Annotated[int, Range(0)]
    reveal: Level
    options: dict[str, Any]
    text: str
    room: dict[str, Any]


@dataclasses.dataclass(frozen=True)
class _Answer:
    """Line of a turn."""

    call: tuple[str, Any]
    text: str
    is_error: bool


@dataclasses.dataclass(frozen=True)
class _End:
    """Last line of a game."""

    score: Score


def list_answers(turns: Iterable[Turn]) -> list[dict[str, Any]]:
    """Return the line of each call with its answer, as JSON values."""
    return [{"call": [*turn.call], "text": turn.text, "is_error": turn.is_error} for turn in turns if turn.call]


def record_game(session: RoomSession | TextEnv) -> Game:
    """Return the game since the last reset.

    Raises:
        UnsupportedError: it cannot be replayed, because it began without a seed, was not the first trial, or had custom
            options.
    """
    env = session.env if isinstance(session, RoomSession) else session
    given = env.env._saved_kwargs
    if env.seed is None or sum(turn.call is None for turn in env.transcript) != 1:
        raise UnsupportedError("a recording needs one game that began with reset(seed=...). Reset with a seed first")
    if given["options"] is not None or "domain" in given:
        raise UnsupportedError("a recording supports the room's meta-actions only, not options of your own")
    defaults = OptionsEnv(EscapeRoomEnv(instance=env.instance))._saved_kwargs
    changed = {name: value for name, value in given.items() if value != defaults[name] and name != "observation"}
    return Game(env.instance, env.seed, env.reveal, changed, tuple(env.transcript), env.score())


def save_games(path: str | Path, games: Iterable[Game]) -> None:
    """Write games to a file atomically, replacing its content."""
    write_text(path, "".join(f"{line}\n" for game in games for line in game.to_lines()))


def load_games(path: str | Path) -> tuple[Game, ...]:
    """Read the games of a file, without replaying them.

    Raises:
        FileReadError: the file is missing or damaged; the message gives the place.
        OldFormatError: the file was written by version 0.3.
    """
    games, lines = [], list[Any]()
    for number, text in enumerate(read_text(path, "recorded game").splitlines(), 1):
        lines.append(parse_json(text, f"{path}, line {number}", "recorded game"))
        if len(lines) == 1 and isinstance(lines[0], dict) and lines[0].get("schema") == 1:
            raise OldFormatError(path, "recorded game")
        if isinstance(lines[-1], dict) and "score" in lines[-1]:
            try:
                games.append(Game.from_lines(lines))
            except (EscapeError, ValueError) as error:
                raise FileReadError(f"{path}, game that ends in line {number}: {error}") from error
            lines = []
    if lines or not games:
        raise FileReadError(f"{path}: the last game has no end" if lines else f"{path}: there is no game")
    return tuple(games)


def replay_session(game: Game) -> RoomSession:
    """Replay a game's calls in its room; the caller closes `env` of the session."""
    session = RoomSession(OptionsEnv(EscapeRoomEnv(instance=game.room), **game.options), game.reveal)
    session.reset(seed=game.seed)
    for turn in game.turns[1:]:
        assert turn.call is not None
        session.call(*turn.call)
    return session


def replay_game(game: Game) -> Game:
    """Replay a game's calls in its room."""
    session = replay_session(game)
    with closing(session.env):
        return record_game(session)


def verify_games(path: str | Path) -> tuple[Game, ...]:
    """Read the games of a file, and replay each.

    Raises:
        FileReadError: the file is missing or damaged.
        VerificationError: a replay differs; the message gives the place.
    """
    games = load_games(path)
    for number, game in enumerate(games, 1):
        again = replay_game(game)
        # The last line is the end of a game and no turn, so games of different lengths differ in an earlier line.
        for turn, (said, heard) in enumerate(zip(game.to_lines(), again.to_lines(), strict=False)):
            if said != heard:
                raise VerificationError(f"{path}: game {number} differs from its replay in line {turn + 1} of it")
    return games


class RecordedModel:
    """Makes the calls of recorded games. It finds a game by the whole transcript, which verifies every answer.

    Attributes:
        name: name of the file, and a hash of its content.

    Raises:
        FileReadError: the file is missing or damaged.
    """

    def __init__(self, path: str | Path) -> None:
        self.path, self._games = path, [game.turns for game in load_games(path)]
        self.name = f"{path}, {hashlib.sha256(read_text(path).encode()).hexdigest()[:12]}"

    def __call__(self, transcript: Sequence[Turn], tools: Sequence[Mapping[str, Any]]) -> ToolCall:
        """Return the recorded call at this point; `VerificationError` if no recorded game has this transcript."""
        done, said = len(transcript), tuple(transcript)
        for turns in self._games:
            if turns[:done] == said and len(turns) > done:
                call = turns[done].call
                assert call is not None
                return call
        raise VerificationError(f"{self.path}: no recorded game continues like this one, after {done - 1} calls")
