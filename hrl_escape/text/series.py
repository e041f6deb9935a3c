"""Several games behind one set of tools: a `new_game` tool enters the next room, and the last answer has the score."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from hrl_escape.agents.text_agent import Level
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import ConfigError
from hrl_escape.files import write_text
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.text.coercion import normalise_call
from hrl_escape.text.recordings import Game, list_answers, record_game, save_games
from hrl_escape.text.text_env import RoomSession, ToolResult, Turn, tell_score

NEW_GAME = "new_game"


class GameSeries:
    """Games in several rooms, one after another, played by tool calls.

        series = GameSeries(find_set("ladder-1/chain/test#0..5"))
        print(series.introduction)
        print(series.call("run_option", {"option": "press-button-1"}).text)
        print(series.call("new_game").text)

    Args:
        rooms: the rooms, in order; the first follows the last.
        reveal: level of revealed text.
        seed: episode seed of every game.
        include_primitives: whether `move` is offered.
        record: file for the games, or None. It holds no room before `close`, because a room contains the graph. Until
            then its first line holds the room's SHA-256, which the finished recording can be compared with.

    Attributes:
        session: current game.
        number: number of the current game, from 0.
        introduction: first text of the first game.
        games: finished games, and those left by `new_game`.

    Raises:
        ConfigError: there are no rooms.
        FileWriteError: the recording cannot be written.
    """

    def __init__(self, rooms: Sequence[RoomInstance], reveal: Level = "places", seed: int = 0,
                 include_primitives: bool = True, record: str | Path | None = None) -> None:
        if not len(rooms):
            raise ConfigError("rooms", rooms, "at least one room")
        self._rooms, self._seed, self._record = rooms, seed, record
        self._reveal: Level = reveal
        self._include_primitives = include_primitives
        self.games: list[Game] = []
        self.number = -1
        self.introduction = self.begin()

    def begin(self) -> str:
        """Begin the next game and return its first text."""
        place = (self.number + 1) % len(self._rooms)
        following = self._begin_in(self._rooms[place])
        text = following.transcript[0].text
        if self.number >= 0:
            self._keep()
        self.session, self.number = following, self.number + 1
        self._keep_answer()
        rooms = len(self._rooms)
        return text if rooms == 1 else f"Game {self.number + 1}, in room {place + 1} of {rooms}.\n{text}"

    def prepare(self) -> None:
        """Play one option in a copy of the current game, so that the planners are loaded before the first call.

        The game itself does not change. Another thread may run this until the next call.
        """
        copy = self._begin_in(self.session.env.instance)
        options = copy.tools()[0]["inputSchema"]["properties"]["option"]["enum"]
        with closing(copy.env):
            next((name for name in options if not copy.call("run_option", {"option": name}).is_error), None)

    def tools(self) -> list[dict[str, Any]]:
        """JSON Schemas of the tools of the current game, and of `new_game`."""
        about = "Begin the next game. The current game ends as it is." if len(self._rooms) > 1 else \
            "Begin the game again. The current game ends as it is."
        return [*self.session.tools(), {"name": NEW_GAME, "description": about, "inputSchema": {
            "type": "object", "properties": {}, "required": [], "additionalProperties": False}}]

    def call(self, name: Any, arguments: Any = None) -> ToolResult:
        """Call a tool. The answer that ends a game has its score; `new_game` costs nothing."""
        normal, given = normalise_call(name, arguments, self.tools())
        if normal == NEW_GAME and given == {}:
            return ToolResult(self.begin())
        is_over = self.session.env.is_over
        result = self.session.call(name, arguments)
        if is_over:
            return ToolResult(f'The game is over. {tell_score(self.session.score())} "{NEW_GAME}" begins another.',
                              True)
        self._keep_answer()
        if not self.session.env.is_over:
            return result
        return ToolResult(f"{result.text} {tell_score(self.session.score())}", result.is_error)

    def close(self) -> tuple[Game, ...]:
        """End the current game, write the recording with the rooms, and return all games that had a call."""
        self._keep()
        if self._record is not None:
            save_games(self._record, self.games or [self._record_answers()])
        return tuple(self.games)

    def _begin_in(self, room: RoomInstance) -> RoomSession:
        env = OptionsEnv(EscapeRoomEnv(instance=room), include_primitives=self._include_primitives)
        session = RoomSession(env, self._reveal)
        session.reset(seed=self._seed)
        return session

    def _keep(self) -> None:
        if len(self._turns) > 1:
            self.games.append(self._record_answers())
        self.session.env.close()

    def _keep_answer(self) -> None:
        """Keep turns and score at the last answer: a signal that ends the program may arrive within the next call."""
        self._turns, self._score = tuple(self.session.transcript), self.session.score()
        self._write_progress()

    def _record_answers(self) -> Game:
        return dataclasses.replace(record_game(self.session), turns=self._turns, score=self._score)

    def _write_progress(self) -> None:
        """Write the turns of all games so far, without their rooms."""
        if self._record is None:
            return
        played = [(game.room, game.turns) for game in self.games]
        played.append((self.session.env.instance, self._turns))
        lines = [line for room, turns in played for line in _list_lines(room, self._seed, self._reveal, turns)]
        write_text(self._record, "".join(f"{json.dumps(line)}\n" for line in lines))


def _list_lines(room: RoomInstance, seed: int, reveal: Level, turns: Iterable[Turn]) -> list[dict[str, Any]]:
    digest = hashlib.sha256(json.dumps(room.to_dict(), sort_keys=True).encode()).hexdigest()
    first, *others = turns
    return [{"kind": "game-in-progress", "room_sha256": digest, "seed": seed, "reveal": reveal, "text": first.text},
            *list_answers(others)]
