"""The server for language models: its tools are the session's; without the extra one message says what is missing."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

from hrl_escape.cli import main
from hrl_escape.signals import Ended
from hrl_escape.text import verify_games
from tests.text.rooms import get_room, make_session

HAS_MCP = importlib.util.find_spec("mcp") is not None


@pytest.mark.skipif(not HAS_MCP, reason="the extra mcp is not installed")
def test_a_client_sees_the_session():
    import anyio
    from mcp import Client

    from hrl_escape.text.mcp_server import make_server

    room, heard = get_room("pair", 3), []
    session, twin = make_session(room), make_session(room)
    calls = [("run_option", {"option": "press-button-1"}), ("fly", {"x": 1}), ("move", {"primitive": "forward"}),
             ("look", {}), ("run_option", {"option": "go-to-exit"})]

    async def talk() -> None:
        async with Client(make_server(session)) as client:
            assert client.instructions == twin.transcript[0].text
            tools = (await client.list_tools()).tools
            assert [(tool.name, tool.input_schema) for tool in tools] == [
                (tool["name"], tool["inputSchema"]) for tool in twin.tools()]
            for name, arguments in calls:
                result = await client.call_tool(name, arguments)
                heard.append((result.content[0].text, result.is_error))

    anyio.run(talk)
    assert heard == [tuple(twin.call(*call)) for call in calls] and session.transcript == twin.transcript


@pytest.mark.nightly
@pytest.mark.skipif(not HAS_MCP, reason="the extra mcp is not installed")
def test_the_command_serves_a_rung_on_standard_input_and_records_the_game(tmp_path: Path):
    import anyio
    from mcp import Client, StdioServerParameters, stdio_client

    words = ["mcp", "--room", "ladder-1/pair/test#3", "--reveal", "names", "--record", str(tmp_path / "game.jsonl")]

    async def talk() -> None:
        server = StdioServerParameters(command=sys.executable, args=["-m", "hrl_escape.cli", *words])
        async with Client(stdio_client(server)) as client:
            for option in ("press-button-1", "press-button-2", "press-button-1", "go-to-exit"):
                await client.call_tool("run_option", {"option": option})

    anyio.run(talk)
    (game,) = verify_games(tmp_path / "game.jsonl")
    assert game.room == get_room("pair", 3) and game.reveal == "names" and game.score.escaped


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
def test_the_record_holds_nothing_during_the_game_and_belongs_to_one_server(monkeypatch, capsys, tmp_path: Path):
    sizes, codes = [], []

    def serve(server: object) -> None:
        sizes.append((tmp_path / "game.jsonl").stat().st_size)
        codes.append(main(["mcp", "--record", str(tmp_path / "game.jsonl")]))
        raise Ended(15)

    monkeypatch.setattr("hrl_escape.text.mcp_server.serve", serve)
    monkeypatch.setattr("os._exit", codes.append)
    main(["mcp", "--record", str(tmp_path / "game.jsonl")])
    assert sizes == [0] and codes == [2, 143]
    assert "another server records into this file" in capsys.readouterr().err
    assert len(verify_games(tmp_path / "game.jsonl")) == 1


@pytest.mark.skipif(HAS_MCP, reason="the extra mcp is installed")
def test_without_the_extra_one_line_names_it(capsys: pytest.CaptureFixture[str]):
    assert main(["mcp"]) == 2
    assert capsys.readouterr().err.startswith("hrl-escape: The server for language models needs mcp: ")


@pytest.mark.parametrize(("words", "problem"), [
    (["--room", "ladder-1/lattices/test#0"], "lattices"), (["--room", "ladder-1/pair"], "ladder-1/pair/test#0"),
    (["--room", "ladder-1/pair/test#1000"], "100 rooms"), (["--room", "ladder-1/pair/test"], "one room is needed")])
def test_an_impossible_room_is_one_line(words: list[str], problem: str):
    from hrl_escape.commands.mcp import McpArgs
    from hrl_escape.errors import EscapeError

    given = dict(zip((word.removeprefix("--") for word in words[::2]), words[1::2], strict=True))
    with pytest.raises(EscapeError, match=problem):
        McpArgs(**given).make_instance()
