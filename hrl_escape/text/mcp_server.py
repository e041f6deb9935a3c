"""A room behind the Model Context Protocol, with the tools of a `RoomSession`. Requires the extra `mcp`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hrl_escape.errors import MissingExtraError
from hrl_escape.text.text_env import RoomSession
from hrl_escape.version import __version__

try:
    import anyio  # pyright: ignore[reportMissingImports]
    from mcp import types  # pyright: ignore[reportMissingImports]
    from mcp.server.lowlevel import Server  # pyright: ignore[reportMissingImports]
    from mcp.server.stdio import stdio_server  # pyright: ignore[reportMissingImports]
except ImportError as missing:
    raise MissingExtraError("mcp", "mcp", "The server for language models") from missing


def make_server(session: RoomSession, after_call: Callable[[], object] = lambda: None) -> Server[Any]:
    """Make a server of a game that has begun. Its first text is the instructions; `after_call` follows every call."""
    async def list_tools(context: Any, params: Any) -> types.ListToolsResult:
        return types.ListToolsResult(tools=[types.Tool.model_validate(tool) for tool in session.tools()])

    async def call_tool(context: Any, params: types.CallToolRequestParams) -> types.CallToolResult:
        result = session.call(params.name, params.arguments)
        after_call()
        content = [types.TextContent(type="text", text=result.text)]
        return types.CallToolResult.model_validate({"content": content, "isError": result.is_error})

    return Server("hrl-escape", version=__version__, instructions=session.transcript[0].text, on_list_tools=list_tools,
                  on_call_tool=call_tool)


def serve(server: Server[Any]) -> None:
    """Serve on standard input and output until the client disconnects. No network port is opened."""
    async def run() -> None:
        async with stdio_server() as (reading, writing):
            await server.run(reading, writing, server.create_initialization_options())

    anyio.run(run)
