"""Serve a room to a language model by the Model Context Protocol, on stdin and stdout.

    hrl-escape mcp
    hrl-escape mcp --room ladder-1/lattice/test#3
    hrl-escape mcp --room ladder-1/chain/test#0 --reveal names --record games/mine.jsonl

A client starts this command; its configuration contains only these words. Requires the extra `mcp`.
The recorded game can be replayed and compared: see the page on tools.
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

from hrl_escape.agents.text_agent import Level
from hrl_escape.commands.room_choice import RoomChoice


@dataclasses.dataclass(frozen=True)
class McpArgs(RoomChoice):
    """Options of `hrl-escape mcp`."""

    reveal: Level = "places"
    """Information for the caller: names, places or model."""
    options_only: bool = False
    """Offer no primitives."""
    episode_seed: int = 0
    """Episode seed: fixes the start and the noise."""
    record: Path | None = None
    """File for the game in JSON Lines, written after every call."""


def run(args: McpArgs) -> None:
    """Serve one game until the client disconnects."""
    from hrl_escape.env.escape_room import EscapeRoomEnv
    from hrl_escape.options.options_env import OptionsEnv
    from hrl_escape.text.mcp_server import make_server, serve  # needs the extra
    from hrl_escape.text.recordings import record_game, save_games
    from hrl_escape.text.text_env import RoomSession

    env = OptionsEnv(EscapeRoomEnv(instance=args.make_instance()), include_primitives=not args.options_only)
    session = RoomSession(env, args.reveal)
    session.reset(seed=args.episode_seed)

    def save() -> None:
        if args.record is not None:
            save_games(args.record, [record_game(session)])

    save()  # a file that cannot be written is refused before the game
    try:
        serve(make_server(session, save))
    finally:
        print(session.score(), file=sys.stderr)
        env.close()
