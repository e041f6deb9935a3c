"""The server for language models: the protocol, its start, and the series of games behind it."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hrl_escape.cli import main
from hrl_escape.signals import Ended
from hrl_escape.text import GameSeries, ToolCall, verify_games
from hrl_escape.text.mcp_server import VERSIONS, McpServer
from hrl_escape.version import __version__
from tests.text.rooms import get_room, make_session


class Client:
    """A client in the process of its server, over two pipes."""

    def __init__(self, series: GameSeries) -> None:
        reading, self._sending = os.pipe()
        self._hearing, writing = os.pipe()
        self._streams = open(reading, "rb"), open(writing, "wb")
        self._hears = open(self._hearing, "rb")
        self._server = threading.Thread(target=McpServer(series, *self._streams).serve)
        self._server.start()
        self.notes: list[dict[str, Any]] = []
        self._number = 0

    def __enter__(self) -> Client:
        self.begun = self.ask("initialize", protocolVersion=VERSIONS[-1], capabilities={}, clientInfo={})["result"]
        self.send({"jsonrpc": "2.0", "method": "notifications/initialized"})
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._sending)
        self._server.join()
        for each in (*self._streams, self._hears):
            each.close()

    def send(self, message: Any) -> None:
        os.write(self._sending, (message if isinstance(message, bytes) else json.dumps(message).encode()) + b"\n")

    def hear(self) -> dict[str, Any]:
        """The next answer; notifications are kept in `notes`."""
        while "method" in (message := json.loads(self._hears.readline())):
            self.notes.append(message)
        return message

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        self.send({"jsonrpc": "2.0", "id": self._number, "method": method, "params": parameters})
        answer = self.hear()
        assert answer["jsonrpc"] == "2.0" and answer["id"] == self._number
        return answer

    def call(self, name: Any, arguments: Any = None, **meta: Any) -> tuple[str, bool]:
        result = self.ask("tools/call", name=name, arguments=arguments, _meta=meta)["result"]
        (content,) = result["content"]
        assert content["type"] == "text"
        return content["text"], result["isError"]


def test_a_client_plays_two_rooms_and_sees_what_the_session_answers(tmp_path: Path):
    rooms = [get_room("pair", 3), get_room("chain-3")]
    series, twin = GameSeries(rooms, record=tmp_path / "games.jsonl"), make_session(rooms[0])
    calls = [("run_option", {"option": "press-button-1"}), ("fly", {"x": 1}), ("move", {"primitive": "forward"}),
             ("look", {}), ("run_option", {"option": "press-button-2"}), ("run_option", {"option": "press-button-1"}),
             ("run_option", {"option": "go-to-exit"})]
    with Client(series) as client:
        assert client.begun["instructions"] == f"Game 1, in room 1 of 2.\n{twin.transcript[0].text}"
        assert client.begun["protocolVersion"] == VERSIONS[-1] and client.begun["serverInfo"]["version"] == __version__
        tools = client.ask("tools/list")["result"]["tools"]
        assert tools[:-1] == twin.tools() and tools[-1]["name"] == "new_game"
        heard = [client.call(*call, progressToken="mine") for call in calls]
        hidden = (tmp_path / "games.jsonl").read_text()
        assert "edges" not in hidden and '"room"' not in hidden and "go-to-exit" in hidden
        told = [note["params"] for note in client.notes]
        assert len(told) >= len(calls) and {note["progressToken"] for note in told} == {"mine"}
        assert told[0]["progress"] == 0 < told[-1]["progress"] <= told[-1]["total"] == rooms[0].horizon
        over, is_error = client.call("look", {})
        assert is_error and '"new_game" begins another' in over and client.notes[-1] == {
            "jsonrpc": "2.0", "method": "notifications/progress", "params": told[-1]}
        following, _ = client.call("new_game", {})
        assert following == f"Game 2, in room 2 of 2.\n{make_session(rooms[1]).transcript[0].text}"
        assert client.notes[-1] == {"jsonrpc": "2.0", "method": "notifications/tools/list_changed"}
        tools = client.ask("tools/list")["result"]["tools"]
        assert "press-button-3" in tools[0]["inputSchema"]["properties"]["option"]["enum"]
    alone = [(answer.text, answer.is_error) for answer in (twin.call(*call) for call in calls)]
    assert heard[:-1] == alone[:-1] and heard[-1][0].startswith(alone[-1][0]) and "Score: escaped, " in heard[-1][0]
    series.close()
    (game,) = verify_games(tmp_path / "games.jsonl")
    assert game.score == twin.score() and list(game.turns) == twin.transcript


@pytest.mark.parametrize(("name", "arguments"), [
    ("move", {"primitive": "forward", "times": "3"}), ("move", {"primitive": "forward", "times": 3.0}),
    ("move", '{"primitive": "forward", "times": 3}'), ("mcp__rooms__move", {"primitive": "forward", "times": 3}),
    ("rooms.move", {"primitive": "forward", "times": 3, "_meta": {"progressToken": 1}})])
def test_a_call_in_any_form_costs_its_primitives_alone(name: str, arguments: Any):
    with Client(GameSeries([get_room("pair", 3)])) as client:
        text, is_error = client.call(name, arguments)
        assert not is_error and text.startswith("Took 3 primitives, 3 of ")
        assert client.call("mcp__rooms__look") == client.call("look", {"_meta": None})
        text, is_error = client.call("move", {"primitive": "forward", "times": None})
        assert not is_error and text.startswith("Took 1 primitive, 4 of ")


@pytest.mark.parametrize(("sent", "code"), [
    (b"{", -32700), (b'{"id": 1e999, "method": "ping"}', -32700), (b"\xff", -32700), (b"[" * 100_000, -32700),
    ([], -32600), ({"id": 1}, -32600), ({"id": None, "method": "ping"}, -32600),
    ({"id": 7, "method": "server/discover"}, -32601), ({"id": 7, "method": "x" * 10_000}, -32601),
    ({"id": 7, "method": "tools/call"}, -32602), ({"id": 7, "method": "tools/call", "params": {"name": 3}}, -32602)])
def test_what_is_no_request_is_answered_with_an_error_and_costs_nothing(sent: Any, code: int):
    series = GameSeries([get_room("pair", 3)])
    with Client(series) as client:
        client.send(b"")
        client.send({"jsonrpc": "2.0", "method": "notifications/cancelled", "params": {"requestId": 1}})
        client.send(sent)
        answer = client.hear()
        assert answer["error"]["code"] == code and len(answer["error"]["message"]) < 500
        assert answer["id"] == (7 if isinstance(sent, dict) and sent.get("id") == 7 else None)
        assert client.ask("ping")["result"] == {}
        assert client.ask("initialize", protocolVersion="2024-11-05")["result"]["protocolVersion"] == "2024-11-05"
        assert client.ask("initialize", protocolVersion="1999-01-01")["result"]["protocolVersion"] == VERSIONS[-1]
    assert len(series.session.transcript) == 1 and not series.session.score().primitives


def test_a_recording_that_cannot_be_written_fails_the_call_and_the_server_stays(tmp_path: Path):
    series = GameSeries([get_room("pair", 3)], record=tmp_path / "folder" / "games.jsonl")
    shutil.rmtree(tmp_path / "folder")
    (tmp_path / "folder").write_text("no folder")
    with Client(series) as client:
        answer = client.ask("tools/call", name="look")
        assert answer["error"]["code"] == -32603 and "cannot write" in answer["error"]["message"]
        assert client.ask("ping")["result"] == {}


def test_a_signal_within_a_call_loses_that_call_alone(tmp_path: Path):
    series = GameSeries([get_room("pair", 3)], record=tmp_path / "games.jsonl")
    series.call("run_option", {"option": "press-button-2"})
    turns, score = list(series.session.transcript), series.session.score()
    env = series.session.env
    env.begin(ToolCall("move", {"primitive": "forward", "times": 5}))
    assert env.action is not None
    env.step(env.action)  # the program ends here
    series.close()
    (game,) = verify_games(tmp_path / "games.jsonl")
    assert list(game.turns) == turns and game.score == score


def test_preparation_loads_the_planners_and_changes_no_game():
    series = GameSeries([get_room("pair", 3)])
    twin = make_session(get_room("pair", 3))
    series.prepare()
    assert series.session.transcript == twin.transcript and not series.games
    call = "run_option", {"option": "press-button-2"}
    assert tuple(series.call(*call)) == tuple(twin.call(*call)) and series.session.score() == twin.score()


HEAVY = ("torch", "scipy.linalg", "ompl", "pinocchio", "pybullet", "mcp", "pydantic", "matplotlib", "PIL", "networkx",
         "numba.np.arraymath")
"""Modules that take long to import, and that a server needs for no handshake; the last is one of numba's registries."""


