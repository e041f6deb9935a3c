"""Serve a room to a language model by the Model Context Protocol, on stdin and stdout.

    hrl-escape mcp
    hrl-escape mcp --room ladder-1/lattice/test#3
    hrl-escape mcp --room ladder-1/chain/test#0 --reveal names --record games/mine.jsonl

A client starts this command; its configuration contains only these words. Requires the extra `mcp`.
The recorded game can be replayed and compared: see the page on tools.
"""

from __future__ import annotations

import dataclasses
import os
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import IO

from hrl_escape.agents.text_agent import Level
from hrl_escape.commands.room_choice import RoomChoice
from hrl_escape.signals import Ended


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
    """File for the game in JSON Lines, written when the game is over or the client disconnects: it contains the room
    with everything that is hidden from the client. A file is for one server at a time."""


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

    is_saved = False

    def save() -> None:
        nonlocal is_saved
        if args.record is not None and not is_saved:
            save_games(args.record, [record_game(session)])
            is_saved = True

    with nullcontext() if args.record is None else _reserve(args.record):
        ended = 0
        try:
            serve(make_server(session, lambda: save() if session.env.is_over else None))
        except Ended as signal:
            ended = signal.number
        finally:
            save()
            print(session.score(), file=sys.stderr, flush=True)
            env.close()
        if ended:
            os._exit(128 + ended)  # a thread that waits for the client's next line would keep the process alive


def _reserve(path: Path) -> IO[bytes]:
    """Open the file of a record and lock it, until it is replaced by the record or this process ends.

    Raises:
        RunBusyError: another process records into the file.
        FileWriteError: the file cannot be written.
    """
    from hrl_escape.errors import RunBusyError
    from hrl_escape.files import make_folder, open_for_writing
    from hrl_escape.processes import take_lock

    make_folder(path.parent)
    file = open_for_writing(path)
    if not take_lock(file):
        file.close()
        raise RunBusyError(f"{path}: another server records into this file. Choose another file for --record")
    return file
