"""Rooms behind the Model Context Protocol, with the tools of a `GameSeries`. Requires the extra `mcp`."""

from __future__ import annotations

import contextlib
from typing import Any

from hrl_escape.errors import ClosedError, MissingExtraError
from hrl_escape.text.series import GameSeries
from hrl_escape.text.text_env import ToolResult
from hrl_escape.version import __version__

try:
    import anyio  # pyright: ignore[reportMissingImports]
    from mcp import types  # pyright: ignore[reportMissingImports]
    from mcp.server.lowlevel import Server  # pyright: ignore[reportMissingImports]
    from mcp.server.stdio import stdio_server  # pyright: ignore[reportMissingImports]
except ImportError as missing:
    raise MissingExtraError("mcp", "mcp", "The server for language models") from missing

PERIOD = 1.0
"""Seconds between two progress notifications."""


def make_server(series: GameSeries) -> Server[Any]:
    """Make a server of games. Its instructions are the first text of the first game.

    A call runs in a thread of its own. A client that asked for progress receives the primitives of the game once a
    second while the call runs.
    """
    one_at_a_time, announced = anyio.Lock(), series.number

    async def list_tools(context: Any, params: Any) -> types.ListToolsResult:
        return types.ListToolsResult(tools=[types.Tool.model_validate(tool) for tool in series.tools()])

    async def call_tool(context: Any, params: types.CallToolRequestParams) -> types.CallToolResult:
        nonlocal announced
        result = ToolResult("")
        async with one_at_a_time, anyio.create_task_group() as group:
            group.start_soon(_report, context, series)
            result = await anyio.to_thread.run_sync(series.call, params.name, params.arguments)
            group.cancel_scope.cancel()
        if series.number != announced:  # the next room has other options
            announced = series.number
            await context.session.send_tool_list_changed()
        content = [types.TextContent(type="text", text=result.text)]
        return types.CallToolResult.model_validate({"content": content, "isError": result.is_error})

    return Server("hrl-escape", version=__version__, instructions=series.introduction, on_list_tools=list_tools,
                  on_call_tool=call_tool)


async def _report(context: Any, series: GameSeries) -> None:
    while True:
        env = series.session.env
        with contextlib.suppress(ClosedError):  # the call has just left this game
            await context.session.report_progress(env.state.primitives, env.instance.horizon, "primitives of this game")
        await anyio.sleep(PERIOD)


def serve(server: Server[Any]) -> None:
    """Serve on standard input and output until the client disconnects. No network port is opened."""
    async def run() -> None:
        async with stdio_server() as (reading, writing):
            await server.run(reading, writing, server.create_initialization_options())

    anyio.run(run)