def start_and_end(log: Path, *messages: bytes) -> tuple[Any, set[str], set[str]]:
    """First answer of a server in a new process, and its imports until then and until its end."""
    def list_imports() -> set[str]:
        return {line.rpartition("|")[2].strip() for line in log.read_text().splitlines()}

    words = [sys.executable, "-X", "importtime", "-m", "hrl_escape.cli", "mcp", "--room", "ladder-1/pair/test#3"]
    with (open(log, "w") as errors,
          subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors) as server):
        assert server.stdin is not None and server.stdout is not None
        server.stdin.write(b'{"jsonrpc": "2.0", "id": 1, "method": "initialize", "params": {}}\n')
        server.stdin.flush()
        answer, before = json.loads(server.stdout.readline()), list_imports()
        server.stdin.write(b"".join(messages))
        server.stdin.close()
        assert server.wait() == 0 and server.stdout.read() == b""
    return answer, before, list_imports()


def test_the_handshake_is_answered_before_anything_heavy_is_imported(tmp_path: Path):
    answer, before, _ = start_and_end(tmp_path / "log")
    assert '"button-1"' in answer["result"]["instructions"]
    assert "hrl_escape.text.series" in before and not before & set(HEAVY)


@pytest.mark.nightly
def test_planners_load_after_the_handshake_without_a_call(tmp_path: Path):
    _, before, after = start_and_end(tmp_path / "log", b'{"jsonrpc": "2.0", "method": "notifications/initialized"}\n')
    assert "numba.cpython.unicode" in after - before, "numba loads it with the first kernel of the search"


