"""Manual mode without a browser: a map in letters and keys from the terminal; works over ssh.

If stdin is not a terminal, its characters are taken as keys, so that a game can be piped in.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.text import Text

from hrl_escape.env.kinematics import Kinematics
from hrl_escape.errors import EscapeError
from hrl_escape.names import make_console_text
from hrl_escape.planning.best_known import best_known_return
from hrl_escape.viewer.play.commands import carry_out
from hrl_escape.viewer.play.controls import HELP, Controls
from hrl_escape.viewer.play.episode import Episode
from hrl_escape.viewer.play.text_map import draw_map

__all__ = ["play_in_terminal", "read_keys"]

_SEQUENCES = {"[A": "up", "[B": "down", "[C": "right", "[D": "left", "OA": "up", "OB": "down", "OC": "right",
              "OD": "left"}
MOST_ROWS = 36


def play_in_terminal(episode: Episode, folder: Path) -> None:
    """Play until `q` or the end of the input."""
    console = Console(highlight=False)
    live = sys.stdin.isatty() and console.is_terminal
    controls = Controls(episode.instance.robot.actions, len(episode.option_names))
    note = "Press the buttons in the order of their graph, then drive into the exit"
    best = best_known_return(episode.instance)
    keys = read_keys(sys.stdin.fileno())
    with _raw(live):
        if live:
            _show(console, episode, note, best, live)
        for key in keys:
            command = controls.press(key)
            if command is None:
                continue
            if command.verb == "quit":
                break
            room = episode.instance.id
            try:
                note = carry_out(command, episode, folder, best)
            except EscapeError as error:
                note = str(error)
            if episode.instance.id != room:
                controls = Controls(episode.instance.robot.actions, len(episode.option_names))
                best = best_known_return(episode.instance)
            if live:
                _show(console, episode, note, best, live)
    if not live:
        _show(console, episode, note, best, live)


def _show(console: Console, episode: Episode, note: str, best: float, live: bool) -> None:
    size = shutil.get_terminal_size((80, 30))
    rows = min(size.lines - 6, MOST_ROWS)
    rules = Kinematics(episode.instance)
    picture = draw_map(episode.instance, episode.states, rules, size.columns - 1, rows)
    if live:
        console.clear()
    console.print(picture, end="", soft_wrap=True)
    console.print(f"[bold]{len(episode.steps)}[/bold] primitives, return [bold]{episode.total:g}[/bold], best known "
                  f"{best:g}: {episode.end.words}", soft_wrap=True)
    console.print(make_console_text(note, 1000), soft_wrap=True)
    if live:
        console.print(Text("  ".join(f"{keys}: {meaning}" for keys, meaning in HELP) + "  Q: quit", "dim"))


# --- keys ------------------------------------------------------------------------------------------


def read_keys(descriptor: int) -> Iterator[str]:
    """Keys by their names in `controls.KEYS`, one by one, until the input ends; an arrow is one key."""
    while (letter := os.read(descriptor, 1)) != b"":
        if letter == b"\x1b":
            key = _SEQUENCES.get(os.read(descriptor, 2).decode("ascii", "replace"), "")
        elif letter == b"\x03":
            return
        else:
            key = letter.decode("ascii", "replace").lower()
        if key and not key.isspace():
            yield key


@contextmanager
def _raw(live: bool) -> Iterator[None]:
    """Deliver keys one by one and without echo; the terminal is restored in any case."""
    if not live:
        yield
        return
    import termios  # not on every system
    import tty

    before = termios.tcgetattr(sys.stdin)
    tty.setcbreak(sys.stdin)
    try:
        yield
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
