"""Manual mode at a prompt: the player calls the tools that a language model would, in words; works over ssh.

If stdin is not a terminal, its lines are taken as commands, so that a game can be piped in.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.names import count_nouns, make_console_text, make_file_name
from hrl_escape.text.recordings import record_game, save_games
from hrl_escape.text.session import RoomSession
from hrl_escape.text.told_env import ToolCall
from hrl_escape.viewer.play.text_map import draw_map

__all__ = ["play_in_terminal", "read_command"]

_HELP = ('An option by its name, such as "press button-1" or "leave"; a primitive with how often, such as "forward 3"; '
        '"look", "map", "save", "quit"')
MOST_ROWS, LONGEST_LINE = 36, 4000


def read_command(line: str, tools: Sequence[Mapping[str, Any]]) -> ToolCall | None:
    """The call that a line means; None where it means none.

    Args:
        line: an option, or the beginning of just one; a primitive, with a number of times; or `look`.
        tools: schemas of the session.
    """
    word, _, times = line.partition(" ")
    if line == "look":
        return ToolCall("look", {})
    choices = {tool["name"]: tool["inputSchema"]["properties"] for tool in tools}
    primitive = _complete(word, choices["move"]["primitive"]["enum"] if "move" in choices else ())
    option = None if primitive == word else _complete(line, choices["run_option"]["option"]["enum"])
    if option is not None:
        return ToolCall("run_option", {"option": option})
    if primitive is not None and (not times or times.isdecimal()):
        return ToolCall("move", {"primitive": primitive, "times": int(times[:6] or 1)})
    return None


def _complete(beginning: str, names: Sequence[str]) -> str | None:
    found = [name for name in names if name.startswith(beginning)]
    return beginning if beginning in found else found[0] if len(found) == 1 else None


def play_in_terminal(session: RoomSession, seed: int, folder: Path) -> None:
    """Play one game until it is over, `quit` or the end of the input.

    Args:
        session: about the room.
        seed: of the episode.
        folder: for games that are saved.
    """
    console = Console(highlight=False, soft_wrap=True)
    live = sys.stdin.isatty() and console.is_terminal
    states: list[RoomState] = []

    def show_map() -> None:
        size = shutil.get_terminal_size((80, 30))
        room = session.env.instance
        rows = min(size.lines - 6, MOST_ROWS)
        console.print(draw_map(room, states, Kinematics(room), size.columns - 1, rows), end="")

    def say(text: str) -> None:
        states.append(session.env.state)
        if live:
            show_map()
        for line in text.splitlines():
            console.print(make_console_text(line, LONGEST_LINE))

    say(session.reset(seed))
    console.print(_HELP, style="dim", markup=False)
    for line in sys.stdin:
        word = " ".join(line.split())
        if word == "quit":
            break
        if word == "map":
            show_map()
        elif word == "save":
            console.print(f"Saved as {_save(session, folder)}", markup=False)
        elif (call := read_command(word, session.tools())) is None:
            console.print(_HELP, style="dim", markup=False)
        else:
            say(session.call(*call).text)
    score = session.score()
    console.print(f"{count_nouns(score.primitives, 'primitive')} in {count_nouns(score.decisions, 'call')}, "
                  f"return {score.reward:g}, efficiency {score.efficiency:.2f}")


def _save(session: RoomSession, folder: Path) -> Path:
    """Write the game so far; `RecordedModel` plays it again."""
    game = record_game(session)
    name = make_file_name(f"{game.room.name}-{game.room.seed}-{game.score.primitives}-primitives")
    save_games(folder / f"{name}.jsonl", [game])
    return folder / f"{name}.jsonl"
