"""Serve rooms to a language model by the Model Context Protocol, on stdin and stdout.

    hrl-escape mcp
    hrl-escape mcp --room ladder-1/lattice/test#3
    hrl-escape mcp --room ladder-1/chain/test#0..10 --reveal names --record games/mine.jsonl

A client starts this command. `new_game` enters the next room.
The recording holds the rooms only when the client has disconnected. Until then a reader finds no graph in it.

The server starts in seconds. The first call after an installation waits for compilation, up to a minute, unless
`hrl-escape warm` has run. Clients with timeouts that allow this:

    Claude Code     .mcp.json, with MCP_TIMEOUT=120000 in its environment:
                    {"mcpServers": {"rooms": {"command": "hrl-escape", "args": ["mcp", "--room", "clutter#3"]}}}
    Codex           ~/.codex/config.toml:
                    [mcp_servers.rooms]
                    command = "hrl-escape"
                    args = ["mcp", "--room", "clutter#3"]
                    startup_timeout_sec = 120
                    tool_timeout_sec = 120
    Gemini CLI      ~/.gemini/settings.json:
                    {"mcpServers": {"rooms": {"command": "hrl-escape", "args": ["mcp"], "timeout": 120000}}}
    VS Code         .vscode/mcp.json:
                    {"servers": {"rooms": {"type": "stdio", "command": "hrl-escape", "args": ["mcp"]}}}
"""

from __future__ import annotations

import dataclasses
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import BinaryIO

from hrl_escape.agents.text_agent import Level
from hrl_escape.commands.room_choice import RoomChoice
from hrl_escape.env.instance import RoomInstance
from hrl_escape.sets.instance_set import InstanceSet
from hrl_escape.signals import Ended


@dataclasses.dataclass(frozen=True)
class McpArgs(RoomChoice):
    """Options of `hrl-escape mcp`."""

    reveal: Level = "places"
    """Information for the caller: names, places or model."""
    options_only: bool = False
    """Offer no primitives."""
    episode_seed: int = 0
    """Episode seed: fixes the start and the noise of every game."""
    record: Path | None = None
    """File for the games in JSON Lines. The rooms, with everything that is hidden from the client, are added when the
    client disconnects. A file is for one server at a time."""

    def list_rooms(self) -> Sequence[RoomInstance]:
        """Find the rooms: those of a set, or one room."""
        found = self.find_rooms()
        return found if isinstance(found, InstanceSet) else [self.make_instance()]


def run(args: McpArgs) -> None:
    """Serve games until the client disconnects."""
    rooms = args.list_rooms()
    with _wire() as (reading, writing), nullcontext() if args.record is None else _reserve(args.record):
        from hrl_escape.text.mcp_server import McpServer
        from hrl_escape.text.series import GameSeries

        series = GameSeries(rooms, args.reveal, args.episode_seed, not args.options_only, args.record)
        ended = 0
        try:
            McpServer(series, reading, writing).serve()
        except Ended as signal:
            ended = signal.number
        finally:
            for game in series.close():
                print(game.score, file=sys.stderr, flush=True)
    if ended:
        os._exit(128 + ended)  # the thread that compiles would keep the process alive


@contextmanager
def _wire() -> Iterator[tuple[BinaryIO, BinaryIO]]:
    """Standard input, and standard output apart from what is printed, which goes to standard error."""
    sys.stdout.flush()
    own = os.dup(1)
    os.dup2(2, 1)
    try:
        with open(0, "rb", closefd=False) as reading, open(own, "wb", closefd=False) as writing:
            yield reading, writing
    finally:
        sys.stdout.flush()
        os.dup2(own, 1)
        os.close(own)


@contextmanager
def _reserve(path: Path) -> Iterator[None]:
    """Keep other servers from recording into a file.

    Raises:
        RunBusyError: another process records into the file.
        FileWriteError: the folder cannot be written.
    """
    from hrl_escape.processes import open_lock

    lock = path.with_name(f"{path.name}.lock")
    with open_lock(lock, f"{path}: another server records into this file. Choose another file for --record"):
        try:
            yield
        finally:
            lock.unlink(missing_ok=True)
