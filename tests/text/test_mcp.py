"""The server for language models: its tools are the series' of games; without the extra one message names it."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hrl_escape.cli import main
from hrl_escape.signals import Ended
from hrl_escape.text import verify_games
from tests.text.rooms import get_room, make_session

HAS_MCP = importlib.util.find_spec("mcp") is not None


@pytest.mark.skipif(not HAS_MCP, reason="the extra mcp is not installed")
def test_a_client_plays_two_rooms_and_sees_what_the_session_answers(tmp_path: Path):
    import anyio
    from mcp import Client

    from hrl_escape.text.mcp_server import make_server
    from hrl_escape.text.series import GameSeries

    rooms, heard, told = [get_room("pair", 3), get_room("chain-3")], [], []
    series, twin = GameSeries(rooms, record=tmp_path / "games.jsonl"), make_session(rooms[0])
    calls = [("run_option", {"option": "press-button-1"}), ("fly", {"x": 1}), ("move", {"primitive": "forward"}),
             ("look", {}), ("run_option", {"option": "press-button-2"}), ("run_option", {"option": "press-button-1"}),
             ("run_option", {"option": "go-to-exit"})]

    async def hear(progress: float, total: float | None, message: str | None) -> None:
        told.append((progress, total))

    async def talk() -> None:
        async with Client(make_server(series)) as client:
            assert client.instructions == f"Game 1, of 2 rooms.\n{twin.transcript[0].text}"
            tools = (await client.list_tools()).tools
            assert [(tool.name, tool.input_schema) for tool in tools[:-1]] == [
                (tool["name"], tool["inputSchema"]) for tool in twin.tools()] and tools[-1].name == "new_game"
            for name, arguments in calls:
                result = await client.call_tool(name, arguments, progress_callback=hear)
                heard.append((result.content[0].text, result.is_error))
            hidden = (tmp_path / "games.jsonl").read_text()
            assert "edges" not in hidden and '"room"' not in hidden and "go-to-exit" in hidden
            over = await client.call_tool("look", {})
            assert over.is_error and '"new_game" begins another' in over.content[0].text
            following = (await client.call_tool("new_game", {})).content[0].text
            assert following == f"Game 2, of 2 rooms.\n{make_session(rooms[1]).transcript[0].text}"
            assert "press-button-3" in (await client.list_tools()).tools[0].input_schema["properties"]["option"]["enum"]

    anyio.run(talk)
    alone = [tuple(twin.call(*call)) for call in calls]
    assert heard[:-1] == alone[:-1] and heard[-1][0].startswith(alone[-1][0]) and "Score: escaped, " in heard[-1][0]
    assert told and all(total == rooms[0].horizon for _, total in told)
    series.close()
    (game,) = verify_games(tmp_path / "games.jsonl")
    assert game.score == twin.score() and list(game.turns) == twin.transcript


NAMES = ("", "run_option", "move", "look ", "mcp__rooms__run_option", "reset", "__class__", "\x00", "x" * 100_000, "{}")
ARGUMENTS: tuple[Any, ...] = (
    {"option": "press-button-9"}, {"option": ["go-to-exit"]}, {"option": {"option": {"option": 1}}}, {"option": ""},
    {"primitive": "forward", "times": 10**30}, {"primitive": "forward", "times": "3.5"}, {"primitive": [], "times": 1},
    {"_meta": {"a": 1}, "option": 10**30}, {"": ""}, {"option": "press-button-1\n"}, {"x" * 10_000: [[[[[]]]]]})


@pytest.mark.nightly
@pytest.mark.skipif(not HAS_MCP, reason="the extra mcp is not installed")
def test_2000_malformed_calls_over_the_protocol_cost_a_primitive_each_and_end_no_server():
    import anyio
    from mcp import Client

    from hrl_escape.text.mcp_server import make_server
    from hrl_escape.text.series import GameSeries

    rng, rooms, count = np.random.default_rng(0), [get_room("pair", number) for number in range(3)], 2_000
    series = GameSeries(rooms)

    async def talk() -> None:
        async with Client(make_server(series)) as client:
            for _ in range(count):
                before = series.session.score().primitives
                name, arguments = (kinds[rng.integers(len(kinds))] for kinds in (NAMES, ARGUMENTS))
                result = await client.call_tool(name, arguments)
                score = series.session.score()
                assert result.is_error and result.content[0].text.isprintable()
                assert score.primitives == before + 1 == score.invalid_calls
                if score.primitives == rooms[0].horizon:
                    await client.call_tool("new_game", {})
            result = await client.call_tool("run_option", {"option": "press-button-1"})
            assert not result.is_error

    anyio.run(talk)
    assert series.number == count // rooms[0].horizon


@pytest.mark.nightly
@pytest.mark.skipif(not HAS_MCP, reason="the extra mcp is not installed")
def test_the_command_serves_rungs_on_standard_input_and_records_the_games(tmp_path: Path):
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


@pytest.mark.skipif(not HAS_MCP, reason="the extra mcp is not installed")
def test_a_record_that_cannot_be_written_is_refused_before_the_game(monkeypatch, capsys, tmp_path: Path):
    began = []
    monkeypatch.setattr("hrl_escape.text.mcp_server.serve", began.append)
    (tmp_path / "file").write_text("no folder")
    assert main(["mcp", "--record", str(tmp_path / "file" / "game.jsonl")]) == 2
    assert "cannot write" in capsys.readouterr().err and not began
    assert main(["mcp", "--record", str(tmp_path / "game.jsonl")]) == 0 and began
    (game,) = verify_games(tmp_path / "game.jsonl")
    assert len(game.turns) == 1


@pytest.mark.skipif(not HAS_MCP, reason="the extra mcp is not installed")
def test_the_record_hides_the_room_during_the_game_and_belongs_to_one_server(monkeypatch, capsys, tmp_path: Path):
    written, codes = [], []

    def serve(server: object) -> None:
        written.append((tmp_path / "game.jsonl").read_text())
        codes.append(main(["mcp", "--record", str(tmp_path / "game.jsonl")]))
        raise Ended(15)

    monkeypatch.setattr("hrl_escape.text.mcp_server.serve", serve)
    monkeypatch.setattr("os._exit", codes.append)
    main(["mcp", "--record", str(tmp_path / "game.jsonl")])
    assert '"room"' not in written[0] and codes == [2, 143]
    assert "another server records into this file" in capsys.readouterr().err
    assert len(verify_games(tmp_path / "game.jsonl")) == 1 and not (tmp_path / "game.jsonl.lock").exists()


@pytest.mark.skipif(HAS_MCP, reason="the extra mcp is installed")
def test_without_the_extra_one_line_names_it(capsys: pytest.CaptureFixture[str]):
    assert main(["mcp"]) == 2
    assert capsys.readouterr().err.startswith("hrl-escape: The server for language models needs mcp: ")


@pytest.mark.parametrize(("words", "problem"), [
    (["--room", "ladder-1/lattices/test#0"], "lattices"), (["--room", "ladder-1/pair"], "ladder-1/pair/test#0"),
    (["--room", "ladder-1/pair/test#1000"], "100 rooms"), (["--room", "clutter#*"], "one room is needed")])
def test_an_impossible_room_is_one_line(words: list[str], problem: str):
    from hrl_escape.commands.mcp import McpArgs
    from hrl_escape.errors import EscapeError

    given = dict(zip((word.removeprefix("--") for word in words[::2]), words[1::2], strict=True))
    with pytest.raises(EscapeError, match=problem):
        McpArgs(**given).list_rooms()