NAMES = ("", "run_option", "move", "look ", "mcp__rooms__run_option", "reset", "__class__", "\x00", "x" * 100_000, "{}")
ARGUMENTS: tuple[Any, ...] = (
    {"option": "press-button-9"}, {"option": ["go-to-exit"]}, {"option": {"option": {"option": 1}}}, {"option": ""},
    {"primitive": "forward", "times": 10**30}, {"primitive": "forward", "times": "3.5"}, {"primitive": [], "times": 1},
    {"_meta": {"a": 1}, "option": 10**30}, {"": ""}, {"option": "press-button-1\n"}, {"x" * 10_000: [[[[[]]]]]})


@pytest.mark.nightly
def test_2000_malformed_calls_over_the_protocol_cost_a_primitive_each_and_end_no_server():
    rng, rooms, count = np.random.default_rng(0), [get_room("pair", number) for number in range(3)], 2_000
    series = GameSeries(rooms)
    with Client(series) as client:
        for _ in range(count):
            before = series.session.score().primitives
            text, is_error = client.call(*(kinds[rng.integers(len(kinds))] for kinds in (NAMES, ARGUMENTS)))
            score = series.session.score()
            assert is_error and text.isprintable() and score.primitives == before + 1 == score.invalid_calls
            if score.primitives == rooms[0].horizon:
                client.call("new_game", {})
        _, is_error = client.call("run_option", {"option": "press-button-1"})
        assert not is_error
    assert series.number == count // rooms[0].horizon


@pytest.mark.nightly
@pytest.mark.skipif(importlib.util.find_spec("mcp") is None, reason="the package mcp is not installed")
def test_a_client_of_the_package_mcp_plays_the_command_s_games(tmp_path: Path):
    import anyio
    from mcp import Client, StdioServerParameters, stdio_client

    words = ["mcp", "--room", "ladder-1/pair/test#3..5", "--reveal", "names", "--record", str(tmp_path / "game.jsonl")]

    async def talk() -> None:
        server = StdioServerParameters(command=sys.executable, args=["-m", "hrl_escape.cli", *words])
        async with Client(stdio_client(server)) as client:
            for option in ("press-button-1", "press-button-2", "press-button-1", "go-to-exit"):
                await client.call_tool("run_option", {"option": option})
            await client.call_tool("new_game", {})
            await client.call_tool("run_option", {"option": "press-button-1"})

    anyio.run(talk)
    first, second = verify_games(tmp_path / "game.jsonl")
    assert first.room == get_room("pair", 3) and first.reveal == "names" and first.score.escaped
    assert second.room == get_room("pair", 4) and len(second.turns) == 2


def test_a_record_that_cannot_be_written_is_refused_before_the_game(monkeypatch, capsys, tmp_path: Path):
    began = []
    monkeypatch.setattr(McpServer, "serve", lambda server: began.append(server))
    (tmp_path / "file").write_text("no folder")
    assert main(["mcp", "--record", str(tmp_path / "file" / "game.jsonl")]) == 2
    assert "cannot write" in capsys.readouterr().err and not began
    assert main(["mcp", "--record", str(tmp_path / "game.jsonl")]) == 0 and began
    (game,) = verify_games(tmp_path / "game.jsonl")
    assert len(game.turns) == 1


def test_the_record_hides_the_room_during_the_game_and_belongs_to_one_server(monkeypatch, capsys, tmp_path: Path):
    written, codes = [], []

    def serve(server: McpServer) -> None:
        written.append((tmp_path / "game.jsonl").read_text())
        codes.append(main(["mcp", "--record", str(tmp_path / "game.jsonl")]))
        raise Ended(15)

    monkeypatch.setattr(McpServer, "serve", serve)
    monkeypatch.setattr("os._exit", codes.append)
    main(["mcp", "--record", str(tmp_path / "game.jsonl")])
    assert '"room"' not in written[0] and codes == [2, 143]
    assert "another server records into this file" in capsys.readouterr().err
    assert len(verify_games(tmp_path / "game.jsonl")) == 1 and not (tmp_path / "game.jsonl.lock").exists()


@pytest.mark.parametrize(("words", "problem"), [
    (["--room", "ladder-1/lattices/test#0"], "lattices"), (["--room", "ladder-1/pair"], "ladder-1/pair/test#0"),
    (["--room", "ladder-1/pair/test#1000"], "100 rooms"), (["--room", "clutter#*"], "one room is needed")])
def test_an_impossible_room_is_one_line(words: list[str], problem: str):
    from hrl_escape.commands.mcp import McpArgs
    from hrl_escape.errors import EscapeError

    given = dict(zip((word.removeprefix("--") for word in words[::2]), words[1::2], strict=True))
    with pytest.raises(EscapeError, match=problem):
        McpArgs(**given).list_rooms()
